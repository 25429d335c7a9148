"""The tab Curves: error and cost against sweeps."""

from typing import Any

import numpy as np
from viser import uplot

from ...graphics.picture import row_word
from ...model.validation import evenly_spaced
from ..plots import BLUE, ORANGE, RED, Plot, decades_of
from ..state import Binding, PageState, Tab

MAX_POINTS = 600  # of a plot, all of which are sent each time
ZERO = 1e-9  # mm, drawn below the axis in place of an error of zero, which has no logarithm


class CurvesTab(Tab):
    """Owns the plots and their numbers; `error` is the plot of the position errors, or None if they are unknown."""

    part, where = "curves", "Curves"
    interval = 0.25

    def __init__(self, binding: Binding):
        gui, measurement, sought = binding.gui, binding.measurement, binding.run.sought
        self._measurement, self._free = measurement, max(measurement.count - len(measurement.known), 1)
        self._sought = sought  # microphones whose errors are averaged
        self._states: list[Any] = []  # the states of `_rows`
        self._rows: list[tuple] = []  # sweeps, mean error, largest error
        self._decades = range(0)  # of the errors of this run so far
        self.error: Plot | None = None
        if measurement.positions is not None:
            series = (
                uplot.Series(label="sweeps"),
                uplot.Series(label="mean", stroke=RED, width=2.0),
                uplot.Series(label="largest", stroke=ORANGE, width=1.25),
            )
            aligned = ", aligned" if measurement.blind else ""
            title = f"{'Deviation from nominal' if measurement.nominal else 'Position error'} (mm{aligned})"
            self.error = Plot(gui, title, series, "sweeps")
        title = f"Cost (Eq. 7, all {row_word(measurement)}s; dB re the power)"
        series = uplot.Series(label="sweeps"), uplot.Series(label="cost", stroke=BLUE, width=2.0)
        self.cost = Plot(gui, title, series, "sweeps")
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
        drawn = evenly_spaced(len(self._rows), MAX_POINTS)
        x, mean, largest = np.array(self._rows, float)[drawn].T
        if self.error is not None:
            errors = np.concatenate([mean, largest])
            decades = decades_of(errors[errors > ZERO] if largest.max() > ZERO else np.array([0.1, 1.0]))
            ends = [*self._decades, *decades]  # so that the axis does not change if a drag discards later states
            self._decades = range(min(ends), max(ends) + 1)
            self.error.show((x, mean, largest), self._decades)
        cost = np.array([view.costs.of(state) for state in self._states])
        known = np.flatnonzero(np.isfinite(cost))
        if len(known):  # the curve is interpolated between the known costs
            self.cost.show((x, np.interp(drawn, known, cost[known])))

    def _row(self, state) -> tuple:
        errors = self._measurement.errors(state.positions, self._sought)
        errors = np.zeros(1) if errors is None else errors[self._sought]
        all_at_once = state.step == state.sweep  # each step of the solver moves all microphones
        finite = (min(max(ZERO, float(1e3 * error)), 1e12) for error in (errors.mean(), errors.max()))  # also of NaN
        return state.step if all_at_once else state.step / self._free, *finite
