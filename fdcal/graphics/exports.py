"""Maps and sound fields as files for other programs.

.vti   ParaView: a map of costs as an image of points, written by VTK, which is loaded with the first such file
.npz   a sound field: x, y[, z] (metres), frequencies (Hz), pressure, magnitude, uncertainty (F, nx, ny[, nz]), inside,
       microphones
.csv   a row for each frequency and point inside:
       frequency_hz,x_m,y_m[,z_m],real,imag,magnitude,uncertainty
.png   real part, imaginary part and magnitude, a row for each frequency; of a volume the layer at half height
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..assessment.field import FieldMap
from ..cost.maps import LandscapePanels
from ..model.settings import Search
from ..model.validation import InputError
from .primitives import COLOUR_MAP, DIVERGING_COLOUR_MAP


def landscape_vti(panels: LandscapePanels) -> str:
    """Return the text of a .vti file with one field for each mode, and their sum, at height 0."""
    modes = zip(panels.modes, panels.frequencies, panels.maps[:-1], strict=True)
    return image(panels.search, {f"mode {m}, {f:.2f} Hz": cost for m, f, cost in modes} | {"sum": panels.maps[-1]})


def volume_vti(cost: np.ndarray, search: Search) -> str:
    """Return the text of a .vti file of the cost of moving one microphone in space.

    Fields of every point: `cost` (nz, ny, nx), relative to the power, and `cost_dB`.
    """
    decibels = 10 * np.log10(np.maximum(cost, np.finfo(float).tiny))
    return image(search, {"cost": cost.astype(np.float32), "cost_dB": decibels.astype(np.float32)})


def image(search: Search, fields: Mapping[str, np.ndarray]) -> str:
    """Return the text of an image file (.vti) of fields over a lattice: (ny, nx) at height 0, or (nz, ny, nx)."""
    from vtkmodules.util import numpy_support
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkIOXML import vtkXMLImageDataWriter

    data = vtkImageData()
    shape = next(iter(fields.values())).shape[::-1]
    data.SetDimensions(*shape, *(1,) * (3 - len(shape)))
    data.SetOrigin(*search.origin[: len(shape)], *(0.0,) * (3 - len(shape)))
    data.SetSpacing(*[search.step] * 3)
    for name, values in fields.items():
        array = numpy_support.numpy_to_vtk(np.ascontiguousarray(np.ravel(values)), deep=True)
        array.SetName(name)
        data.GetPointData().AddArray(array)
    writer = vtkXMLImageDataWriter()
    writer.SetInputData(data)
    writer.SetDataModeToBinary()
    writer.WriteToOutputStringOn()
    writer.Write()
    return writer.GetOutputString()


MAX_ROWS = 12  # frequencies in a picture


def _write_npz(path: Path, field: FieldMap) -> None:
    arrays: dict[str, Any] = dict(zip("xyz", field.axes, strict=False)) | {"magnitude": np.abs(field.pressure)}
    for name in ("frequencies", "pressure", "uncertainty", "inside", "microphones"):
        arrays[name] = getattr(field, name)
    with open(path, "wb") as file:
        np.savez_compressed(file, **arrays)


def _write_csv(path: Path, field: FieldMap) -> None:
    points, inside = field.points, field.inside
    names = [f"{axis}_m" for axis in "xyz"[: points.shape[1]]]
    with open(path, "w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(["frequency_hz", *names, "real", "imag", "magnitude", "uncertainty"]) + "\n")
        for f, p, sigma in zip(field.frequencies, field.pressure, field.uncertainty, strict=True):
            p, sigma = p[inside], sigma[inside]
            rows = np.column_stack([np.full(len(p), f), points, p.real, p.imag, np.abs(p), sigma])
            np.savetxt(file, rows, fmt="%.9g", delimiter=",")


def _write_png(path: Path, field: FieldMap) -> None:
    from matplotlib.figure import Figure

    count = len(field.frequencies)
    if count > MAX_ROWS:
        problem = f"{count} frequencies are too many for a picture"
        raise InputError(problem, f"give at most {MAX_ROWS} <frequencies>, or write .npz", key="frequencies")
    layer = (..., len(field.axes[2]) // 2) if len(field.axes) == 3 else ...
    figure = Figure(figsize=(13.5, 3.9 * count), dpi=110, layout="constrained")
    panels = figure.subplots(count, 3, squeeze=False)
    x, y = field.axes[:2]
    half = (x[1] - x[0]) / 2
    extent = (x[0] - half, x[-1] + half, y[0] - half, y[-1] + half)
    for row, f, p in zip(panels, field.frequencies, field.pressure, strict=True):
        largest = float(np.nanmax(np.abs(p)))
        parts = {"real part": np.real(p), "imaginary part": np.imag(p), "magnitude": np.abs(p)}
        for panel, (part, values) in zip(row, parts.items(), strict=True):
            low, colours = (0, COLOUR_MAP) if part == "magnitude" else (-largest, DIVERGING_COLOUR_MAP)
            shown = panel.imshow(values[layer].T, origin="lower", extent=extent, cmap=colours, vmin=low, vmax=largest)
            panel.plot(*field.microphones[:, :2].T, ".", color="black", markersize=3)
            panel.set(title=f"{f:.1f} Hz, {part}", xlabel="x (m)", ylabel="y (m)")
            figure.colorbar(shown, ax=panel, label="pressure (unit of the measurement)")
    title = "Sound field inside the array"
    if len(field.axes) == 3:
        title += f" at z = {field.axes[2][len(field.axes[2]) // 2]:.3g} m"
    figure.suptitle(title)
    figure.savefig(path, format="png")


FIELD_WRITERS = {".npz": _write_npz, ".csv": _write_csv, ".png": _write_png}
