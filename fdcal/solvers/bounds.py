"""Bounds of every calibration, whatever the solver: on memory, on the extent of the array, on processor time.

The order of a field's expansion, and with it memory and time of a step, grows with the wavenumber times the extent of
the array. `N` microphones resolve orders up to about N / 2 (Eq. 8), so that positions beyond `farthest` are not an
answer but a solver that has lost its way.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from ..model.limits import LIMITS
from ..model.problem import Problem
from ..model.settings import SolverSettings
from ..model.validation import InputError
from .interface import RunState, Solver, Traits

State = TypeVar("State", bound=RunState)


def farthest(problem: Problem, modes: int) -> float:
    """Return the radius of the largest array that the lowest `modes` modes can resolve at all, metres."""
    phase = max(LIMITS.phase, LIMITS.phase_per_microphone * problem.pressures.shape[1])
    return phase / float(np.abs(problem.wavenumbers[:modes]).max())


def time_limit(problem: Problem, modes: int) -> float:
    """Return the seconds of processor time that a calibration may take unless another limit is given."""
    pairs = problem.pressures.shape[1] ** 2 * min(modes, len(problem.pressures))
    return LIMITS.seconds * max(1.0, pairs / LIMITS.usual_pairs)


def require_affordable(problem: Problem, settings: SolverSettings, traits: Traits) -> None:
    """Check a problem before the solver begins.

    Raises
    ------
    InputError
        It needs more memory than a calibration may take, or its known microphones are too far apart.
    """
    count, modes = problem.pressures.shape[1], min(settings.modes, len(problem.pressures))
    if traits.uses_likelihood and count**2 * modes > LIMITS.pairs:
        raise InputError(
            f"{count} microphones at {modes} frequencies need more memory than a calibration may take",
            f"use at most {int(LIMITS.pairs / count**2)} modes (<modes>), or fewer microphones (<exclude>)",
            key="modes",
            value=modes,
        )
    extent, limit = radius(problem.known_positions), farthest(problem, modes)
    if traits.uses_likelihood and extent > limit:
        raise InputError(
            f"the known microphones lie up to {2 * extent:.3g} m apart, farther than {count} microphones resolve at"
            f" {problem.frequencies[modes - 1]:.4g} Hz ({2 * limit:.3g} m)",
            "give positions in metres, or use fewer <modes>",
            key="known_positions",
        )


def radius(positions: np.ndarray) -> float:
    """Return half the largest extent of positions (N, D) along an axis, metres; 0 without any."""
    return float(np.ptp(positions, axis=0).max(initial=0.0)) / 2 if len(positions) else 0.0


def bounded_step(solver: Solver, problem: Problem, state: State) -> State:
    """Return the state after one step; `state` itself, ended without convergence, where a microphone runs away.

    Parameters
    ----------
    solver : Solver
    problem : Problem
    state : RunState
    """
    after = solver.step(problem, state)
    if not isinstance(problem, Problem):  # a session takes whatever its solver takes, which then bounds itself
        return after
    if np.isfinite(after.positions).all() and radius(after.positions) <= _bound(problem, state):
        return after
    return ended_early(state)


def _bound(problem: Problem, state: RunState) -> float:
    """Return the largest radius of a state's array : metres; what lay further out at the start may stay there."""
    search = max(problem.search.size) if problem.search is not None else 0.0
    known = radius(problem.known_positions)
    return max(farthest(problem, state.settings.modes), search, 2 * known, radius(state.positions))


def ended_early(state: State) -> State:
    """Return a state as the end of a run that was stopped, at the best positions so far."""
    if state.finished:
        return state
    return replace(state, positions=state.best_positions, finished=True, converged=False)
