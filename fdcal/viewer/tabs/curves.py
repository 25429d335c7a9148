"""The tab Curves: error and cost against sweeps, with a tick where a stage or another start begins.

The ticks have their own scale, from 0 at the bottom to 1 at the top. They are short and at the top, so that they hide
neither the curves nor the axis. The number of the stage is in the legend.
"""

from typing import Any

import numpy as np
from viser import uplot

from ...graphics.picture import row_word
from ...model.validation import evenly_spaced
from ..plots import BLUE, GREY, ORANGE, RED, Plot, decades_of
from ..state import Binding, PageState, Tab

MAX_POINTS = 600  # of a plot, all of which are sent each time
ZERO = 1e-9  # mm, drawn below the axis in place of an error of zero, which has no logarithm
TICK, HIDDEN = 0.92, 2.0  # lower end of a tick; a height above the plot
SCALES = {"stage": uplot.Scale(range=(0.0, 1.0)), "number": uplot.Scale(range=(0.0, 1e4))}
# The ticks have no value in the legend, and the number of a stage has no point in the plot.
REMARK = (
    "<style>.u-legend .fdcal-lines, .u-cursor-pt:is(.fdcal-lines, .fdcal-stage) {display: none}</style>"
    "<div style='padding: 0 0.75em; font-size: var(--note); opacity: 0.75'>Grey ticks at the top: a new stage (mode or"
    " objective changed) or another start. Hover to read values.</div>"
)


class CurvesTab(Tab):
    """Owns the plots and their numbers; `error` is the plot of the position errors, or None if they are unknown."""

    part, where = "curves", "Curves"
    interval = 0.25

    def __init__(self, binding: Binding):
        gui, measurement, sought = binding.gui, binding.measurement, binding.run.sought
        self._measurement, self._free = measurement, max(measurement.count - len(measurement.known), 1)
        self._sought = sought  # microphones whose errors are averaged
        self._states: list[Any] = []  # the states of `_rows`
        self._rows: list[tuple] = []  # sweeps, mean error, largest error, last mode in use, stage, restart
        self._decades = range(0)  # of the errors of this run so far
        self.error: Plot | None = None
        if measurement.positions is not None:
            series = _series(("mean", RED, 2.0), ("largest", ORANGE, 1.25))
            aligned = ", aligned" if measurement.blind else ""
            title = f"{'Deviation from nominal' if measurement.nominal else 'Position error'} (mm{aligned})"
            self.error = Plot(gui, title, series, "sweeps", SCALES, whole=True)
        title = f"Cost (Eq. 7, all {row_word(measurement)}s; dB re the power)"
        self.cost = Plot(gui, title, _series(("cost", BLUE, 2.0)), "sweeps", SCALES, whole=True)
        gui.add_html(REMARK)
        self.plots = tuple(filter(None, (self.error, self.cost)))

    def inputs(self, state: PageState) -> tuple:
        """Return the values on which the curves depend."""
        view = state.view
        return view.history[-1], view.count, view.lineage, view.costs.count, state.sought

    def show(self, state: PageState) -> None:
        """Update the plots."""
        view, sought = state.view, state.sought
        if sought is not None and not np.array_equal(sought, self._sought):
            self._sought, self._states, self._rows, self._decades = sought, [], [], range(0)
        history, kept = view.history, min(len(self._states), len(view.history))
        while kept and self._states[kept - 1] is not history[kept - 1]:
            kept -= 1
        self._decades = self._decades if kept else range(0)
        self._states[kept:], self._rows[kept:] = history[kept:], [self._row(one) for one in history[kept:]]
        x, mean, largest, last, stage, restart = np.array(self._rows, float).T
        drawn = evenly_spaced(len(x), MAX_POINTS)
        begins = np.flatnonzero((np.diff(last) > 0) | (np.diff(stage) > 0) | (np.diff(restart) != 0)) + 1
        if self.error is not None:
            drawn_errors = np.concatenate([mean, largest])
            decades = decades_of(drawn_errors[drawn_errors > ZERO] if largest.max() > ZERO else np.array([0.1, 1.0]))
            ends = [*self._decades, *decades]  # so that the axis does not change if a drag discards later states
            self._decades = range(min(ends), max(ends) + 1)
            self.error.show(_with_ticks(x, (mean, largest), drawn, begins, stage), self._decades)
        cost = np.array([view.costs.of(state) for state in self._states])
        known = np.flatnonzero(np.isfinite(cost))
        if len(known):  # the curve is interpolated between the known costs
            cost = np.interp(np.arange(len(cost)), known, cost[known])
            self.cost.show(_with_ticks(x, (cost,), drawn, begins, stage))

    def _row(self, state) -> tuple:
        errors = self._measurement.errors(state.positions, self._sought)
        errors = np.zeros(1) if errors is None else errors[self._sought]
        # finite numbers, also where an error is NaN
        all_at_once = state.step == state.sweep  # each step of the solver moves all microphones
        return (
            state.step if all_at_once else state.step / self._free,
            *(min(max(ZERO, float(1e3 * error)), 1e12) for error in (errors.mean(), errors.max())),
            state.last,
            state.stage,
            state.restart,
        )


def _with_ticks(x, curves, drawn, begins, stage) -> tuple[np.ndarray, ...]:
    """Return the columns of a plot: curves at the `drawn` points, a tick at each of `begins`, number of the stage."""
    at = np.concatenate([drawn, np.repeat(begins, 3)])
    order = np.argsort(x[at], kind="stable")
    ticks = np.full(len(at), HIDDEN)
    ticks[len(drawn) + 1 :: 3] = TICK
    return (x[at][order], *(one[at][order] for one in curves), ticks[order], stage[at][order] + 1)


def _series(*curves: tuple[str, str, float]) -> tuple[uplot.Series, ...]:
    """Return the series of a plot: sweeps, the curves (label, colour, width), ticks and numbers of stages."""
    drawn = [uplot.Series(label=name, stroke=colour, width=width) for name, colour, width in curves]
    points: Any = {"show": False}
    css: dict[str, dict[str, Any]] = {name: {"class": f"fdcal-{name}"} for name in ("lines", "stage")}
    ticks = uplot.Series(label="", scale="stage", width=2, **css["lines"], stroke=GREY, points=points)
    number = uplot.Series(label="stage", scale="number", width=0, **css["stage"], stroke=GREY, points=points)
    return (uplot.Series(label="sweeps"), *drawn, ticks, number)
