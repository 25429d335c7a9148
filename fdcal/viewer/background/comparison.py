"""A race on its way: made in the background, its curves reckoned there too; the main loop looks at it.

Callbacks ask (`toggle`, `reset`, `drop`), the main loop does (`turn`).
"""

from __future__ import annotations

import collections
from dataclasses import dataclass

import numpy as np

from ...session.comparison import Comparison, ComparisonRun, common_cost
from ...session.worker import LatestWorker
from .prepare import Work

INTERVAL = 0.2  # s between two looks at the runs
MOST_POINTS = 60  # of a run's curves at a time


@dataclass(frozen=True)
class Entry:
    """Who races, and from where."""

    names: tuple[str, ...]
    start: str
    seed: int


@dataclass(frozen=True)
class Runner:
    """One run as it is shown; times s, errors mm, costs dB re the power of the pressures."""

    name: str
    positions: np.ndarray
    doing: str
    step: int
    seconds: float
    error: float | None  # mean, now
    largest: float | None
    times: np.ndarray  # (P,)
    errors: np.ndarray | None  # (P,) mean
    costs: np.ndarray  # (P,)


class Races:
    """Owns the race's threads and those that make it and reckon its curves."""

    def __init__(self, work: Work):
        self._work, self._asked = work, collections.deque()
        self._maker = LatestWorker(self._make, "fdcal-race")
        self._curves = LatestWorker(self._reckon, "fdcal-race-curves")
        self._rows: dict[str, dict[int, tuple]] = {}  # of each run, by step: the state, its error and cost
        self._entry: Entry | None = None
        self._waited: Entry | None = None  # being made
        self._race: Comparison | None = None
        self._looked = -1e9
        self.trouble = ""
        self.runners: tuple[Runner, ...] = ()

    def toggle(self, entry: Entry) -> None:
        """Begin the race, pause it, or go on. Any thread."""
        self._asked.append(("toggle", entry))

    def reset(self) -> None:
        """All back to the start. Any thread."""
        self._asked.append(("reset", None))

    def drop(self) -> None:
        """End the race. Any thread."""
        self._asked.append(("drop", None))

    # Below: the main loop, but for _make and _reckon.

    @property
    def word(self) -> str:
        """What the button would do."""
        if self._waited is not None:
            return "Preparing ..."
        return "Race" if self._race is None else "Pause" if self._race.running else "Go on"

    @property
    def over(self) -> bool:
        return self._race is not None and self._race.over and not self._race.running

    def turn(self, now: float) -> tuple[Runner, ...]:
        """Do what was asked; the runners as they are, a new tuple when something has changed."""
        while self._asked:
            self._obey(*self._asked.popleft())
        self._take()
        if self._race is not None and now - self._looked > INTERVAL:
            self._looked = now
            self._look()
        return self.runners

    def _obey(self, word: str, entry: Entry | None) -> None:
        race, self.trouble = self._race, ""
        if word == "drop" or (word == "toggle" and race is not None and entry != self._entry):
            self._end()
        if word == "toggle" and self._race is None and self._waited is None:
            self._waited = entry
            self._maker.request(entry)
        elif word == "toggle" and self._race is not None:
            (race.pause if race.running else race.play)()
        elif word == "reset" and race is not None:
            race.reset()

    def _take(self) -> None:
        """The race that is ready begins."""
        latest = self._maker.latest
        if self._waited is None or latest is None or latest.request[0] is not self._waited:
            return
        self._waited, self._race, self._entry, self.trouble = None, latest.result, latest.request[0], latest.error
        if self._race is not None:
            self._rows = {run.name: {} for run in self._race.runs}
            self._race.play()

    def _end(self) -> None:
        if self._race is not None:
            self._race.close(0.0)
        self._race, self._entry, self._waited, self.runners = None, None, None, ()

    def _make(self, entry: Entry) -> Comparison:
        """On the maker's thread."""
        return Comparison(self._work.problem, self._work.scene.solver, entry.names, entry.start, entry.seed)

    def _look(self) -> None:
        runners = tuple(self._runner(run) for run in self._race.runs)
        changed = len(runners) != len(self.runners) or any(
            a.positions is not b.positions or len(a.times) != len(b.times) or a.doing != b.doing
            for a, b in zip(runners, self.runners, strict=True)
        )
        if changed:
            self.runners = runners
        if not self._curves.busy:
            wanted = [(run.name, _some(run.session.view)) for run in self._race.runs]
            missing = [(name, [s for s in states if s.step not in self._rows[name]]) for name, states in wanted]
            if any(states for _, states in missing):
                self._curves.request(self._rows, missing)

    def _runner(self, run: ComparisonRun) -> Runner:
        view = run.session.view
        state = view.state
        errors = self._errors(state)
        rows = self._rows[run.name]
        steps = [step for step in sorted(rows.copy()) if step <= state.step]
        return Runner(
            name=run.name,
            positions=state.positions,
            doing="stopped by an error" if view.error else "running" if view.running else _word(state),
            step=state.step,
            seconds=run.seconds(state),
            error=None if errors is None else float(errors.mean()),
            largest=None if errors is None else float(errors.max()),
            times=np.array([run.timed.spent.get(step, 0.0) if step else 0.0 for step in steps]),
            errors=None if errors is None else np.array([rows[step][0] for step in steps]),
            costs=np.array([rows[step][1] for step in steps]),
        )

    def _errors(self, state) -> np.ndarray | None:
        """Of each microphone, mm."""
        errors = self._work.measurement.errors(state.positions)
        return None if errors is None else 1e3 * errors

    def _reckon(self, rows: dict, missing: list) -> None:
        """On the curves' thread: error and cost of the states that have none yet."""
        work = self._work
        for name, states in missing:
            for state in states:
                errors = self._errors(state)
                error = 0.0 if errors is None else float(errors.mean())
                cost = common_cost(work.problem, work.scene.solver, state.positions)
                rows[name][state.step] = error, 10 * np.log10(max(cost, 1e-16))

    def close(self, timeout: float) -> bool:
        """End the threads after what they are at."""
        self._end()
        done = self._maker.close(timeout)
        latest = self._maker.latest
        if latest is not None and latest.result is not None:
            done = latest.result.close(timeout) and done
        return self._curves.close(timeout) and done


def _word(state) -> str:
    return ("settled" if state.converged else "sweeps used up") if state.finished else "waiting"


def _some(view) -> list:
    """States of a run that its curves go through: ever more of them on the same grid, and the last."""
    count = view.index + 1
    stride = 1
    while count / stride > MOST_POINTS:
        stride *= 2
    return [*view.history[0:count:stride], view.state]
