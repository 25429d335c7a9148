"""Error of each microphone against its distance from the first known one, the paper's Fig. 5: now, and over the run."""

from __future__ import annotations

import numpy as np
import viser
from viser import uplot

from ...model.gauge import position_errors
from ...model.measurement import Measurement
from ...session.history import SessionView
from ..gui.plots import BLUE, PADDING, RED, dots

INTERVAL = 0.5  # s between two sendings
MOST_ERROR = 1e6  # mm, drawn for anything above


class ErrorByDistance:
    """Owns the plot and the sums behind it; nothing is drawn of an array without truth or without known microphones."""

    def __init__(self, gui: viser.GuiApi, measurement: Measurement):
        self._truth, self._sent, self._key = measurement.positions, -1e9, ()
        self._seen: list = []  # states whose errors are in _sums
        self._sums: list[np.ndarray] = []  # of the errors up to each state
        self.plot = None
        if self._truth is None or not len(measurement.known):
            return
        first = measurement.known[0]
        distance = np.linalg.norm(self._truth - self._truth[first], axis=1)
        free = np.setdiff1d(np.arange(measurement.count), measurement.known)
        self._order = free[np.argsort(distance[free], kind="stable")]
        self._x = distance[self._order]
        self.plot = gui.add_uplot(
            data=(self._x, np.zeros(len(self._x)), np.zeros(len(self._x))),
            series=(
                uplot.Series(label="distance (m)"),
                uplot.Series(label="mean over the run", stroke=RED, width=0, points=dots(7, RED, RED)),
                uplot.Series(label="now", stroke=BLUE, width=0, points=dots(7, BLUE, "transparent")),
            ),
            title=f"Error (mm) against distance from known microphone {first}",
            scales={"x": uplot.Scale(time=False)},
            axes=(uplot.Axis(label="distance (m)", labelSize=20, size=34), uplot.Axis(size=48)),
            height=215,
            padding=PADDING,
        )

    def show(self, view: SessionView, now: float) -> None:
        """Called by the main loop. The run is what lies before the state looked at, that one included."""
        key = id(view.state), view.index
        if self.plot is None or key == self._key or now - self._sent < INTERVAL:
            return
        self._key, self._sent = key, now
        self._catch_up(view.history)
        mean = self._sums[view.index] / (view.index + 1)
        here = self._sums[view.index] - (self._sums[view.index - 1] if view.index else 0.0)
        self.plot.data = (self._x, *(_drawable(values[self._order]) for values in (mean, here)))

    def _catch_up(self, history) -> None:
        kept = min(len(self._seen), len(history))
        while kept and self._seen[kept - 1] is not history[kept - 1]:
            kept -= 1
        self._seen[kept:] = history[kept:]
        del self._sums[kept:]
        for state in history[kept:]:
            errors = 1e3 * position_errors(state.positions, self._truth)
            self._sums.append(errors + (self._sums[-1] if self._sums else 0.0))


def _drawable(values: np.ndarray) -> np.ndarray:
    """Finite numbers, as uPlot needs them."""
    return np.clip(np.nan_to_num(values, nan=MOST_ERROR), 0.0, MOST_ERROR)
