"""Error and cost against sweeps, with a mark where a stage began: a mode came in, or the solver changed its goal.

uPlot writes small numbers as 0, so errors are in millimetres and costs in decibels, or as they are where a cost is a
likelihood, which may be negative. A NaN makes it search for axis ticks for ever, so none is ever sent.

The marks have a scale of their own, from 0 at the bottom to 1 at the top: strokes as long as there are few of them,
ticks at the bottom where there are so many that they would hide the curves. Which stage it is stands in the legend.
"""

from __future__ import annotations

import numpy as np
import viser
from viser import uplot

from ...model.measurement import Measurement
from ...session.history import SessionView

MOST_POINTS = 600  # a plot is sent whole each time
INTERVAL = 0.25  # s between two sendings
LEAST_ERROR, LEAST_COST = 1e-6, 1e-12  # m and 1, drawn for anything below: logarithms have no zero
COSTS = {True: "Cost of the modes in use (dB re 1)", False: "Cost of the modes in use (-log likelihood)"}
FEW, TICK, UNSEEN = 10, 0.06, -1.0  # stages that get strokes from top to bottom; height of the others' marks; nowhere
STAGES = (  # strokes have no number of their own, and the number of a stage has no place in the plot
    "<style>.u-legend .fdcal-strokes, .u-cursor-pt.fdcal-strokes, .u-cursor-pt.fdcal-stage {display: none}</style>"
    "<div style='padding: 0 0.75em; font-size: 0.8em; opacity: 0.75'>Grey marks: a stage begins, with a mode more or"
    " another goal. Point at a curve to read it off.</div>"
)
MOST_DECADES = 9  # that have a number each
MARKS = {"mark": uplot.Scale(range=(0.0, 1.0)), "number": uplot.Scale(range=(0.0, 1e4))}
PADDING = (12, 22, 0, 0)  # pixels; on the right the last number stands half beyond the axis
RED, BLUE, ORANGE, GREY = "#d61828", "#1f78c8", "#e08a1e", "#8a8f98"


class Curves:
    """Owns the two plots and the numbers behind them."""

    def __init__(self, gui: viser.GuiApi, measurement: Measurement):
        self._measurement, self._free = measurement, max(measurement.count - len(measurement.known), 1)
        self._seen: list = []  # states whose numbers are in _rows
        self._rows: list[tuple] = []  # sweeps, mean error, largest error, cost, last mode in use, stage
        self._sent = -1e9
        self._error: Plot | None = None
        if measurement.positions is not None:
            series = _series(("mean", RED, 2.0), ("largest", ORANGE, 1.25))
            title = "Position error (mm, once aligned)" if measurement.blind else "Position error (mm)"
            self._error = Plot(gui, title, series, "sweeps", MARKS)
        self._cost = Plot(gui, COSTS[True], _series(("cost", BLUE, 2.0)), "sweeps", MARKS)
        gui.add_html(STAGES)

    def show(self, view: SessionView, now: float) -> None:
        """Bring the plots up to date, not too often."""
        if now - self._sent < INTERVAL or not self._catch_up(view.history):
            return
        self._sent = now
        x, mean, largest, cost, last, stage = np.array(self._rows, float).T
        chosen = np.unique(np.linspace(0, len(x) - 1, min(len(x), MOST_POINTS)).round().astype(int))
        came_in = np.flatnonzero((np.diff(last) > 0) | (np.diff(stage) > 0)) + 1
        if self._error is not None:
            self._error.show(_with_marks(x, (mean, largest), chosen, came_in, stage), decades(mean, largest))
        decibels = bool((cost > 0).all())
        if decibels:
            cost = 10 * np.log10(cost)
        self._cost.show(_with_marks(x, (cost,), chosen, came_in, stage), title=COSTS[decibels])

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


def _with_marks(x, curves, chosen, came_in, stage) -> tuple[np.ndarray, ...]:
    """Data of a plot: the curves at the `chosen` points, a mark at each of `came_in`, and the stage's number from 1."""
    at = np.concatenate([chosen, np.repeat(came_in, 3)])
    order = np.argsort(x[at], kind="stable")
    top = 1.0 if len(came_in) <= FEW else TICK
    marks = np.concatenate([np.full(len(chosen), UNSEEN), np.tile([UNSEEN, top, UNSEEN], len(came_in))])
    return (x[at][order], *(curve[at][order] for curve in curves), marks[order], stage[at][order] + 1)


def _series(*curves) -> tuple:
    drawn = [uplot.Series(label=name, stroke=colour, width=width) for name, colour, width in curves]
    unseen = {"points": {"show": False}, "stroke": GREY}
    strokes = uplot.Series(label="", scale="mark", width=1, dash=(4, 4), **{"class": "fdcal-strokes"}, **unseen)
    number = uplot.Series(label="stage", scale="number", width=0, **{"class": "fdcal-stage"}, **unseen)
    return (uplot.Series(label="sweeps"), *drawn, strokes, number)


class Plot:
    """Owns one plot. What only uPlot's making can set - title, decades - has it made anew, in the same place."""

    def __init__(self, gui: viser.GuiApi, title: str, series: tuple, x: str, scales: dict | None = None, height=215):
        self._gui, self._series, self._x, self._scales, self._height = gui, series, x, scales or {}, height
        self._place, self.handle, self._made = gui.add_folder(None), None, (title, None)

    @property
    def data(self) -> tuple[np.ndarray, ...]:
        return self.handle.data

    @property
    def title(self) -> str:
        return self._made[0]

    @property
    def decades(self) -> range | None:
        """Powers of ten at the axis."""
        return self._made[1]

    def show(self, data: tuple, powers: range | None = None, title: str | None = None) -> None:
        """Draw columns of numbers; over whole decades, from the first of `powers` to the last, or as uPlot has it."""
        wanted = (title or self.title, powers)
        if self.handle is not None and wanted == self._made:
            self.handle.data = data
            return
        self._made = wanted
        if self.handle is not None:
            self.handle.remove()
        with self._place:
            self.handle = self._make(data)

    def _make(self, data: tuple):
        y, axis = uplot.Scale(), uplot.Axis(size=58)
        if self.decades is not None:
            splits = tuple(10.0**power for power in self.decades)
            apart = 1 + len(splits) // MOST_DECADES
            numbers = tuple(f"{split:,g}" if i % apart == 0 else "" for i, split in enumerate(splits))
            y, axis = (
                uplot.Scale(distr=3, range=(splits[0], splits[-1])),
                uplot.Axis(size=58, splits=splits, values=numbers),
            )
        return self._gui.add_uplot(
            data=data,
            series=self._series,
            title=self.title,
            scales={"x": uplot.Scale(time=False), "y": y, **self._scales},
            axes=(uplot.Axis(label=self._x, labelSize=20, size=34), axis),
            height=self._height,
            padding=PADDING,
        )

    def remove(self) -> None:
        """Take it away."""
        self._place.remove()


def decades(*curves) -> range:
    """The powers of ten between which all numbers of the curves lie; uPlot's own lines and numbers are too many."""
    seen = np.log10(np.concatenate(curves))
    first, last = int(np.floor(seen.min() + 1e-9)), int(np.ceil(seen.max() - 1e-9))
    return range(first, max(last, first + 1) + 1)


def dots(size: float, stroke: str, fill: str) -> dict:
    """Points of a series : round, `size` pixels across."""
    return {"show": True, "size": size, "width": 1.5, "stroke": stroke, "fill": fill}
