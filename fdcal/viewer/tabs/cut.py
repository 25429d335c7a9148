"""A cut through the map, in the tab Map: the cost along a line whose ends are dragged over the map.

It is computed on a thread of its own, mode by mode and summed.
"""

from dataclasses import dataclass, replace

import matplotlib
import numpy as np
from matplotlib.colors import to_hex
from viser import uplot

from ...cost.eq7 import LOWEST
from ...cost.maps import eq7_cut
from ...graphics.picture import row_word
from ...model.measurement import Measurement
from .. import html
from ..binding import Binding, Tab
from ..cost_maps import CostMapRequest, count_label, shown_modes
from ..plots import BLUE, GREY, RED, Plot, dots
from ..prepare import PreparedRun
from ..state import Line, PageState

POINTS = 121  # along the line
MAX_MODES = 12  # that are drawn one by one
NEAR = 0.05  # of the length of the line: a position further from it has no mark in the plot


@dataclass(frozen=True)
class Cut:
    """The cost along a line."""

    request: CostMapRequest  # of the map of Eq. 7 through which it goes
    distance: np.ndarray  # (S,) float64, metres from the first end
    modes: tuple[int, ...]  # those drawn one by one, counted from 1
    single: np.ndarray  # (K, S) float64, dB re the power of all modes of the request
    total: np.ndarray  # (S,) float64, likewise, of their sum
    # estimate, truth: distance of the foot of a position on the line, metres; None where it is not near
    estimate: float | None
    truth: float | None


def cost_along(run: PreparedRun, request: CostMapRequest, line: Line) -> Cut:
    """Return the cost along a line, from one of its ends to the other, metres."""
    n, modes, state = request.microphone, request.modes, request.state
    positions, ends = np.asarray(state.positions), np.array(line)
    points = np.linspace(ends[0], ends[1], POINTS)
    points = np.concatenate([points, np.tile(positions[n, 2:], (POINTS, 1))], axis=1)
    costs = eq7_cut(run.problem, positions, n, modes, request.order_offset or 0, points, state.channels)
    drawn = shown_modes(len(modes), MAX_MODES)
    single, total = (10 * np.log10(np.maximum(cost, LOWEST)) for cost in (costs[drawn], costs.sum(axis=0)))
    truth = run.drawn_truth(positions)
    return Cut(
        request,
        np.linspace(0.0, float(np.linalg.norm(ends[1] - ends[0])), POINTS),
        tuple(modes[i] for i in drawn),
        single,
        total,
        foot(positions[n, :2], ends),
        None if truth is None else foot(truth[n][:2], ends),
    )


def foot(place, ends: np.ndarray) -> float | None:
    """Return how far along a line the foot of a position lies, metres; None where the position is not near the line.

    `place` (2,) float64, metres; `ends` (2, 2) float64, metres.
    """
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    if length == 0:
        return None
    offset = np.asarray(place, float) - ends[0]
    distance = float(offset @ along / length)
    off = abs(float(along[0] * offset[1] - along[1] * offset[0])) / length
    return distance if 0 <= distance <= length and off <= NEAR * length else None


HIDDEN = -1e4  # dB, where a curve has nothing to show: below the plot
SPAN, STEP = 80.0, 10.0  # dB that the plot shows at most below its highest cost, and to which its ends are rounded
COLOURS = tuple(to_hex(colour) for colour in matplotlib.colormaps["plasma"](np.linspace(0.15, 0.85, MAX_MODES)))


def cut_series(measurement: Measurement) -> tuple[uplot.Series, ...]:
    """Return the series of the plot: distance, single modes, their sum, the estimate and the true position."""
    thin = [uplot.Series(label=f"{row_word(measurement)} {i}", stroke=colour, width=1, points={"show": False})
            for i, colour in enumerate(COLOURS)]  # fmt: skip
    return (
        uplot.Series(label="m"),
        *thin,
        uplot.Series(label="sum", stroke=BLUE, width=3, points={"show": False}),
        uplot.Series(label="estimate", stroke=RED, width=0, points=dots(9, RED, RED)),
        uplot.Series(label=measurement.reference, stroke=GREY, width=0, points=dots(13, GREY, "transparent")),
    )


