"""Position errors, costs and rows as texts."""

import numpy as np

from ..model.measurement import Measurement
from ..model.validation import format_mm

ALL = slice(None)


def row_word(measurement: Measurement) -> str:
    """Return what a row of a measurement is called: a mode, or, of several takes, a row."""
    return "row" if measurement.take_count > 1 else "mode"


def cost_title(measurement: Measurement) -> str:
    """Return the title of a plot of the cost, with its unit."""
    return f"Cost (Eq. 7, all {row_word(measurement)}s; dB re the power)"


def error_summary(measurement: Measurement, positions: np.ndarray, sought: np.ndarray | slice = ALL) -> str:
    """Return the mean and the largest error of `sought` microphones in words, or that the truth is unknown."""
    errors = measurement.errors(positions, sought)
    if errors is None:
        return "true positions unknown"
    return errors_in_words(errors[sought], measurement.blind, measurement.nominal)


def errors_in_words(errors: np.ndarray, aligned: bool, nominal: bool = False) -> str:
    """Return the mean and the largest of some errors (K,), metres, in words.

    `aligned`: whether the array was moved as a whole onto the true positions; `nominal`: whether these are nominal.
    """
    after = (" from nominal" if nominal else "") + (", after alignment" if aligned else "")
    word, mean, largest = "deviation" if nominal else "error", float(errors.mean()), float(errors.max())
    return f"mean {word} {format_mm(mean)}, largest {format_mm(largest)}{after}"
