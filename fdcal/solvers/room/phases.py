"""One step of each phase of the solver of known rooms.

Every function takes the problem, the state with its step counted, and what `fdcal.solvers.room.state.scaled` gives:
pressures (M, N) of unit RMS, noise (M,) and wavenumbers (M,), rad/m, of the modes in use.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...acoustics.room_modes import diffuse_model
from ...model.problem import Problem
from ...model.validation import frozen_array
from ..levenberg_marquardt import DAMPING
from . import array_search, source_search
from .fit import bounded_step, diffuse_terms, exact
from .multistart import begin, begin_at_source, begin_exact, end, reject
from .state import Phase, State, freedom
from .thresholds import NOISE, PHASES, STAGES


def _inside(positions, size) -> np.ndarray:
    return np.clip(positions, STAGES.margin, np.asarray(size) - STAGES.margin)


def _search(problem: Problem, state: State, p, noise, k) -> State:
    found = array_search.likeliest(p, noise, k, state.size)
    return begin(replace(state, attempts=replace(state.attempts, arrays=tuple(found)), stage=state.stage + 1))


def _diffuse(problem: Problem, state: State, p, noise, k) -> State:
    size, phase, limits = state.size, state.phase, PHASES["diffuse"]
    between = array_search.step_of(k, size)
    model = diffuse_model(size, k, state.width)
    noise = array_search.spread(noise, k, len(size), STAGES.spreads[phase.spread] * between)
    x = state.positions.ravel()
    trial = bounded_step(
        x,
        diffuse_terms(x, p, noise, model),
        lambda y: diffuse_terms(y, p, noise, model).cost,
        lambda y: _inside(y.reshape(-1, len(size)), size).ravel(),
        len(x),
        phase.damping,
        between,
    )
    positions = frozen_array(trial.unknowns.reshape(-1, len(size)), float)
    after = replace(state, positions=positions, cost=trial.cost, phase=replace(phase, damping=trial.damping))
    if trial.moved >= limits.settled and phase.steps < limits.steps:
        return after
    following = replace(after.phase, steps=0, damping=DAMPING.first)
    if phase.spread + 1 == len(STAGES.spreads):
        following = replace(following, name="source")
    else:
        following = replace(following, spread=phase.spread + 1)
    return replace(after, stage=state.stage + 1, phase=following)


def _source(problem: Problem, state: State, p, noise, k) -> State:
    found = source_search.sources(state.positions, p, k, state.size, STAGES.sources)
    attempts = replace(state.attempts, sources=tuple(found))
    return begin_at_source(replace(state, attempts=attempts, stage=state.stage + 1))


def _exact(problem: Problem, state: State, p, noise, k) -> State:
    size, phase, limits = state.size, state.phase, PHASES[state.phase.name]
    N, D = state.positions.shape
    v = noise + NOISE.rough * (phase.name != "exact")

    def bounded(theta: np.ndarray) -> np.ndarray:
        theta = np.array(theta)
        theta[: N * D + D] = _inside(theta[: N * D + D].reshape(-1, D), size).ravel()
        theta[N * D + D] = np.clip(theta[N * D + D], 0.0, STAGES.admittance)
        return theta

    trial = bounded_step(
        state.theta,
        exact(state.theta, p, v, k, size).terms(state.theta, N, D),
        lambda y: exact(y, p, v, k, size, False).cost(y, N, D),
        bounded,
        N * D,
        phase.damping,
        array_search.step_of(k, size),
    )
    positions = frozen_array(trial.unknowns[: N * D].reshape(N, D), float)
    walls = frozen_array(trial.unknowns[N * D :], float)
    phase = replace(phase, damping=trial.damping)
    after = replace(state, positions=positions, walls=walls, cost=trial.cost, phase=phase)
    settled = trial.moved < limits.settled
    if not settled and phase.steps < limits.steps:
        return after
    after = replace(after, stage=state.stage + 1, phase=replace(phase, steps=0))
    if phase.name == "exact":
        return end(problem, after, settled)
    if trial.cost <= NOISE.rejected * freedom(len(p), N, D):
        return begin_exact(after)
    if phase.name == "rough":
        relocated = source_search.relocated(positions, walls, p, k, size)
        following = Phase("relocated", phase.spread, 0, STAGES.new_damping)
        return replace(after, positions=frozen_array(relocated, float), phase=following)
    return reject(after)


STEPS: dict[str, Callable[..., State]] = {
    "search": _search,
    "diffuse": _diffuse,
    "source": _source,
    "rough": _exact,
    "relocated": _exact,
    "exact": _exact,
}
