"""The microphones as a table: where each is supposed, where it is, how far apart the two are."""

from __future__ import annotations

import csv
import io

import numpy as np

from ..model.measurement import Measurement


def table(measurement: Measurement, positions, sigma=None) -> str:
    """CSV with one line a microphone; lengths in metres, what is not known left empty, numbers that come back.

    Columns: name, known (yes or no), x_m, y_m[, z_m], true_x_m, true_y_m[, true_z_m], error_m, uncertainty_m. Without
    any known microphone the error is that after the best motion and mirror of the whole, and its column is called
    error_once_aligned_m.

    Parameters
    ----------
    positions : (N, D), metres
    sigma : (N,), metres, one standard deviation, or None
    """
    truth, axes = measurement.positions, "xyz"[: measurement.array_dimension]
    errors, aligned = measurement.errors(positions), "_once_aligned" if measurement.blind and truth is not None else ""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ["name", "known", *(f"{a}_m" for a in axes), *(f"true_{a}_m" for a in axes)]
        + [f"error{aligned}_m", "uncertainty_m"]
    )
    for n, name in enumerate(measurement.names):
        told = [""] * (len(axes) + 1) if truth is None else [*truth[n].tolist(), float(errors[n])]
        spread = "" if sigma is None else float(sigma[n])
        known = "yes" if n in measurement.known else "no"
        writer.writerow([name, known, *np.asarray(positions[n], float).tolist(), *told, spread])
    return text.getvalue()
