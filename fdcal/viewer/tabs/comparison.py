"""The tab Race: solvers from the same start, compared in a table, in curves, and as marks in the scene.

`ComparisonWorker` prepares and runs a comparison on threads: callbacks queue a command (`toggle`, `reset`, `stop`), and
the main loop executes it (`update`).
"""

from __future__ import annotations

import collections
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from html import escape

import numpy as np
import viser
from viser import uplot

from ... import solvers
from ...graphics.annotations import COMPARED, compared_entry
from ...graphics.markers import solver_mark
from ...graphics.picture import cost_title
from ...model.measurement import Measurement
from ...model.validation import length_text
from ...session.comparison import Comparison, ComparisonRun
from ...session.session import SessionView
from ...solvers.interface import RunState
from ..background.prepare import PreparedRun, Same, Threads
from ..gui import html
from ..gui.binding import Binding, Due, RunSummary, Tab, Tick
from ..gui.html import error_message, symbol
from ..gui.plots import Plot, decades_of
from .solver import MAX_SEED, STARTS

MAX_POINTS = 60  # of the curves of one run


@dataclass(frozen=True)
class ComparisonSetup:
    """Which solvers are compared, and from where they start."""

    names: tuple[str, ...]  # of the solvers
    start: str  # of the positions, as in scene.Solver
    seed: int  # of the random start


def status_word(state: RunState, running: bool) -> str:
    """Return what a run of a comparison is doing, by its newest state and by whether it runs."""
    if running:
        return "running" if state.step else "preparing the first step"
    return ("converged" if state.converged else "not converged") if state.finished else "waiting"


def drawn_states(view: SessionView) -> list[RunState]:
    """Return the states that the curves of a run pass through: ever more of them on the same grid, and the last."""
    count = view.index + 1
    stride = 1
    while count / stride > MAX_POINTS:
        stride *= 2
    return [*view.history[0:count:stride], view.state]


LOOK_INTERVAL = 0.2  # s between two looks at the runs


@dataclass(frozen=True)
class PausedComparison:
    """A comparison that no page shows, and what belongs to it."""

    setup: ComparisonSetup | None
    comparison: Comparison
    # of the curves of each run, by step: mean error, mm, and cost, dB
    points: dict[str, dict[int, tuple[float, float]]]


