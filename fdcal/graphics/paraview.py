"""Maps (.vti) and microphones (.vtp) as files for ParaView, written by VTK, which is loaded with the first of them."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..cost.basins import basins_of
from ..model.measurement import Measurement
from ..model.settings import Search
from .landscape import LandscapePanels
from .units import ALL

ESTIMATED, TRUE, KNOWN = 0, 1, 2  # `kind` of a point


def landscape(panels: LandscapePanels, height: float = 0.0, basins: bool = False) -> str:
    """Return the text of a .vti file with one field for each mode, and their sum, at a `height`, metres.

    `basins`: whether there is a field with the number of the minimum of the sum where descent from each point ends, the
    lowest minimum being 0; -1 where it ends at the edge of the map.
    """
    modes = zip(panels.modes, panels.frequencies, panels.maps[:-1], strict=True)
    fields = {f"mode {m}, {f:.2f} Hz": cost for m, f, cost in modes}
    fields["sum"] = panels.maps[-1]
    if basins:
        fields["basin of the sum"] = basins_of(panels.maps[-1]).labels
    (x, y), step = panels.search.origin[:2], panels.search.step
    ny, nx = panels.maps.shape[1:]
    return image((nx, ny, 1), (x, y, height), (step, step, step), fields)


def volume(cost: np.ndarray, search: Search, basins: bool = False) -> str:
    """Return the text of a .vti file of the cost of moving one microphone in space.

    Fields of every point: `cost` (nz, ny, nx), relative to the power, `cost_dB`, and `basin` where `basins` asks for
    it, as of `landscape`.
    """
    values = np.asarray(cost, float).ravel()
    fields = {"cost": values, "cost_dB": 10 * np.log10(np.maximum(values, np.finfo(float).tiny))}
    fields = {name: field.astype(np.float32) for name, field in fields.items()}
    if basins:
        fields["basin"] = basins_of(cost).labels.ravel()
    return image(cost.shape[::-1], search.origin, [search.step] * 3, fields)


def point_cloud(
    measurement: Measurement, positions, sigma=None, height: float = 0.0, by: slice | np.ndarray = ALL
) -> str:
    """Return the text of a .vtp file: estimated, true and known microphones, and lines from true to estimated ones.

    Fields of every point: `kind` (0 estimated, 1 true, 2 known), `microphone` (its number), `name`, `error` (3,),
    metres, from the true position to the estimate, `error_length` and `uncertainty` (one sigma), metres; NaN where
    unknown. To see errors as arrows: Threshold by kind 1, Glyph by error without scaling.

    Without any known microphone the true positions are moved as a whole to the estimate (N, D), `by` the microphones of
    these numbers. `sigma` (N,), metres; `height`: of an array in a plane, metres.
    """
    N, truth, known = measurement.count, measurement.aligned_truth(positions, by), measurement.known
    everyone = np.arange(N)
    groups = [(ESTIMATED, everyone, positions)]
    groups += [] if truth is None else [(TRUE, everyone, truth)]
    groups += [(KNOWN, known, measurement.known_positions)]
    number = np.concatenate([members for _, members, _ in groups])
    unknown = np.full(N, np.nan)
    error = np.zeros((N, 3)) if truth is None else _in_space(np.subtract(positions, truth), 0.0)
    distance = measurement.errors(positions, by)
    fields = {
        "kind": np.concatenate([np.full(len(members), kind) for kind, members, _ in groups]),
        "microphone": number,
        "name": np.array(measurement.names)[number],
        "error": error[number],
        "error_length": (unknown if distance is None else distance)[number],
        "uncertainty": (unknown if sigma is None else np.asarray(sigma, float))[number],
    }
    points = np.concatenate([_in_space(members, height) for _, _, members in groups])
    lines = np.zeros((0, 2)) if truth is None else np.column_stack([everyone + N, everyone])
    return _points(points, lines, fields)


def _in_space(values, height: float) -> np.ndarray:
    """(P, 2) with a third column of `height`; (P, 3) unchanged."""
    values = np.asarray(values, float)
    return values if values.shape[1] == 3 else np.column_stack([values, np.full(len(values), height)])


def image(
    shape: Sequence[int], origin: Sequence[float], spacing: Sequence[float], fields: Mapping[str, np.ndarray]
) -> str:
    """Return the text of an image file (.vti) of fields with a value for each point, x fastest; lengths in metres."""
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkIOXML import vtkXMLImageDataWriter

    data = vtkImageData()
    data.SetDimensions(*map(int, shape))
    data.SetOrigin(*map(float, origin))
    data.SetSpacing(*map(float, spacing))
    return _xml(vtkXMLImageDataWriter(), data, {name: np.ravel(values) for name, values in fields.items()})


def _points(positions: np.ndarray, lines: np.ndarray, fields: Mapping[str, np.ndarray]) -> str:
    """Return the text of a file (.vtp) of points (P, 3), metres, `lines` (S, 2) between some, and their fields."""
    from vtkmodules.util import numpy_support
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    data, places = vtkPolyData(), vtkPoints()
    places.SetData(numpy_support.numpy_to_vtk(np.ascontiguousarray(positions, float), deep=True))
    data.SetPoints(places)
    for members, add in ((np.arange(len(positions))[:, None], data.SetVerts), (np.asarray(lines, int), data.SetLines)):
        cells, connectivity = vtkCellArray(), numpy_support.numpy_to_vtkIdTypeArray(members.ravel(), deep=True)
        cells.SetData(members.shape[1], connectivity)
        add(cells)
    return _xml(vtkXMLPolyDataWriter(), data, fields)


def _xml(writer, data, fields: Mapping[str, np.ndarray]) -> str:
    """Return the text that a writer of VTK makes of a data set with the `fields` of its points."""
    from vtkmodules.util import numpy_support
    from vtkmodules.vtkCommonCore import vtkStringArray

    for name, values in fields.items():
        if values.dtype.kind == "U":
            array = vtkStringArray()
            for text in values.tolist():
                array.InsertNextValue(text)
        else:
            array = numpy_support.numpy_to_vtk(np.ascontiguousarray(values), deep=True)
        array.SetName(name)
        data.GetPointData().AddArray(array)
    writer.SetInputData(data)
    writer.SetDataModeToBinary()
    writer.WriteToOutputStringOn()
    writer.Write()
    return writer.GetOutputString()
