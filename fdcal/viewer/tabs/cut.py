"""A cut through the map, below the sweep: the cost along a line whose ends are dragged over the map."""

from __future__ import annotations

import numpy as np

from ...session.history import SessionView
from ..background.cost_maps import CostMap
from ..background.cuts import CutRequest, CutWorker
from ..background.map_panels import map_modes
from ..gui import html
from ..gui.binding import Binding
from ..gui.choices import Line
from ..gui.cut_plot import cut_caption, cut_columns, cut_limits, cut_series
from ..gui.plots import Plot

ALONG_X, ALONG_Y, TO_LOWEST, NO_LINE = "x", "y", "Lowest", "None"
LINES = (ALONG_X, ALONG_Y, TO_LOWEST, NO_LINE)
TITLE = "Cost along the line, Eq. 7 (dB)"
ADVICE = "A cut shows the cost along a line from A to B. Drag its ends over the map."
INTERVAL = 0.2  # s between two updates of the plot


class CutPanel:
    """Owns the controls, the plot and the thread."""

    def __init__(self, binding: Binding):
        self._binding, self._updated, self._shown = binding, -1e9, None
        self._lowest: tuple[float, float] | None = None  # of the map that is shown
        self._microphone = binding.choices.microphone
        self.worker = CutWorker(binding.run)
        gui = binding.gui
        self.lines = gui.add_button_group(
            "Cut", LINES, hint="Through the estimate along x, along y, or towards the lowest cost of the map"
        )
        self._plot = Plot(gui, TITLE, cut_series(binding.measurement), "distance from A (m)", height=230, legend=False)
        self.text = gui.add_html(html.remark(ADVICE))
        binding.on(self.lines, self.place)

    def place(self, label) -> None:
        """Draw one of LINES; ignore any other label."""
        if label == NO_LINE:
            self._binding.choose(cut=None)
        elif label in LINES and self._binding.run.problem.search is not None:
            self._binding.choose(cut=self._line(str(label)))

    def _line(self, label: str) -> Line:
        """Return a line through the estimate, from edge to edge of the search domain."""
        binding, search = self._binding, self._binding.run.problem.search
        if search is None:
            raise ValueError("a cut needs a search domain")  # `place` has checked that there is one
        low = np.array(search.origin[:2])
        high = low + search.step * (np.array(search.shape[:2]) - 1)
        here = np.clip(np.asarray(binding.session.view.state.positions)[self._microphone, :2], low, high)
        along = np.array({ALONG_X: (1.0, 0.0), ALONG_Y: (0.0, 1.0)}.get(label, (1.0, 0.0)))
        if label == TO_LOWEST and self._lowest is not None and np.linalg.norm(self._lowest - here) > search.step / 10:
            along = self._lowest - here
        return line_across(here, along, low, high)

    def show(self, view: SessionView, revision: int, microphone: int, drawn: CostMap | None, now: float) -> None:
        """Bring the plot up to date; called by the main loop."""
        self._microphone = microphone
        self._plot.settle()
        if drawn is not None and drawn.floor is not None:
            self._lowest = drawn.floor.minimum
        binding, choices = self._binding, self._binding.choices
        if choices.cut is None or choices.cut[0] == choices.cut[1]:
            self._clear()
            return
        if now - self._updated < INTERVAL:
            return
        modes = map_modes(binding.run, view.state, choices.modes, choices.order_offset, choices.take)
        wanted = CutRequest(revision, microphone, modes, choices.order_offset, choices.cut, view.state)
        cut, error = self.worker.newest(wanted)
        if error is not None:
            binding.send("cut", html.complaint(error), self.text, "content")
        elif cut is not None and cut is not self._shown:
            self._shown, self._updated = cut, now
            self._plot.show(cut_columns(cut), limits=cut_limits(cut))
            self._plot.visible = True
            binding.send("cut", cut_caption(cut, binding.measurement), self.text, "content")

    def _clear(self) -> None:
        if self._shown is not None:
            self._shown, self._plot.visible = None, False
        self._binding.send("cut", html.remark(ADVICE), self.text, "content")


def line_across(place, along, low, high) -> Line:
    """Return the line through `place` in a direction, cut off at the edges of a rectangle.

    `place` (2,) float64, metres, inside; `along` (2,) float64; `low`, `high` (2,) float64, metres, corners of the
    rectangle.
    """
    place, along = np.asarray(place, float), np.asarray(along, float)
    along = np.where(np.abs(along) < 1e-9 * np.linalg.norm(along), np.nan, along)  # along an edge it meets no edge
    reach = (np.stack([low, high]) - place) / along
    first, last = float(np.nanmax(reach.min(axis=0))), float(np.nanmin(reach.max(axis=0)))
    (ax, ay), (bx, by) = (np.clip(place + t * np.nan_to_num(along), low, high).tolist() for t in (first, last))
    return (ax, ay), (bx, by)