class ComparisonWorker:
    """Owns the threads that prepare a comparison, run its solvers and compute its curves.

    `error` says why the comparison could not start, "" where it could. `summaries` is a new tuple whenever something
    has changed. `released` is the comparison that the worker has let go, or None.

    `run`: whose problem and settings the comparison takes; `threads`: of the session.
    """

    def __init__(self, run: PreparedRun, threads: Threads):
        self.run = run
        self._commands: collections.deque[Callable[[], object]] = collections.deque()
        self._preparation = threads.start(self._prepare, "fdcal-comparison")
        self._curves = threads.start(self._compute_curves, "fdcal-comparison-curves")
        self._points: dict[str, dict[int, tuple[float, float]]] = {}  # of each run, by step: its error and cost
        self._setup: ComparisonSetup | None = None
        self._pending: ComparisonSetup | None = None  # being prepared
        self._comparison: Comparison | None = None
        self._updated = -1e9
        self.error = ""
        self.released: PausedComparison | None = None
        self._let_go: Comparison | None = None  # which this worker does not close
        self.summaries: tuple[RunSummary, ...] = ()
        threads.own(self)

    def toggle(self, setup: ComparisonSetup) -> None:
        """Start the comparison, pause it, or resume it. Any thread."""
        self._commands.append(lambda: self._toggle(setup))

    def reset(self) -> None:
        """Take all runs back to their start. Any thread."""
        self._commands.append(self._reset)

    def stop(self) -> None:
        """End the comparison. Any thread."""
        self._commands.append(self._end)

    def release(self) -> None:
        """Pause the comparison and let it go, so that it stays when this worker ends. Any thread."""
        self._commands.append(self._release)

    def adopt(self, other: ComparisonWorker) -> None:
        """Show the comparison that another worker, or this one, has released, if there is one. Any thread."""
        self._commands.append(lambda: self._adopt(other))

    # Below: the main loop, except for _prepare and _compute_curves.

    @property
    def button_label(self) -> str:
        """What the button does next."""
        if self._pending is not None:
            return "Preparing ..."
        return "Start" if self._comparison is None else "Pause" if self._comparison.running else "Resume"

    @property
    def finished(self) -> bool:
        """Whether all runs have finished."""
        return self._comparison is not None and self._comparison.over and not self._comparison.running

    def update(self, now: float) -> tuple[RunSummary, ...]:
        """Execute the commands that wait, and return the runs as they are at the time `now`, s."""
        while self._commands:
            self.error = ""
            self._commands.popleft()()
        self._take_prepared()
        if self._comparison is not None and now - self._updated > LOOK_INTERVAL:
            self._updated = now
            self._summarise(self._comparison)
        return self.summaries

    def _toggle(self, setup: ComparisonSetup) -> None:
        if self._comparison is not None and setup != self._setup:
            self._end()
        if self._comparison is not None:
            (self._comparison.pause if self._comparison.running else self._comparison.play)()
        elif self._pending is None:
            self._pending = setup
            self._preparation.request(setup)

    def _reset(self) -> None:
        if self._comparison is not None:
            self._comparison.reset()

    def _take_prepared(self) -> None:
        """Start the comparison that is ready."""
        latest = self._preparation.latest
        if self._pending is None or latest is None or latest.request[0] is not self._pending:
            return
        self._pending, self._comparison, self._setup = None, latest.result, latest.request[0]
        self.error = error_message(latest.cause)
        if self._comparison is not None:
            self._points = {run.name: {} for run in self._comparison.runs}
            self._comparison.play()

    def _release(self) -> None:
        comparison = self._comparison
        if comparison is not None:
            comparison.pause()
            self.released = PausedComparison(self._setup, comparison, self._points)
            self._let_go = comparison
        self._comparison = None
        self._end()

    def _adopt(self, other: ComparisonWorker) -> None:
        released, other.released = other.released, None
        if released is not None:
            self._end()
            self._let_go = None
            self._setup, self._comparison, self._points = released.setup, released.comparison, released.points

    def _end(self) -> None:
        if self._comparison is not None:
            self._comparison.close(0.0)
        self._comparison, self._setup, self._pending, self.summaries = None, None, None, ()

    def _prepare(self, setup: ComparisonSetup) -> Comparison:
        """On the preparation's thread."""
        return Comparison(self.run.problem, self.run.scene.solver, setup.names, setup.start, setup.seed)

    def _summarise(self, comparison: Comparison) -> None:
        summaries = tuple(self._summary(run) for run in comparison.runs)
        changed = len(summaries) != len(self.summaries) or any(
            a.positions is not b.positions or len(a.times) != len(b.times) or a.status != b.status
            for a, b in zip(summaries, self.summaries, strict=True)
        )
        if changed:
            self.summaries = summaries
        if not self._curves.busy:
            drawn = [(run.name, drawn_states(run.session.view)) for run in comparison.runs]
            missing = [(name, [s for s in states if s.step not in self._points[name]]) for name, states in drawn]
            if any(states for _, states in missing):
                self._curves.request(self._points, missing)

    def _summary(self, run: ComparisonRun) -> RunSummary:
        view = run.session.view
        state = view.state
        errors = self._errors(state)
        points = self._points[run.name]
        steps = [step for step in sorted(points.copy()) if step <= state.step]
        return RunSummary(
            name=run.name,
            positions=state.positions,
            status="stopped by an error" if view.error else status_word(state, view.running),
            step=state.step,
            seconds=run.seconds(state),
            mean_error=None if errors is None else float(errors.mean()),
            largest_error=None if errors is None else float(errors.max()),
            times=np.array([run.timed.spent.get(step, 0.0) if step else 0.0 for step in steps]),
            mean_errors=None if errors is None else np.array([points[step][0] for step in steps]),
            costs=np.array([points[step][1] for step in steps]),
            cost=points[state.step][1] if state.step in points else None,
        )

    def _errors(self, state: RunState) -> np.ndarray | None:
        """Position error of each microphone that is sought, float64, mm."""
        errors = self.run.measurement.errors(state.positions)
        return None if errors is None else 1e3 * errors[self.run.sought]

    def _compute_curves(self, points: dict, missing: list) -> None:
        """Compute error and cost of the states that have none yet; on the curves' thread."""
        reference_cost = self.run.reference_cost
        for name, states in missing:
            for state in states:
                errors = self._errors(state)
                error = 0.0 if errors is None else float(errors.mean())
                points[name][state.step] = error, reference_cost.of(state) if reference_cost else 0.0

    def close(self, timeout: float) -> bool:
        """End the comparison, and one that was prepared meanwhile; its two threads end with those of the session."""
        self._end()
        latest = self._preparation.latest
        if latest is None or latest.result is None or latest.result is self._let_go:
            return True
        return latest.result.close(timeout)


