"""Isosurfaces by VTK's flying edges: a filter alone, without a renderer or a GL library."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..model.settings import Search


def isosurface(values: np.ndarray, search: Search, level: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where values on a lattice equal a level.

    `values` (nz, ny, nx) float64; `search`: the lattice, metres; `level`: in the unit of the values. Returns vertices
    (V, 3) float64, metres; faces (F, 3) int64, indices of vertices; normals (V, 3) float64, of unit length,; towards
    higher values.
    """
    vtk_core, vtk_data, arrays = _vtk()
    image = vtk_data.vtkImageData()
    image.SetDimensions(*values.shape[::-1])
    image.SetOrigin(*search.origin)
    image.SetSpacing(search.step, search.step, search.step)
    flat = np.ascontiguousarray(values, dtype=float).ravel()
    image.GetPointData().SetScalars(arrays.numpy_to_vtk(flat))
    contour = vtk_core.vtkFlyingEdges3D()
    contour.SetInputData(image)
    contour.SetValue(0, float(level))
    contour.ComputeNormalsOn()
    contour.ComputeScalarsOff()
    contour.Update()
    found = contour.GetOutput()
    if not found.GetNumberOfPolys():
        return np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 3))
    vertices = arrays.vtk_to_numpy(found.GetPoints().GetData()).astype(float)
    faces = arrays.vtk_to_numpy(found.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(int)
    normals = arrays.vtk_to_numpy(found.GetPointData().GetNormals()).astype(float)
    return vertices, faces, -normals  # VTK's point towards lower values


def _vtk() -> tuple[Any, Any, Any]:
    """The parts of VTK that filter: they take a third of a second to load, so only a page with isosurfaces does."""
    import vtkmodules.util.numpy_support as arrays
    import vtkmodules.vtkCommonDataModel as data
    import vtkmodules.vtkFiltersCore as core

    return core, data, arrays
