"""Error and cost against sweeps, with a mark where a stage began: a mode came in, or the solver changed its goal.

uPlot writes small numbers as 0, so errors are in millimetres and costs in decibels, or as they are where a cost is a
likelihood, which may be negative. A NaN makes it search for axis
ticks for ever, so none is ever sent.
"""

from __future__ import annotations

import numpy as np
import viser
from viser import uplot

from ..history import SessionView
from ..measurement import Measurement

MOST_POINTS = 600  # a plot is sent whole each time
INTERVAL = 0.25  # s between two sendings
LEAST_ERROR, LEAST_COST = 1e-6, 1e-12  # m and 1, drawn for anything below: logarithms have no zero
COSTS = {True: "Cost of the modes in use (dB re 1)", False: "Cost of the modes in use (-log likelihood)"}
RED, BLUE, ORANGE, GREY = "#d61828", "#1f78c8", "#e08a1e", "#8a8f98"


class Curves:
    """Owns the two plots and the numbers behind them."""

    def __init__(self, gui: viser.GuiApi, measurement: Measurement):
        self._measurement, self._free = measurement, max(measurement.count - len(measurement.known), 1)
        self._seen: list = []  # states whose numbers are in _rows
        self._rows: list[tuple] = []  # sweeps, mean error, largest error, cost, last mode in use, stage
        self._sent = -1e9
        empty = np.ones(1)
        self._error = None
        if measurement.positions is not None:
            series = _series(("mean", RED, 2.0), ("largest", ORANGE, 1.25))
            title = "Position error (mm, once aligned)" if measurement.blind else "Position error (mm)"
            self._error = _plot(gui, title, series, (empty,) * 4, 3)
        self._cost = _plot(gui, COSTS[True], _series(("cost", BLUE, 2.0)), (empty,) * 3, 1)

    def show(self, view: SessionView, now: float) -> None:
        """Bring the plots up to date, not too often."""
        if now - self._sent < INTERVAL or not self._catch_up(view.history):
            return
        self._sent = now
        x, mean, largest, cost, last, stage = np.array(self._rows, float).T
        chosen = np.unique(np.linspace(0, len(x) - 1, min(len(x), MOST_POINTS)).round().astype(int))
        came_in = np.flatnonzero((np.diff(last) > 0) | (np.diff(stage) > 0)) + 1
        if self._error is not None:
            self._error.data = _with_marks(x, (mean, largest), chosen, came_in)
        decibels = bool((cost > 0).all())
        if decibels:
            cost = 10 * np.log10(cost)
        if (title := COSTS[decibels]) != self._cost.title:
            self._cost.title = title
        self._cost.data = _with_marks(x, (cost,), chosen, came_in)

    def _catch_up(self, history) -> bool:
        """Compute what is new in `history`; False if nothing is."""
        kept = min(len(self._seen), len(history))
        while kept and self._seen[kept - 1] is not history[kept - 1]:
            kept -= 1
        if kept == len(history) == len(self._seen):
            return False
        new = history[kept:]
        self._seen[kept:], self._rows[kept:] = new, [self._row(state) for state in new]
        return True

    def _row(self, state) -> tuple:
        errors = self._measurement.errors(state.positions)
        errors = np.zeros(1) if errors is None else errors
        at_once = state.step == state.sweep  # a solver whose every step moves all microphones
        return (
            state.step if at_once else state.step / self._free,
            1e3 * _drawable(errors.mean(), LEAST_ERROR),
            1e3 * _drawable(errors.max(), LEAST_ERROR),
            _cost_drawable(state.cost),
            state.last,
            state.stage,
        )


def _drawable(value, least: float) -> float:
    """A finite number of at least `least`, which also stands for NaN."""
    return min(max(least, float(value)), 1e12)


def _cost_drawable(value) -> float:
    """A finite number, not so near to zero that its logarithm is out of sight; NaN is nothing left."""
    value = float(value)
    if np.isfinite(value) and value < 0:
        return max(value, -1e12)
    return _drawable(value, LEAST_COST)


def _with_marks(x, curves, chosen, came_in) -> tuple[np.ndarray, ...]:
    """Data of a plot: the curves at the `chosen` points, and a vertical stroke at each of `came_in`."""
    seen = np.concatenate([curve[chosen] for curve in curves])
    low, high = seen.min(), seen.max()
    order = np.argsort(np.concatenate([x[chosen], np.repeat(x[came_in], 3)]), kind="stable")
    axis = np.concatenate([x[chosen], np.repeat(x[came_in], 3)])[order]
    stroke = np.concatenate([np.full(len(chosen), low), np.tile([low, high, low], len(came_in))])[order]
    lines = [np.concatenate([c[chosen], np.repeat(c[came_in], 3)])[order] for c in curves]
    return (axis, *lines, stroke)


def _series(*curves) -> tuple:
    drawn = [uplot.Series(label=name, stroke=colour, width=width) for name, colour, width in curves]
    marks = uplot.Series(label="stage", stroke=GREY, width=1, dash=(4, 4), points={"show": False})
    return (uplot.Series(label="sweeps"), *drawn, marks)


def _plot(gui: viser.GuiApi, title: str, series: tuple, data: tuple, distribution: int):
    return gui.add_uplot(
        data=data,
        series=series,
        title=title,
        scales={"x": uplot.Scale(time=False), "y": uplot.Scale(distr=distribution)},
        axes=(uplot.Axis(label="sweeps", labelSize=20, size=34), uplot.Axis(size=58)),
        height=215,
        padding=(12, 16, 0, 0),
    )


def dots(size: float, stroke: str, fill: str) -> dict:
    """Points of a series : round, `size` pixels across."""
    return {"show": True, "size": size, "width": 1.5, "stroke": stroke, "fill": fill}
