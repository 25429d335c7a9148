"""Files of a `FieldMap`; the suffix selects the format.

.npz   x, y[, z] (metres), frequencies (Hz), pressure, magnitude, uncertainty (F, nx, ny[, nz]), inside, microphones
.csv   a row for each frequency and point inside:
       frequency_hz,x_m,y_m[,z_m],real,imag,magnitude,uncertainty
.png   real part, imaginary part and magnitude, a row for each frequency; of a volume the layer at half height
.vti   ParaView: an image of points, with real_F, imag_F, magnitude_F, uncertainty_F of each frequency F
"""

from pathlib import Path
from typing import Any

import numpy as np

from ..assessment.field import FieldMap
from ..model.validation import InputError
from . import paraview
from .primitives import COLOUR_MAP, DIVERGING_COLOUR_MAP

MAX_ROWS = 12  # frequencies in a picture


def write(path: str | Path, target: str | Path, field: FieldMap) -> None:
    """Write a sound field to a file; the suffix of `target`, a key of WRITERS, selects the format."""
    WRITERS[Path(target).suffix.lower()](Path(path), field)


def _write_npz(path: Path, field: FieldMap) -> None:
    arrays: dict[str, Any] = dict(zip("xyz", field.axes, strict=False))
    arrays |= {
        "frequencies": field.frequencies,
        "pressure": field.pressure,
        "magnitude": np.abs(field.pressure),
        "uncertainty": field.uncertainty,
        "inside": field.inside,
        "microphones": field.microphones,
    }
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


def _write_vti(path: Path, field: FieldMap) -> None:
    fields = {}
    for f, p, sigma in zip(field.frequencies, field.pressure, field.uncertainty, strict=True):
        parts = {"real": p.real, "imag": p.imag, "magnitude": np.abs(p), "uncertainty": sigma}
        fields |= {f"{name}_{f:.2f}Hz": values.ravel(order="F") for name, values in parts.items()}
    origin = [*(float(axis[0]) for axis in field.axes), 0.0][:3]
    steps = [*(float(axis[1] - axis[0]) for axis in field.axes), 1.0][:3]
    path.write_text(paraview.image((*field.inside.shape, 1)[:3], origin, steps, fields), encoding="ascii")


def _write_png(path: Path, field: FieldMap) -> None:
    from matplotlib.figure import Figure

    count = len(field.frequencies)
    if count > MAX_ROWS:
        problem = f"{count} frequencies are too many for a picture"
        remedy = f"give at most {MAX_ROWS} <frequencies>, or write .npz"
        raise InputError(problem, remedy, key="frequencies", value=count)
    layer = (..., len(field.axes[2]) // 2) if len(field.axes) == 3 else ...
    figure = Figure(figsize=(13.5, 3.9 * count), dpi=110, layout="constrained")
    panels = figure.subplots(count, 3, squeeze=False)
    for row, f, p in zip(panels, field.frequencies, field.pressure, strict=True):
        _draw_row(row, f, p, layer, field)
    title = "Sound field inside the array"
    if len(field.axes) == 3:
        title += f" at z = {field.axes[2][len(field.axes[2]) // 2]:.3g} m"
    figure.suptitle(title)
    figure.savefig(path, format="png")


def _draw_row(panels, f: float, p: np.ndarray, layer, field: FieldMap) -> None:
    """Draw real part, imaginary part and magnitude of one layer of the pressures (nx, ny[, nz]) of a frequency, Hz."""
    x, y = field.axes[:2]
    half = (x[1] - x[0]) / 2
    extent = (x[0] - half, x[-1] + half, y[0] - half, y[-1] + half)
    largest = float(np.nanmax(np.abs(p)))
    parts = {"real part": np.real(p), "imaginary part": np.imag(p), "magnitude": np.abs(p)}
    for panel, (part, values) in zip(panels, parts.items(), strict=True):
        low, colours = (0, COLOUR_MAP) if part == "magnitude" else (-largest, DIVERGING_COLOUR_MAP)
        image = panel.imshow(values[layer].T, origin="lower", extent=extent, cmap=colours, vmin=low, vmax=largest)
        panel.plot(*field.microphones[:, :2].T, ".", color="black", markersize=3)
        panel.set(title=f"{f:.1f} Hz, {part}", xlabel="x (m)", ylabel="y (m)")
        panel.figure.colorbar(image, ax=panel, label="pressure (unit of the measurement)")


WRITERS = {".npz": _write_npz, ".csv": _write_csv, ".png": _write_png, ".vti": _write_vti}
