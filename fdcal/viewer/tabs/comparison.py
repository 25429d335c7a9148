"""The tab Race: solvers from the same start, compared in a table, in curves, and as marks in the scene."""

import itertools
from html import escape

import numpy as np
import viser
from viser import uplot

from ... import solvers
from ...graphics.annotations import COMPARED, compared_entry
from ...graphics.markers import solver_mark
from ...graphics.picture import cost_title
from ...model.measurement import Measurement
from ...model.texts import length_text
from ..background.comparison import ComparisonSetup, ComparisonWorker, RunSummary
from ..gui import html
from ..gui.binding import Binding, Same, Tab, Tick
from ..gui.legend_html import symbol
from ..gui.plots import Plot, decades_of
from .solver import MAX_SEED, STARTS

ALL = "all"
INTERVAL = 0.5  # s between two updates of the curves
PLOT_HEIGHT = 150  # pixels; with them the whole tab has room in a window 720 pixels high
MIN_ERROR = 1e-3  # mm, drawn for anything below: logarithms have no zero
NO_SEARCH = (
    "No race: the file has no search domain, and the positions could not be estimated to make one. Add search_origin,"
    " search_size, search_step and radius (metres) to the file of the measurement."
)


def combinations() -> dict[str, tuple[str, ...]]:
    """Return which solvers can be compared, by label: all that need no known room, and each two of them."""
    names = tuple(name for name in solvers.names() if not solvers.load(name).TRAITS.needs_room)
    return {ALL: names} | {", ".join(pair): pair for pair in itertools.combinations(names, 2)}


class ComparisonTab(Tab):
    """Owns the controls of the tab, and the race.

    `worker`: prepares the race and runs it.
    """

    def __init__(self, binding: Binding):
        self._binding, self.worker, self._updated = binding, ComparisonWorker(binding.run, binding.threads), -1e9
        self._shown: tuple[RunSummary, ...] | None = None
        self._names: tuple[str, ...] = ()  # of the solvers that the plots are made for
        self._plots: list[Plot] = []
        self._setup: ComparisonSetup | None = None  # that the remark on the start is of
        self._tabled: tuple = ()  # what the table is of
        self._possible = binding.run.problem.search is not None
        if self._possible:
            self._add_controls()
        else:
            binding.gui.add_html(html.remark(NO_SEARCH))

    def _add_controls(self) -> None:
        gui, on, worker = self._binding.gui, self._binding.on, self.worker
        self._combinations = combinations()
        self.solvers = gui.add_dropdown("Solvers", tuple(self._combinations), initial_value=ALL)
        self.start = gui.add_dropdown("Start from", STARTS, initial_value="random", hint="The same for all solvers")
        self.seed = gui.add_number(
            "Random seed", self._binding.choices.seed, min=0, max=MAX_SEED, step=1,
            hint="Of the random start, and of the order in which descent moves the microphones",
        )  # fmt: skip
        self.run = on(
            gui.add_button("Start", icon=viser.Icon.FLAG, hint="Start; press again to pause and to resume"),
            lambda _: worker.toggle(self.setup),
        )
        self.restart = on(
            gui.add_button_group("", ("Reset", "Clear"), visible=False, hint="Restart or clear the race"),
            lambda value: (worker.reset if value == "Reset" else worker.stop)(),
        )
        self.far = gui.add_html("", visible=False)
        self.marks = gui.add_checkbox("Show marks", True, hint="Mark the estimates of each solver")
        self.table = gui.add_html("")
        self._folder = gui.add_folder(None)  # of the plots, which are made when the solvers are known

    @property
    def setup(self) -> ComparisonSetup:
        """What the controls show."""
        return ComparisonSetup(self._combinations[self.solvers.value], self.start.value, self.seed.value)

    def marked(self, summaries: tuple[RunSummary, ...]) -> tuple[RunSummary, ...]:
        """Return the runs whose estimates are marked in the scene."""
        return summaries if self._possible and self.marks.value else ()

    def show(self, tick: Tick) -> None:
        """Bring the tab up to date."""
        if not self._possible:
            return
        worker, summaries, setup = self.worker, tick.runs, self.setup
        self.run.label, self.run.disabled = worker.button_label, worker.finished
        self.restart.visible = bool(summaries)
        for handle in (self.solvers, self.start, self.seed):  # those of the next race
            handle.visible = not summaries
        if setup != self._setup:
            self._setup, self.far.content = setup, remark_on_start(setup)
        self.far.visible = bool(self.far.content) and not summaries
        if (Same(summaries), worker.error) != self._tabled:
            self._tabled = Same(summaries), worker.error
            rows = table(summaries, self._binding.measurement.nominal)
            self.table.content = html.complaint(worker.error) + rows
        if summaries is not self._shown and tick.now - self._updated >= INTERVAL:
            self._updated, self._shown = tick.now, summaries
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
        columns = curve_columns(summaries, self._binding.measurement)
        if not self._plots:
            with self._folder:
                self._plots = [self._plot(title, names) for title in columns]
        for plot, data in zip(self._plots, columns.values(), strict=True):
            plot.show(data, decades_of(*data[1:]) if "(mm)" in plot.title else None)

    def _plot(self, title: str, names: tuple[str, ...]) -> Plot:
        marks = {name: solver_mark(name) for name in names}
        drawn = [
            uplot.Series(label=name, stroke=mark.colour, width=2.5, dash=mark.dash, points={"show": False})
            for name, mark in marks.items()
        ]
        series = (uplot.Series(label="s"), *drawn)
        return Plot(self._binding.gui, title, series, "processor time (s)", height=PLOT_HEIGHT, legend=False)


