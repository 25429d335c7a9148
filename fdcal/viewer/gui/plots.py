"""A plot by uPlot that is made again only where its title or its decades change, and common colours of curves.

uPlot writes small numbers as 0, so errors are drawn in millimetres and costs in decibels. A NaN makes it search for
axis ticks without end, so none is sent.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import viser
from viser import uplot

RED, BLUE, ORANGE, GREY = "#d61828", "#1f78c8", "#e08a1e", "#8a8f98"
MAX_NUMBERED_DECADES = 9  # decades that have a number each on the axis
PADDING = (12, 22, 0, 0)  # pixels; on the right the last number extends half beyond the axis


class Plot:
    """Owns one plot.

    Parameters
    ----------
    gui : viser.GuiApi
    title : with the unit of the ordinate
    series : of uPlot, the abscissa first
    x : label of the abscissa, with its unit
    scales : further scales of uPlot, by name
    height : pixels
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        title: str,
        series: tuple[uplot.Series, ...],
        x: str,
        scales: dict[str, uplot.Scale] | None = None,
        height: int = 215,
    ):
        self._gui, self._series, self._x, self._scales, self._height = gui, series, x, scales or {}, height
        self._folder, self.title, self.decades = gui.add_folder(None), title, None
        self.handle: viser.GuiUplotHandle | None = None

    @property
    def data(self) -> tuple[np.ndarray, ...]:
        """The columns that are drawn; empty before the first."""
        return () if self.handle is None else self.handle.data

    def show(self, data: tuple[np.ndarray, ...], decades: range | None = None, title: str | None = None) -> None:
        """Draw columns of finite numbers.

        Parameters
        ----------
        data : abscissa and ordinates, (P,) float64 each
        decades : powers of ten between the ends of a logarithmic axis; None for a linear axis with uPlot's own ends
        title : a new title, or None to keep the present one
        """
        title = title or self.title
        if self.handle is not None and (title, decades) == (self.title, self.decades):
            self.handle.data = data
            return
        self.title, self.decades = title, decades
        if self.handle is not None:
            self.handle.remove()
        with self._folder:
            self.handle = self._make(data)

    def _make(self, data: tuple[np.ndarray, ...]) -> viser.GuiUplotHandle:
        y, axis = uplot.Scale(), uplot.Axis(size=58)
        if self.decades is not None:
            splits = tuple(10.0**power for power in self.decades)
            apart = 1 + len(splits) // MAX_NUMBERED_DECADES
            numbers = tuple(f"{split:,g}" if i % apart == 0 else "" for i, split in enumerate(splits))
            y = uplot.Scale(distr=3, range=(splits[0], splits[-1]))
            axis = uplot.Axis(size=58, splits=splits, values=numbers)
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
        """Remove the plot from the panel."""
        self._folder.remove()


def decades_of(*curves: np.ndarray) -> range:
    """Return the powers of ten between which all numbers of the curves lie.

    uPlot's own grid has too many lines and numbers.

    Parameters
    ----------
    curves : (P,) float64 each, above zero

    Returns
    -------
    range
        At least two powers.
    """
    powers = np.log10(np.concatenate(curves))
    first, last = int(np.floor(powers.min() + 1e-9)), int(np.ceil(powers.max() - 1e-9))
    return range(first, max(last, first + 1) + 1)


def dots(size: float, stroke: str, fill: str) -> Any:
    """Return the points of a series: round, `size` pixels across; colours as in CSS."""
    return {"show": True, "size": size, "width": 1.5, "stroke": stroke, "fill": fill}
