"""The tab Curves: error and cost over sweeps; and the class of all plots of the page, which uPlot draws.

A plot stays on the page while its data and axes change. If a plot were removed and added again, it would have no width
for a moment and move the controls below it, and data for the old plot could still arrive.

If the axes change, the page builds a new chart. viser's page keeps the visible part of the abscissa when the extent of
the data changes. If data and axes change at the same time, the page keeps the part of the old chart, and the curve is
drawn in a corner or cut off. The axes are therefore sent some time after the data.

uPlot writes small numbers as 0; therefore errors are drawn in millimetres and costs in decibels. NaN is never sent,
because uPlot would then search for axis ticks endlessly.
"""

import time
from typing import Any

import numpy as np
import viser
from viser import uplot

from ...model.validation import evenly_spaced
from ..state import Binding, PageState, Tab

RED, BLUE, ORANGE = "#d61828", "#1f78c8", "#e08a1e"
MANY_DECADES = 9  # an axis with this number of powers of ten or more has a number only at some of them
WHOLE_STEPS = tuple(sorted({float(step * 10**power) for power in range(7) for step in (1, 2, 5, 25)}))  # between ticks
APART = 0.3  # s, delay of new axes after the data that need them
PADDING = (12, 22, 0, 0)  # pixels; half of the last number extends beyond the axis on the right

# Of the ordinate: the powers of ten on a logarithmic axis; the ends of a linear axis; None: uPlot chooses the axis.
Ends = range | tuple[float, float] | None
Series = tuple[uplot.Series, ...]


class Plot:
    """Owns one plot.

    `title` includes the unit of the ordinate; `series` are those of uPlot, the abscissa first; `x` is the label of the
    abscissa with its unit; the abscissa has ticks at whole numbers only; `height`: pixels; `legend`: whether the plot
    has a legend below it. `data` are the columns on the page; `folder` contains the plot and can be made invisible.
    """

    def __init__(self, gui: viser.GuiApi, title: str, series: Series, x: str, height: int = 215, legend: bool = True):
        self._legend: Any = None if legend else {"show": False}
        self._gui, self._series, self._x, self._height = gui, series, x, height
        self.folder, self.title = gui.add_folder(None), title
        self.handle: viser.GuiUplotHandle | None = None
        self._ends: Ends = None  # ends of the axis on the page
        self._wanted: tuple[tuple[np.ndarray, ...], Ends] = (), None  # data and ends of the last call of `show`
        self.data: tuple[np.ndarray, ...] = ()  # the data on the page
        self._until, self._axes_next = 0.0, False  # time until which nothing is sent, and whether axes are sent next

    def show(self, data: tuple[np.ndarray, ...], ends: Ends = None) -> None:
        """Draw columns of finite numbers: abscissa and ordinates, (P,) float64 each."""
        self._wanted = data, ends
        if self.handle is None:
            self.data, self._ends = data, ends
            with self.folder:
                scales, axes = self._scales_and_axes()
                self.handle = self._gui.add_uplot(
                    data=data, series=self._series, title=self.title, scales=scales, axes=axes, height=self._height,
                    padding=PADDING, legend=self._legend,
                )  # fmt: skip
        self.send_waiting()

    def send_waiting(self) -> None:
        """Send data or axes that wait, after the page has drawn the last ones; called by the main loop."""
        now = time.perf_counter()
        if self.handle is None or now < self._until:
            return
        (data, ends), x = self._wanted, self.data[0]
        if self._axes_next:  # after data of another extent
            self._axes_next, self._until = False, now + APART
        elif data is not self.data:
            self._axes_next = ends != self._ends and (data[0].min(), data[0].max()) != (x.min(), x.max())
            self._until = now + APART if self._axes_next else 0.0
            self.data = self.handle.data = data
        if ends != self._ends and not self._axes_next:
            self._ends = ends
            self.handle.scales, self.handle.axes = self._scales_and_axes()

    def _scales_and_axes(self) -> tuple[dict[str, uplot.Scale], tuple[uplot.Axis, uplot.Axis]]:
        y, axis = uplot.Scale(), uplot.Axis(size=58)
        if isinstance(self._ends, tuple):
            y = uplot.Scale(range=self._ends)
        elif self._ends is not None:
            splits = tuple(10.0**power for power in self._ends)
            apart = 1 + len(splits) // MANY_DECADES
            numbers = tuple(f"{split:,g}" if i % apart == 0 else "" for i, split in enumerate(splits))
            y = uplot.Scale(distr=3, range=(splits[0], splits[-1]))
            axis = uplot.Axis(size=58, splits=splits, values=numbers)
        scales = {"x": uplot.Scale(time=False), "y": y}
        return scales, (uplot.Axis(label=self._x, labelSize=20, size=34, incrs=WHOLE_STEPS), axis)


def dots(size: float, stroke: str, fill: str) -> Any:
    """Return the points of a series: round, `size` pixels across; colours as in CSS."""
    return {"show": True, "size": size, "width": 1.5, "stroke": stroke, "fill": fill}


MAX_POINTS = 600  # largest number of points of a plot; every update sends all of them
ZERO = 1e-9  # mm; it replaces an error of zero, which has no logarithm, and lies below the axis


class CurvesTab(Tab):
    """Owns the plots and their numbers; `error` is the plot of the position errors, or None if they are unknown."""

    part, where = "curves", "Curves"
    interval = 0.25

    def __init__(self, binding: Binding):
        gui, measurement, sought = binding.gui, binding.measurement, binding.run.sought
        self._measurement, self._free = measurement, max(measurement.count - len(measurement.known), 1)
        self._sought = sought  # microphones whose errors are averaged
        self._states: list[Any] = []  # the states of `_rows`
        self._rows: list[tuple] = []  # sweeps; mean and largest error, mm
        self._decades = range(0)  # decades of the errors of this run so far
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
        title = "Cost (Eq. 7, all frequencies; dB re the power)"
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
        self._states[kept:], self._rows[kept:] = history[kept:], []
        for one in history[kept:]:
            errors = self._measurement.errors(one.positions, self._sought)
            errors = np.zeros(1) if errors is None else errors[self._sought]
            # a finite number, even if the error is NaN
            finite = (min(max(ZERO, float(1e3 * error)), 1e12) for error in (errors.mean(), errors.max()))
            all_at_once = one.step == one.sweep  # each step of the solver moves all microphones
            self._rows.append((one.step if all_at_once else one.step / self._free, *finite))
        drawn = evenly_spaced(len(self._rows), MAX_POINTS)
        x, mean, largest = np.array(self._rows, float)[drawn].T
        if self.error is not None:
            errors = np.concatenate([mean, largest])
            # the powers of ten between which the errors lie; uPlot's own grid has too many lines and numbers
            powers = np.log10(errors[errors > ZERO] if largest.max() > ZERO else [0.1, 1.0])
            first, last = int(np.floor(powers.min() + 1e-9)), int(np.ceil(powers.max() - 1e-9))
            # so that the axis does not change if a drag discards later states
            ends = [*self._decades, first, last, first + 1]
            self._decades = range(min(ends), max(ends) + 1)
            self.error.show((x, mean, largest), self._decades)
        cost = np.array([view.costs.of(state) for state in self._states])
        known = np.flatnonzero(np.isfinite(cost))
        if len(known):  # the curve is interpolated between the known costs
            self.cost.show((x, np.interp(drawn, known, cost[known])))
