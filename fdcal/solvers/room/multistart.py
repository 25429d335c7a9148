"""Attempts of the solver of known rooms: what begins one, and what follows its end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...acoustics.room_symmetry import nearest_symmetry, room_symmetries
from ...model.problem import Problem
from ...model.validation import frozen_array
from ..levenberg_marquardt import DAMPING
from .state import AttemptEnd, MeasurementNoise, Phase, State, freedom
from .thresholds import NOISE, STAGES


def begin(state: State) -> State:
    """Return the start of phase "diffuse" from the next array."""
    first, *others = state.attempts.arrays
    return replace(
        state,
        positions=first.positions,
        width=first.width,
        attempts=replace(state.attempts, arrays=tuple(others)),
        phase=Phase("diffuse", 0, 0, DAMPING.first),
    )


def begin_at_source(state: State) -> State:
    """Return the start of phase "rough" from the next place of the source."""
    first, *others = state.attempts.sources
    return replace(
        state,
        walls=frozen_array([*first.place, first.admittance, 0.0], float),
        attempts=replace(state.attempts, sources=tuple(others)),
        phase=replace(state.phase, name="rough", steps=0, damping=STAGES.new_damping),
    )


def begin_exact(state: State) -> State:
    """Return the start of phase "exact"."""
    return replace(state, phase=replace(state.phase, name="exact", steps=0, damping=DAMPING.first))


def reject(state: State) -> State:
    """Return the next attempt in place of one that leaves too much unexplained.

    If none is left, or two have ended at the same cost, the best of them continues with phase "exact".
    """
    best = state.attempts.rejected
    agreed = best is not None and abs(state.cost - best.cost) < NOISE.agreed * best.cost
    if best is None or state.cost < best.cost:
        best = AttemptEnd(state.positions, state.walls, state.cost, False)
    following = next_attempt(replace(state, attempts=replace(state.attempts, sources=())) if agreed else state)
    if following is not None:
        return replace(following, attempts=replace(following.attempts, rejected=best))
    attempts = replace(state.attempts, arrays=(), sources=(), rejected=best)
    return begin_exact(replace(state, positions=best.positions, walls=best.walls, attempts=attempts))


def next_attempt(state: State) -> State | None:
    """Return the next attempt, from another place of the source or another array; None if none is left."""
    if state.attempts.sources:
        return begin_at_source(state)
    return begin(state) if state.attempts.arrays else None


def end(problem: Problem, state: State, settled: bool) -> State:
    """Return the finished state, or the next attempt if too much is left unexplained."""
    best = state.attempts.best
    agreed = best is not None and abs(state.cost - best.cost) < NOISE.agreed * best.cost
    if best is None or state.cost < best.cost:
        best = AttemptEnd(state.positions, state.walls, state.cost, settled)
    N, D = state.positions.shape
    left = best.cost / freedom(state.last - state.first + 1, N, D)
    state = replace(state, attempts=replace(state.attempts, best=best))
    unexplained = state.noise.given or left * NOISE.guess > NOISE.rough
    if left > NOISE.confirmed and state.automatic and not agreed and unexplained:
        following = next_attempt(state)
        if following is not None:
            return following
    noise = state.noise.power if state.noise.given else state.noise.power * left
    positions, walls = _placed(problem, state, best)
    return replace(
        state,
        positions=positions,
        walls=walls,
        cost=best.cost,
        noise=MeasurementNoise(frozen_array(noise, float), state.noise.given),
        finished=True,
        converged=best.settled,
    )


def _placed(problem: Problem, state: State, best: AttemptEnd) -> tuple[np.ndarray, np.ndarray]:
    """Positions and walls in the symmetry nearest to the known microphones, or in the corner at the origin."""
    size, positions, walls = state.size, best.positions, best.walls
    if len(problem.known):
        image = nearest_symmetry(positions[problem.known], problem.known_positions, size)
    else:
        image = min(room_symmetries(size), key=lambda image: tuple(np.round(image.apply(positions).mean(axis=0), 9)))
    D = len(size)
    return (
        frozen_array(image.apply(positions), float),
        frozen_array(np.concatenate([image.apply(walls[:D]), walls[D:]]), float),
    )