ALL = "all"
INTERVAL = 0.5  # s between two updates of the curves
PLOT_HEIGHT = 150  # pixels; with them the whole tab has room in a window 720 pixels high
MIN_ERROR = 1e-3  # mm, drawn for anything below: logarithms have no zero
NO_SEARCH = f"No race: {html.NO_DOMAIN}"


def combinations() -> dict[str, tuple[str, ...]]:
    """Return which solvers can be compared, by label: all that need no known room, and each two of them."""
    names = tuple(name for name in solvers.names() if not solvers.load(name).TRAITS.needs_room)
    return {ALL: names} | {", ".join(pair): pair for pair in itertools.combinations(names, 2)}


class ComparisonTab(Tab):
    """Owns the controls of the tab, and the race.

    `worker`: prepares the race and runs it.
    """

    def __init__(self, binding: Binding):
        self._binding, self.worker = binding, ComparisonWorker(binding.run, binding.threads)
        self._start_due, self._table_due, self._curves_due = Due(), Due(), Due(INTERVAL)
        self._names: tuple[str, ...] = ()  # of the solvers that the plots are made for
        self._plots: list[Plot] = []
        self._possible = binding.run.problem.search is not None
        if self._possible:
            self._add_controls()
        else:
            binding.gui.add_html(html.remark(NO_SEARCH))

    def _add_controls(self) -> None:
        binding, gui, worker = self._binding, self._binding.gui, self.worker
        self._combinations = combinations()
        self.solvers = gui.add_dropdown("Solvers", tuple(self._combinations), initial_value=ALL)
        self.start = gui.add_dropdown("Start from", STARTS, initial_value="random", hint="The same for all solvers")
        self.seed = gui.add_number(
            "Random seed", binding.choices.seed, min=0, max=MAX_SEED, step=1,
            hint="Of the random start, and of the order in which descent moves the microphones",
        )  # fmt: skip
        self.run = binding.button(
            "Start", lambda _: worker.toggle(self.setup), icon=viser.Icon.FLAG,
            hint="Start; press again to pause and to resume",
        )  # fmt: skip
        self.restart = binding.button_group(
            "", ("Reset", "Clear"), lambda value: (worker.reset if value == "Reset" else worker.stop)(), visible=False,
            hint="Restart or clear the race",
        )  # fmt: skip
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
        if self._start_due(tick.now, setup):
            self.far.content = remark_on_start(setup)
        self.far.visible = bool(self.far.content) and not summaries
        if self._table_due(tick.now, Same(summaries), worker.error):
            rows = table(summaries, self._binding.measurement.nominal)
            self.table.content = html.complaint(worker.error) + rows
        if self._curves_due(tick.now, Same(summaries)):
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
        f"A random start is far from the array. From there {' and '.join(far)}, which look for a near start by"
        " themselves, may end metres off; to compare where all solvers end, start from affine."
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
