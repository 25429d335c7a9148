"""The tab Race: solvers from the same start, compared in a table, in curves, and as marks in the scene."""

from __future__ import annotations

import itertools
from html import escape

import numpy as np
import viser
from viser import uplot

from ... import solvers
from ...graphics.markers import solver_mark
from ..background.comparison import ComparisonSetup, ComparisonWorker, RunSummary
from ..gui import html
from ..gui.binding import Binding
from ..gui.plots import Plot, decades_of
from ..server.client_values import bounded, one_of
from .solver import MAX_SEED, STARTS

ALL = "all"
INTERVAL = 0.5  # s between two updates of the curves
MIN_ERROR = 1e-3  # mm, drawn for anything below: logarithms have no zero
IMPOSSIBLE = "No race: it needs a two-dimensional sound field and a search domain."


def combinations() -> dict[str, tuple[str, ...]]:
    """Return which solvers can be compared, by label: all that need no known room, and each two of them."""
    names = tuple(name for name in solvers.names() if not solvers.load(name).TRAITS.needs_room)
    return {ALL: names} | {", ".join(pair): pair for pair in itertools.combinations(names, 2)}


class ComparisonTab:
    """Owns the controls of the tab."""

    def __init__(self, binding: Binding, worker: ComparisonWorker):
        self._binding, self._worker, self._updated = binding, worker, -1e9
        self._shown: tuple[RunSummary, ...] | None = None
        self._names: tuple[str, ...] = ()  # of the solvers that the plots are made for
        self._plots: list[Plot] = []
        problem = binding.run.problem
        self._possible = problem.dimension == 2 and problem.search is not None
        if self._possible:
            self._add_controls()
        else:
            binding.gui.add_html(html.remark(IMPOSSIBLE))

    def _add_controls(self) -> None:
        gui, worker = self._binding.gui, self._worker
        self._combinations = combinations()
        self.solvers = gui.add_dropdown("Solvers", tuple(self._combinations), initial_value=ALL)
        self.start = gui.add_dropdown("Start from", STARTS, initial_value="random", hint="The same for all solvers")
        self.seed = gui.add_number(
            "Random seed", self._binding.choices.seed, min=0, max=MAX_SEED, step=1,
            hint="Of the random start, and of the order in which descent moves the microphones",
        )  # fmt: skip
        self.run = gui.add_button("Start", icon=viser.Icon.FLAG, hint="Start; press again to pause and to resume")
        self.restart = gui.add_button_group("", ("Reset", "Clear"), visible=False, hint="Restart or clear the race")
        self.marks = gui.add_checkbox("Show in the scene", True, hint="Mark the estimates of each solver")
        self.table = gui.add_html("")
        self._folder = gui.add_folder(None)  # of the plots, which are made when the solvers are known
        self._binding.on(self.run, lambda _: worker.toggle(self.setup))
        self._binding.on(self.restart, lambda value: (worker.reset if value == "Reset" else worker.stop)())

    @property
    def setup(self) -> ComparisonSetup:
        """What the controls show, bounded."""
        names = self._combinations[one_of(self.solvers.value, self._combinations, ALL)]
        seed = bounded(self.seed.value, 0, MAX_SEED, 0)
        return ComparisonSetup(names, one_of(self.start.value, STARTS, "random"), seed)

    def marked(self, summaries: tuple[RunSummary, ...]) -> tuple[RunSummary, ...]:
        """Return the runs whose estimates are marked in the scene."""
        return summaries if self._possible and self.marks.value else ()

    def show(self, summaries: tuple[RunSummary, ...], now: float) -> None:
        """Bring the tab up to date; called by the main loop."""
        if not self._possible:
            return
        binding, worker = self._binding, self._worker
        binding.send("comparison label", worker.button_label, self.run, "label")
        binding.send("comparison finished", worker.finished, self.run, "disabled")
        binding.send("comparison started", bool(summaries), self.restart, "visible")
        binding.send("comparison table", html.complaint(worker.error) + table(summaries), self.table, "content")
        if summaries is not self._shown and now - self._updated >= INTERVAL:
            self._updated, self._shown = now, summaries
            self._show_curves(summaries)

    def _show_curves(self, summaries: tuple[RunSummary, ...]) -> None:
        names = tuple(summary.name for summary in summaries)
        ready = bool(summaries) and all(len(summary.times) for summary in summaries)
        if not ready or names != self._names:
            for plot in self._plots:
                plot.remove()
            self._names, self._plots = names, []
        if not ready:
            return
        columns = curve_columns(summaries)
        if not self._plots:
            with self._folder:
                self._plots = [self._plot(title, names) for title in columns]
        for plot, data in zip(self._plots, columns.values(), strict=True):
            plot.show(data, decades_of(*data[1:]) if "error" in plot.title else None)

    def _plot(self, title: str, names: tuple[str, ...]) -> Plot:
        marks = {name: solver_mark(name) for name in names}
        drawn = [
            uplot.Series(label=name, stroke=mark.colour, width=2.5, dash=mark.dash, points={"show": False})
            for name, mark in marks.items()
        ]
        series = (uplot.Series(label="s"), *drawn)
        return Plot(self._binding.gui, title, series, "processor time (s)", height=200)


def curve_columns(summaries: tuple[RunSummary, ...]) -> dict[str, tuple[np.ndarray, ...]]:
    """Return the columns of the plots, by title: processor time (s), and a curve for each run.

    All curves share one axis, with each time at which one of them has a point; between its points a curve is constant.

    Parameters
    ----------
    summaries : of runs with at least one point each

    Returns
    -------
    dict
        Title to tuple of (P,) float64.
    """
    axis = np.unique(np.concatenate([summary.times for summary in summaries]))
    errors = [summary.mean_errors for summary in summaries if summary.mean_errors is not None]
    curves = {"Mean position error (mm)": [np.maximum(error, MIN_ERROR) for error in errors]} if errors else {}
    curves["Cost (Eq. 7, all modes; dB re the power)"] = [summary.costs for summary in summaries]
    held = [np.maximum(np.searchsorted(run.times, axis, side="right") - 1, 0) for run in summaries]
    return {
        title: (axis, *(values[at] for values, at in zip(runs, held, strict=True))) for title, runs in curves.items()
    }


def table(summaries: tuple[RunSummary, ...]) -> str:
    """Return time, steps, error and cost of each run as HTML."""
    rows = []
    for summary in summaries:
        mark = solver_mark(summary.name)
        dashes = ",".join(map(str, mark.dash))
        line = (
            f"<svg width='30' height='10'><line x1='0' y1='5' x2='30' y2='5' stroke='{mark.colour}' stroke-width='3'"
            f" stroke-dasharray='{dashes}'/></svg> {mark.shape}"
        )
        error = ""
        if summary.mean_error is not None:
            error = f"error: mean {summary.mean_error:.3g} mm, largest {summary.largest_error:.3g} mm<br>"
        cost = f"cost {summary.costs[-1]:.1f} dB" if len(summary.costs) else ""
        rows.append(
            f"<tr><td style='padding-right: 0.6em; vertical-align: top; white-space: nowrap'>{line}</td><td>"
            f"<b>{escape(summary.name)}</b>: {escape(summary.status)}<br>"
            f"{summary.seconds:.2f} s, {summary.step} steps<br>{error}{cost}</td></tr>"
        )
    if not rows:
        return ""
    return f"<div style='{html.CARD}'><table style='border-spacing: 0 0.2em'>{''.join(rows)}</table></div>"
