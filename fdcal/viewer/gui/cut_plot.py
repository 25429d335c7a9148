"""The plot of a cut: the cost along a line, thin for single modes, thick for their sum."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.colors import to_hex
from viser import uplot

from ...graphics.units import row_word
from ...model.measurement import Measurement
from ..background.cuts import MAX_MODES, Cut
from ..background.map_panels import count_label
from .html import CARD
from .plots import BLUE, GREY, RED, dots

HIDDEN = -1e4  # dB, where a curve has nothing to show: below the plot
SPAN, STEP = 80.0, 10.0  # dB that the plot shows at most below its highest cost, and to which its ends are rounded
COLOURS = tuple(to_hex(colour) for colour in matplotlib.colormaps["plasma"](np.linspace(0.15, 0.85, MAX_MODES)))


def cut_series(measurement: Measurement) -> tuple[uplot.Series, ...]:
    """Return the series of the plot: distance, single modes, their sum, the estimate and the true position."""
    thin = [uplot.Series(label=f"{row_word(measurement)} {i}", stroke=colour, width=1, points={"show": False})
            for i, colour in enumerate(COLOURS)]  # fmt: skip
    return (
        uplot.Series(label="m"),
        *thin,
        uplot.Series(label="sum", stroke=BLUE, width=3, points={"show": False}),
        uplot.Series(label="estimate", stroke=RED, width=0, points=dots(9, RED, RED)),
        uplot.Series(label=measurement.reference, stroke=GREY, width=0, points=dots(13, GREY, "transparent")),
    )


def cut_columns(cut: Cut) -> tuple[np.ndarray, ...]:
    """Return the columns of the plot, finite numbers alone."""
    nothing = np.full(len(cut.distance), HIDDEN)
    low, _ = cut_limits(cut)
    single = [np.maximum(curve, low - STEP) for curve in cut.single]
    marks = [nothing.copy(), nothing.copy()]
    for column, place in zip(marks, (cut.estimate, cut.truth), strict=True):
        if place is not None:
            at = int(np.abs(cut.distance - place).argmin())
            column[at] = max(cut.total[at], low)
    return cut.distance, *single, *[nothing] * (MAX_MODES - len(single)), np.maximum(cut.total, low - STEP), *marks


def cut_limits(cut: Cut) -> tuple[float, float]:
    """Return the ends of the axis, dB."""
    high = STEP * float(np.ceil(cut.total.max() / STEP))
    low = STEP * float(np.floor(min(cut.total.min(), cut.single.min(initial=np.inf)) / STEP))
    return max(low, high - SPAN), high


def cut_caption(cut: Cut, measurement: Measurement) -> str:
    """Return what the plot shows, as HTML."""
    request, count = cut.request, len(cut.request.modes)
    word, numbers = row_word(measurement), ", ".join(map(str, cut.modes))
    single = f"{word} {cut.modes[0]}" if count == 1 else f"{word}s {numbers}"
    marks = [f"<span style='color: {RED}'>&#9679;</span> estimate"] if cut.estimate is not None else []
    marks += (
        [f"<span style='color: {GREY}'>&#9675;</span> {measurement.reference} position"]
        if cut.truth is not None
        else []
    )
    lowest = float(cut.distance[int(cut.total.argmin())])
    return (
        f"<div style='{CARD}'>microphone {request.microphone}: <b style='color: {BLUE}'>sum of"
        f" {count_label(measurement, request.modes)}</b>, lowest {lowest:.3f} m from A. Thin, from dark to light:"
        f" {single}. {' '.join(marks)}</div>"
    )
