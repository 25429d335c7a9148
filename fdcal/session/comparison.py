"""Two or three solvers from the same start, each on its own thread.

Time is processor time of the run's own thread, spent in steps, so that sharing a core makes no run slower.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from .. import solvers
from ..model.problem import Problem
from ..model.settings import SolverSettings
from ..solvers.interface import RunState
from .process import one_blas_thread
from .session import Session, recorded


class TimedSolver:
    """A solver whose steps are timed; `spent` is the time from the start to a state, s, by its number of steps."""

    def __init__(self, module):
        self._module, self.spent = module, {}

    def init(self, problem: Problem, settings: SolverSettings, seed: int):
        return self._module.init(problem, settings, seed)

    def step(self, problem: Problem, state):
        began = time.thread_time()
        after = self._module.step(problem, state)
        self.spent[after.step] = self.spent.get(state.step, 0.0) + time.thread_time() - began
        return after

    def use_modes(self, problem: Problem, state, first: int, last: int, automatic: bool):
        return self._module.use_modes(problem, state, first, last, automatic)


@dataclass(frozen=True)
class ComparisonRun:
    """One solver of a comparison."""

    name: str
    session: Session
    timed: TimedSolver

    def seconds(self, state) -> float:
        """Return the processor time from the start to `state`, s."""
        return self.timed.spent.get(state.step, 0.0) if state.step else 0.0


class Comparison:
    """Solvers side by side. Raises InputError if one of them cannot start."""

    def __init__(self, problem: Problem, settings: SolverSettings, names: tuple[str, ...], start: str, seed: int):
        settings = with_common_modes(problem, replace(settings, start=start), names)
        begun = same_start(problem, settings, names, seed)
        runs = []
        for name, state in begun.items():
            timed = TimedSolver(solvers.load(name))
            runs.append(ComparisonRun(name, Session(problem, state.settings, seed, timed, (state,)), timed))
        self.runs = tuple(runs)

    @property
    def running(self) -> bool:
        return any(run.session.view.running for run in self.runs)

    @property
    def over(self) -> bool:
        """Whether all have finished."""
        return all(run.session.view.state.finished for run in self.runs)

    def play(self) -> None:
        for run in self.runs:
            if not run.session.view.state.finished:
                run.session.play()

    def pause(self) -> None:
        for run in self.runs:
            run.session.pause()

    def reset(self) -> None:
        """Rewind all to the start, and pause."""
        for run in self.runs:
            run.session.seek(0)

    def close(self, timeout: float) -> bool:
        """End the threads after their present steps; return False if that takes longer than `timeout` seconds."""
        for run in self.runs:
            run.session.close(0.0)
        return all([run.session.close(timeout) for run in self.runs])


def with_common_modes(problem: Problem, settings: SolverSettings, names) -> SolverSettings:
    """Return settings with as many modes as every solver of `names` can use, where they ask for all."""
    each = [solvers.with_mode_count(problem, replace(settings, name=name)) for name in names]
    return replace(min(each, key=lambda one: one.modes), name=settings.name) if each else settings


def same_start(problem: Problem, settings: SolverSettings, names, seed: int) -> dict[str, RunState]:
    """Return a first state for each solver, all at the same positions.

    At a random start all are exactly at the positions that a solver on the lattice has drawn. At the affine start a
    solver without a lattice keeps its own start, which differs by half a step of the lattice at most.
    """
    states: dict[str, RunState] = {}
    for name in sorted(names, key=lambda name: not solvers.load(name).TRAITS.needs_search):  # the lattice decides
        own, solver = replace(settings, name=name), solvers.load(name)
        other = next(iter(states.values()), None)
        if solver.TRAITS.takes_positions and settings.start == "random" and other is not None:
            states[name] = solver.init(problem, own, seed, positions=other.positions)  # pyright: ignore[reportCallIssue]
        else:
            states[name] = solver.init(problem, own, seed)
    return {name: states[name] for name in names}


def timed_states(problem: Problem, settings: SolverSettings, names: tuple[str, ...], seed: int) -> dict:
    """Run solvers to their ends, one after another, from the same start.

    Returns for each name the states, as `fdcal.session.session.recorded` keeps them, and the processor time up to each,
    (T,), s.
    """
    settings = with_common_modes(problem, settings, names)
    begun, found = same_start(problem, settings, names, seed), {}
    for name in names:
        timed = TimedSolver(solvers.load(name))
        with one_blas_thread():
            states = recorded(_steps(problem, timed, begun[name]))
        found[name] = states, np.array([timed.spent.get(state.step, 0.0) if state.step else 0.0 for state in states])
    return found


def _steps(problem: Problem, solver, state: RunState) -> Iterator[RunState]:
    yield state
    while not state.finished:
        state = solver.step(problem, state)
        yield state
