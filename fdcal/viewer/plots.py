"""A plot by uPlot that stays in its place while its data, title and axes change, and common colours of curves.

A plot that is removed and added again has no width for a moment, in which it pushes what is below it off the screen,
and data for the old one may still be on their way.

Other axes make the page build a new chart. viser's page keeps the part of the abscissa that is
seen, from one extent of the data to the next, and takes it from a chart that is gone where both change at once: the
curve is then drawn in a corner, or cut off. So the page is given time to draw one before the other is sent.

uPlot writes small numbers as 0, so errors are drawn in millimetres and costs in decibels. A NaN makes it search for
axis ticks without end, so none is sent.
"""

import time
from typing import Any

import numpy as np
import viser
from viser import uplot

RED, BLUE, ORANGE, GREY = "#d61828", "#1f78c8", "#e08a1e", "#8a8f98"
MAX_NUMBERED_DECADES = 9  # decades that have a number each on the axis
WHOLE_STEPS = tuple(float(step * 10**power) for power in range(7) for step in (1, 2, 5))  # between ticks
APART = 0.3  # s between data of another extent and other axes
PADDING = (12, 22, 0, 0)  # pixels; on the right the last number extends half beyond the axis

# Of the ordinate: powers of ten between the ends of a logarithmic axis, the ends of a linear one, or uPlot's own.
Ends = range | tuple[float, float] | None


class Plot:
    """Owns one plot.

    `title`: with the unit of the ordinate; `series`: of uPlot, the abscissa first; `x`: label of the abscissa, with its
    unit; `scales`: further scales of uPlot, by name; `height`: pixels; `whole`: whether the abscissa has ticks at whole
    numbers alone, at any zoom; `legend`: whether the plot has a legend below. `data`: the columns that the page has;
    `folder`: holds the plot, and can be made invisible.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        title: str,
        series: tuple[uplot.Series, ...],
        x: str,
        scales: dict[str, uplot.Scale] | None = None,
        height: int = 215,
        whole: bool = False,
        legend: bool = True,
    ):
        self._legend: Any = None if legend else {"show": False}
        self._steps: dict[str, Any] = {"incrs": WHOLE_STEPS} if whole else {}
        self._gui, self._series, self._x, self._scales, self._height = gui, series, x, scales or {}, height
        self.folder, self.title = gui.add_folder(None), title
        self.handle: viser.GuiUplotHandle | None = None
        self._ends: Ends = None  # of the axis that the page has
        self._wanted: tuple[tuple[np.ndarray, ...], Ends] = (), None  # data and ends that were shown last
        self.data: tuple[np.ndarray, ...] = ()  # the data that the page has
        self._until, self._axes_next = 0.0, False  # when something may be sent again, and whether these are axes

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
        self.settle()

    def settle(self) -> None:
        """Send what waits until the page has drawn what was sent before; called by the main loop."""
        now = time.perf_counter()
        if self.handle is None or now < self._until:
            return
        data, ends = self._wanted
        if self._axes_next:  # after data of another extent
            self._axes_next, self._until = False, now + APART
        elif data is not self.data:
            self._axes_next = ends != self._ends and _extent(data) != _extent(self.data)
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
            apart = 1 + len(splits) // MAX_NUMBERED_DECADES
            numbers = tuple(f"{split:,g}" if i % apart == 0 else "" for i, split in enumerate(splits))
            y = uplot.Scale(distr=3, range=(splits[0], splits[-1]))
            axis = uplot.Axis(size=58, splits=splits, values=numbers)
        scales = {"x": uplot.Scale(time=False), "y": y, **self._scales}
        return scales, (uplot.Axis(label=self._x, labelSize=20, size=34, **self._steps), axis)


def _extent(data: tuple[np.ndarray, ...]) -> tuple[float, float]:
    """Return the ends of the abscissa."""
    return float(data[0].min()), float(data[0].max())


def decades_of(*curves: np.ndarray) -> range:
    """Return the powers of ten between which all numbers of the curves lie.

    uPlot's own grid has too many lines and numbers.

    `curves` (P,) float64 each, above zero. Returns range, at least two powers.
    """
    powers = np.log10(np.concatenate(curves))
    first, last = int(np.floor(powers.min() + 1e-9)), int(np.ceil(powers.max() - 1e-9))
    return range(first, max(last, first + 1) + 1)


def dots(size: float, stroke: str, fill: str) -> Any:
    """Return the points of a series: round, `size` pixels across; colours as in CSS."""
    return {"show": True, "size": size, "width": 1.5, "stroke": stroke, "fill": fill}
