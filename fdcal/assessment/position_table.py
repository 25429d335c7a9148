"""The microphones as a table: estimated position, true position, and the distance between the two."""

from __future__ import annotations

import csv
import io

import numpy as np

from ..model.measurement import Measurement


def table(measurement: Measurement, positions, sigma=None) -> str:
    """Return CSV with one line per microphone; lengths in metres, unknown values empty, numbers to full precision.

    Columns: name, known (yes or no), x_m, y_m[, z_m], true_x_m, true_y_m[, true_z_m], error_m, uncertainty_m. Without
    any known microphone the error is that after the best rigid motion or mirror image of the whole array, in a column
    called error_once_aligned_m.

    Parameters
    ----------
    positions : (N, D) float64, metres
    sigma : (N,) float64, metres, one standard deviation, or None
    """
    truth, axes = measurement.positions, "xyz"[: measurement.array_dimension]
    errors = measurement.errors(positions)
    aligned = "_once_aligned" if measurement.blind and truth is not None else ""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ["name", "known", *(f"{a}_m" for a in axes), *(f"true_{a}_m" for a in axes)]
        + [f"error{aligned}_m", "uncertainty_m"]
    )
    for n, name in enumerate(measurement.names):
        true = [""] * (len(axes) + 1)
        if truth is not None and errors is not None:
            true = [*truth[n].tolist(), float(errors[n])]
        uncertainty = "" if sigma is None else float(sigma[n])
        known = "yes" if n in measurement.known else "no"
        writer.writerow([name, known, *np.asarray(positions[n], float).tolist(), *true, uncertainty])
    return text.getvalue()
