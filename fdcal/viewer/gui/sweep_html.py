"""What a sweep of modes shows: its local minima in words and as a curve."""

from __future__ import annotations

import numpy as np
from viser import uplot

from ...model.measurement import Measurement
from ..background.map_panels import count_label, modes_label
from .html import CARD
from .plots import BLUE, RED, dots

HIDDEN = -1e3  # local minima, where the curve has no point yet: below the plot


def caption(measurement: Measurement, microphone: int, modes: tuple[int, ...], minima: int, layer: bool = False) -> str:
    """Return what a map of a sweep shows, as HTML.

    `microphone`: counted from 0; `modes`: ascending, counted from 1; `minima`: number of local minima of the map;
    `layer`: whether the map is a layer of a domain in space.
    """
    found = "no local minimum" if not minima else "1 local minimum" if minima == 1 else f"{minima} local minima"
    where = " in the layer at its height" if layer else ""
    what = f"sum of {count_label(measurement, modes)}, {modes[0]} to {modes[-1]}"
    what = what if len(modes) > 1 else f"{modes_label(measurement, modes)} alone"
    return f"<div style='{CARD}'>microphone {microphone}, {what}: <b>{found}</b>{where}</div>"


def curve(stops: tuple[int, ...], counts: tuple[int, ...], summed: int) -> tuple[np.ndarray, ...]:
    """Return the columns of the plot: modes summed, local minima as far as they are counted, the present point.

    `stops`: numbers of modes of all maps of the sweep; `counts`: local minima of the first of them; `summed`: number of
    modes of the present map; 0 for none.
    """
    x = np.array(stops, float)
    line = np.concatenate([np.array(counts, float), np.full(len(stops) - len(counts), HIDDEN)])
    return x, line, np.where(x == summed, line, HIDDEN)


def curve_series() -> tuple[uplot.Series, ...]:
    """Return the series of the plot."""
    return (
        uplot.Series(label="modes"),
        uplot.Series(label="local minima", stroke=BLUE, width=0, points=dots(4, BLUE, BLUE)),
        uplot.Series(label="in the map", stroke=RED, width=0, points=dots(8, RED, RED)),
    )
