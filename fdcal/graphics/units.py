"""Position errors as texts."""

from __future__ import annotations

import numpy as np

from ..model.lengths import format_mm
from ..model.measurement import Measurement

ALL = slice(None)


def error_summary(measurement: Measurement, positions: np.ndarray, sought: np.ndarray | slice = ALL) -> str:
    """Return the mean and the largest position error in words, or that the true positions are unknown.

    Parameters
    ----------
    measurement : Measurement
    positions : (N, D) float64, metres, the estimate
    sought : numbers of the microphones whose errors count, all unless given
    """
    errors = measurement.errors(positions)
    if errors is None:
        return "true positions unknown"
    return errors_in_words(errors[sought], measurement.blind)


def errors_in_words(errors: np.ndarray, aligned: bool) -> str:
    """Return the mean and the largest of some position errors (K,), metres, in words.

    Parameters
    ----------
    errors : (K,) float64, metres
    aligned : whether the array was moved as a whole onto the true positions
    """
    after = ", after alignment" if aligned else ""
    return f"mean error {format_mm(float(errors.mean()))}, largest {format_mm(float(errors.max()))}{after}"
