"""Bounds of every calibration, whatever the solver: processor time, memory and the extent of the array.

The order of a field's expansion, and with it memory and time of a step, grows with the wavenumber times the extent of
the array. `N` microphones resolve orders up to about N / 2 (Eq. 8), so positions beyond `max_radius` are no answer: the
solver has diverged.

One step may take many trials. Loops inside a step call `check_deadline`, so a calibration ends soon after its time
limit and not after the step. A deadline holds in the thread that has set it: calibrations in other threads, and the
page's session, have their own or none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from typing import TypeVar

import numpy as np

from ..model.limits import LIMITS
from ..model.problem import Problem
from ..model.settings import SolverSettings
from ..model.validation import InputError
from .interface import RunState, Solver, Traits

State = TypeVar("State", bound=RunState)

_time_is_up: ContextVar[Callable[[], bool] | None] = ContextVar("time_is_up", default=None)


class OutOfTime(Exception):
    """The time of a calibration is used up; the last state before holds its best positions."""


@contextmanager
def deadline(end: float, clock: Callable[[], float]) -> Iterator[None]:
    """Let `check_deadline` raise OutOfTime inside this context once `clock()`, seconds, is past `end`."""
    token = _time_is_up.set(lambda: clock() > end)
    try:
        yield
    finally:
        _time_is_up.reset(token)


def check_deadline() -> None:
    """Raise OutOfTime if the deadline of this thread has passed; without a deadline do nothing."""
    time_is_up = _time_is_up.get()
    if time_is_up is not None and time_is_up():
        raise OutOfTime


def time_limit(problem: Problem, modes: int) -> float:
    """Return the seconds of processor time that a calibration may take unless another limit is given."""
    pairs = problem.pressures.shape[1] ** 2 * min(modes, len(problem.pressures))
    return LIMITS.seconds * max(1.0, pairs / LIMITS.usual_pairs)


def require_affordable(problem: Problem, settings: SolverSettings, traits: Traits) -> None:
    """Raise InputError for a problem that needs too much memory, or whose known microphones are too far apart."""
    if not traits.uses_likelihood:
        return
    count, modes = problem.pressures.shape[1], min(settings.modes, len(problem.pressures))
    if count**2 * modes > LIMITS.pairs:
        raise InputError(
            f"{count} microphones at {modes} frequencies need more memory than a calibration may take",
            f"use at most {int(LIMITS.pairs / count**2)} modes (<modes>), or fewer microphones (<exclude>)",
            key="modes",
            value=modes,
        )
    extent, limit = radius(problem.known_positions), max_radius(problem, modes)
    if extent > limit:
        raise InputError(
            f"the known microphones lie up to {2 * extent:.3g} m apart, farther than {count} microphones resolve at"
            f" {problem.frequencies[modes - 1]:.4g} Hz ({2 * limit:.3g} m)",
            "give positions in metres, or use fewer <modes>",
            key="known_positions",
        )


def radius(positions: np.ndarray) -> float:
    """Return half the largest extent of positions (N, D) along an axis, metres; 0 without any."""
    return float(np.ptp(positions, axis=0).max(initial=0.0)) / 2 if len(positions) else 0.0


def max_radius(problem: Problem, modes: int) -> float:
    """Return the radius of the largest array that the lowest `modes` modes can resolve at all, metres."""
    phase = max(LIMITS.phase, LIMITS.phase_per_microphone * problem.pressures.shape[1])
    return phase / float(np.abs(problem.wavenumbers[:modes]).max())


def bounded_step(solver: Solver, problem: Problem, state: State) -> State:
    """Return the state after one step; `state` itself, ended without convergence, where a microphone diverges."""
    after = solver.step(problem, state)
    if not isinstance(problem, Problem):  # a session takes whatever its solver takes, which then bounds itself
        return after
    search = max(problem.search.size) if problem.search is not None else 0.0
    known, before = radius(problem.known_positions), radius(state.positions)  # what starts further out may stay there
    limit = max(max_radius(problem, state.settings.modes), search, 2 * known, before)
    if np.isfinite(after.positions).all() and radius(after.positions) <= limit:
        return after
    return ended_early(state)


def ended_early(state: State) -> State:
    """Return a state as the end of a run that was stopped, at the best positions so far."""
    if state.finished:
        return state
    return replace(state, positions=state.best_positions, finished=True, converged=False)