def remark_on_start(setup: ComparisonSetup) -> str:
    """Return what a random start means for solvers that move all microphones at once, as HTML; "" where it does not."""
    far = [name for name in setup.names if solvers.load(name).TRAITS.moves_all]
    if setup.start != "random" or not far:
        return ""
    return html.remark(
        f"A random start is far from the array. {' and '.join(far)}, which look for a near one by themselves, may end"
        " metres off from there; to compare where all solvers end, start from affine."
    )


def curve_columns(summaries: tuple[RunSummary, ...], measurement: Measurement) -> dict[str, tuple[np.ndarray, ...]]:
    """Return the columns of the plots, by title: processor time (s), and a curve for each run.

    All curves share one axis, with each time at which one of them has a point; between its points a curve is constant.

    `summaries`: of runs with at least one point each; `measurement`: that they are of. Returns title to tuple of (P,)
    float64.
    """
    axis = np.unique(np.concatenate([summary.times for summary in summaries]))
    errors = [summary.mean_errors for summary in summaries if summary.mean_errors is not None]
    title = "Mean deviation from nominal (mm)" if measurement.nominal else "Mean position error (mm)"
    curves = {title: [np.maximum(error, MIN_ERROR) for error in errors]} if errors else {}
    curves[cost_title(measurement)] = [summary.costs for summary in summaries]
    rows = [np.maximum(np.searchsorted(run.times, axis, side="right") - 1, 0) for run in summaries]
    return {
        title: (axis, *(values[at] for values, at in zip(runs, rows, strict=True))) for title, runs in curves.items()
    }


def table(summaries: tuple[RunSummary, ...], nominal: bool = False) -> str:
    """Return time, steps, error and cost of each run as HTML, with its line in the plots and its mark in the scene.

    The error is a deviation where the positions to compare with are nominal.
    """
    rows = [_row(summary, "deviation" if nominal else "error") for summary in summaries]
    return f"<div style='{html.CARD} line-height: 1.25; font-size: var(--note)'>{''.join(rows)}</div>" if rows else ""


def _row(summary: RunSummary, error: str) -> str:
    mark = solver_mark(summary.name)
    style = f"stroke='{mark.colour}' stroke-width='3' stroke-dasharray='{','.join(map(str, mark.dash))}'"
    line = f"<svg width='30' height='10'><line x1='0' y1='5' x2='30' y2='5' {style}/></svg>"
    drawn = symbol(compared_entry(COMPARED, summary.name))
    figures = [f"{summary.seconds:.2f} s"]
    if summary.mean_error is not None:
        mean, largest = (length_text(1e-3 * length) for length in (summary.mean_error, summary.largest_error or 0.0))
        figures.append(f"{error} {mean}, largest {largest}")
    if summary.cost is not None:
        figures.append(f"{summary.cost:.1f} dB")
    return (
        f"<div style='margin-top: 0.3em; white-space: nowrap'>{line} {drawn} <b>{escape(summary.name)}</b>:"
        f" {escape(summary.status)}, {summary.step} steps<br>"
        f"<span style='opacity: 0.85'>{'; '.join(figures)}</span></div>"
    )