def cut_columns(cut: Cut) -> tuple[tuple[np.ndarray, ...], tuple[float, float]]:
    """Return the columns of the plot, finite numbers alone, and the ends of its axis, dB."""
    nothing = np.full(len(cut.distance), HIDDEN)
    high = STEP * float(np.ceil(cut.total.max() / STEP))
    low = STEP * float(np.floor(min(cut.total.min(), cut.single.min(initial=np.inf)) / STEP))
    low = max(low, high - SPAN)
    single = [np.maximum(curve, low - STEP) for curve in cut.single]
    marks = [nothing.copy(), nothing.copy()]
    for column, place in zip(marks, (cut.estimate, cut.truth), strict=True):
        if place is not None:
            at = int(np.abs(cut.distance - place).argmin())
            column[at] = max(cut.total[at], low)
    single += [nothing] * (MAX_MODES - len(single))
    return (cut.distance, *single, np.maximum(cut.total, low - STEP), *marks), (low, high)


ALONG_X, ALONG_Y, TO_LOWEST, NO_LINE = "x", "y", "Lowest", "None"
LINES = (ALONG_X, ALONG_Y, TO_LOWEST, NO_LINE)
TITLE = "Cost along the line, Eq. 7 (dB)"
ADVICE = "A cut shows the cost along a line from A to B. Drag its ends over the map."


class CutPanel(Tab):
    """Owns the controls, and the plot."""

    interval = 0.2

    def __init__(self, binding: Binding):
        self._binding, self._shown = binding, None
        self._worker = binding.threads.map(lambda *wanted: cost_along(binding.run, *wanted))
        gui, series = binding.gui, cut_series(binding.measurement)
        hint = "Through the estimate along x, along y, or towards the lowest cost of the map"
        with gui.add_folder("Cut", expand_by_default=False):
            self.lines = binding.on(gui.add_button_group("Line", LINES, hint=hint), self.place)
            self._plot = Plot(gui, TITLE, series, "distance from A (m)", height=230, legend=False)
            self.text = gui.add_html(html.remark(ADVICE))
        self.plots = (self._plot,)

    def place(self, label: str) -> None:
        """Draw one of LINES."""
        if label == NO_LINE:
            self._binding.choose(cut=None)
            return
        binding, state, search = self._binding, self._binding.state, self._binding.run.problem.search
        if search is not None:  # through the estimate, from edge to edge of the search domain
            low = np.array(search.origin[:2])
            high = low + search.step * (np.array(search.shape[:2]) - 1)
            here = np.clip(binding.positions[state.microphone, :2], low, high)
            along = np.array([0.0, 1.0] if label == ALONG_Y else [1.0, 0.0])
            if label == TO_LOWEST and state.drawn is not None and state.drawn.floor is not None:
                apart = state.drawn.floor.lowest[0] - here
                along = apart if np.linalg.norm(apart) > search.step / 10 else along
            binding.choose(cut=line_across(here, along, low, high))

    def show(self, tick: PageState) -> None:
        """Bring the plot up to date."""
        binding, choices = self._binding, self._binding.choices
        if choices.cut is None or choices.cut[0] == choices.cut[1]:
            if self._shown is not None:
                self._shown, self._plot.folder.visible = None, False
            self.text.content = html.remark(ADVICE)
            return
        of_eq7 = replace(choices, objective=False)
        wanted = of_eq7.map_request(binding.run, tick.view, tick.microphone, tick.revision)
        latest = self._worker.newest(wanted, choices.cut)
        if latest is not None and latest.cause is not None:
            self.text.content = html.complaint(latest.cause)
        elif latest is not None and latest.result is not self._shown:
            cut, measurement = latest.result, binding.measurement
            self._shown = cut
            columns, limits = cut_columns(cut)
            self._plot.show(columns, limits=limits)
            self._plot.folder.visible = True
            word, several = row_word(measurement), "s" if len(cut.request.modes) > 1 else ""
            marks = f" <span style='color: {RED}'>&#9679;</span> estimate" if cut.estimate is not None else ""
            if cut.truth is not None:
                marks += f" <span style='color: {GREY}'>&#9675;</span> {measurement.reference} position"
            summed, lowest = count_label(measurement, cut.request.modes), float(cut.distance[cut.total.argmin()])
            self.text.content = (
                f"<div style='{html.CARD}'>microphone {cut.request.microphone}: <b style='color: {BLUE}'>sum of"
                f" {summed}</b>, lowest {lowest:.3f} m from A. Thin, from dark to light:"
                f" {word}{several} {', '.join(map(str, cut.modes))}.{marks}</div>"
            )


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
