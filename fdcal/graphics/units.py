"""Lengths and position errors as texts."""

from __future__ import annotations

import numpy as np

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


def format_mm(length: float) -> str:
    """Return a length in metres as a text in millimetres: "4.13 mm", "535 mm"."""
    return f"{mm_text(length)} mm"


def length_text(length: float) -> str:
    """Return a length in metres as a text, in metres from 1 m on: "4.13 mm", "1.16 m"."""
    return format_mm(length) if length < 0.9995 else f"{length:.3g} m"


def mm_text(length: float) -> str:
    """Return the number of millimetres of a length in metres, with three digits below a decimetre."""
    if length < 1e-6:
        return "0"
    return f"{1e3 * length:.3g}" if length < 0.1 else f"{1e3 * length:.0f}"
