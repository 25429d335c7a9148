"""A comparison of solvers while it runs: prepared in the background, its curves computed there, too.

Callbacks queue a command (`toggle`, `reset`, `stop`); the main loop executes it (`update`).
"""

from __future__ import annotations

import collections
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...session.comparison import Comparison, ComparisonRun
from ...session.session import SessionView
from ...solvers.interface import RunState
from ..gui.html import error_message
from .prepare import PreparedRun
from .threads import Threads

MAX_POINTS = 60  # of the curves of one run


@dataclass(frozen=True)
class ComparisonSetup:
    """Which solvers are compared, and from where they start."""

    names: tuple[str, ...]  # of the solvers
    start: str  # of the positions, as in scene.Solver
    seed: int  # of the random start


@dataclass(frozen=True)
class RunSummary:
    """One run of a comparison, as it is shown."""

    name: str  # of the solver
    positions: np.ndarray  # (N, D) float64, metres
    status: str  # "running", "converged", ...
    step: int
    seconds: float  # processor time since the start, s
    # mean_error, largest_error: of the positions sought, mm; None where the true positions are unknown
    mean_error: float | None
    largest_error: float | None
    times: np.ndarray  # (P,) float64, s, of the points of the curves
    mean_errors: np.ndarray | None  # (P,) float64, mm, or None
    costs: np.ndarray  # (P,) float64, dB, of `fdcal.cost.reference_cost`
    cost: float | None = None  # dB, of the positions themselves; None until it is computed


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


INTERVAL = 0.2  # s between two looks at the runs


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
        if self._comparison is not None and now - self._updated > INTERVAL:
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
