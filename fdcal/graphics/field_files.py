"""Files of a `FieldMap`: the suffix tells the format.

.npz   x, y[, z] (metres), frequencies (Hz), pressure, magnitude, uncertainty (F, nx, ny[, nz]), inside, microphones
.csv   a row for each frequency and point inside: frequency_hz,x_m,y_m[,z_m],real,imag,magnitude,uncertainty
.png   real and imaginary part and magnitude, a row for each frequency; of a space its layer at half height
.vti   ParaView: an image of points, with real_F, imag_F, magnitude_F, uncertainty_F of each frequency F
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..assessment.field_map import FieldMap
from ..model.validation import InputError
from . import vtk_xml

MOST_ROWS = 12  # of a picture


def write(path, target: str | Path, found: FieldMap) -> None:
    """Write `found` to the file `path` in the format that the suffix of `target` names."""
    WRITERS[Path(target).suffix.lower()](Path(path), found)


def _write_npz(path: Path, found: FieldMap) -> None:
    table = dict(zip("xyz", found.axes, strict=False))
    with open(path, "wb") as file:
        np.savez_compressed(
            file,
            **table,
            frequencies=found.frequencies,
            pressure=found.pressure,
            magnitude=np.abs(found.pressure),
            uncertainty=found.uncertainty,
            inside=found.inside,
            microphones=found.microphones,
        )


def _write_csv(path: Path, found: FieldMap) -> None:
    points, inside = found.points, found.inside
    names = [f"{axis}_m" for axis in "xyz"[: points.shape[1]]]
    with open(path, "w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(["frequency_hz", *names, "real", "imag", "magnitude", "uncertainty"]) + "\n")
        for f, p, sigma in zip(found.frequencies, found.pressure, found.uncertainty, strict=True):
            p, sigma = p[inside], sigma[inside]
            rows = np.column_stack([np.full(len(p), f), points, p.real, p.imag, np.abs(p), sigma])
            np.savetxt(file, rows, fmt="%.9g", delimiter=",")


def _write_vti(path: Path, found: FieldMap) -> None:
    fields = {}
    for f, p, sigma in zip(found.frequencies, found.pressure, found.uncertainty, strict=True):
        parts = {"real": p.real, "imag": p.imag, "magnitude": np.abs(p), "uncertainty": sigma}
        fields |= {f"{name}_{f:.2f}Hz": values.ravel(order="F") for name, values in parts.items()}
    origin = [*(float(axis[0]) for axis in found.axes), 0.0][:3]
    steps = [*(float(axis[1] - axis[0]) for axis in found.axes), 1.0][:3]
    path.write_text(vtk_xml.image((*found.inside.shape, 1)[:3], origin, steps, fields), encoding="ascii")


def _write_png(path: Path, found: FieldMap) -> None:
    from matplotlib.figure import Figure

    count = len(found.frequencies)
    if count > MOST_ROWS:
        raise InputError(f"{count} frequencies are too many for a picture; name {MOST_ROWS} at most, or write .npz")
    x, y = found.axes[:2]
    layer = (..., len(found.axes[2]) // 2) if len(found.axes) == 3 else ...
    half = (x[1] - x[0]) / 2
    extent = (x[0] - half, x[-1] + half, y[0] - half, y[-1] + half)
    figure = Figure(figsize=(13.5, 3.9 * count), dpi=110, layout="constrained")
    for row, f, p in zip(figure.subplots(count, 3, squeeze=False), found.frequencies, found.pressure, strict=True):
        largest = float(np.nanmax(np.abs(p)))
        for panel, part, values in zip(
            row, ("real part", "imaginary part", "magnitude"), (p.real, p.imag, np.abs(p)), strict=True
        ):
            low, colours = (0, "viridis") if part == "magnitude" else (-largest, "RdBu_r")
            image = panel.imshow(values[layer].T, origin="lower", extent=extent, cmap=colours, vmin=low, vmax=largest)
            panel.plot(*found.microphones[:, :2].T, ".", color="black", markersize=3)
            panel.set(title=f"{f:.1f} Hz, {part}", xlabel="x (m)", ylabel="y (m)")
            figure.colorbar(image, ax=panel, label="pressure (unit of the measurement)")
    title = "Sound field inside the array"
    if len(found.axes) == 3:
        title += f" at z = {found.axes[2][len(found.axes[2]) // 2]:.3g} m"
    figure.suptitle(title)
    figure.savefig(path, format="png")


WRITERS = {".npz": _write_npz, ".csv": _write_csv, ".png": _write_png, ".vti": _write_vti}
