"""Attempts of the solver of known rooms: what begins one, and what follows its end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...acoustics.room_modes import nearest_symmetry, room_symmetries
from ...model.problem import Problem
from ...model.validation import frozen_array
from .fit import FIRST_DAMPING
from .state import GUESS, ROUGH, State, freedom

AGREED = 0.02  # of the cost: two attempts that end so alike have both found what there is
CONVINCING = 1.5  # times the noise told: less of it, and the end needs no other attempt
EXACT = {"phase": "exact", "stage_steps": 0, "damping": FIRST_DAMPING}
NEW_DAMPING = 1e-2  # of the first step of the exact model


def begin(state: State) -> State:
    """The stages that follow the search, from the next array."""
    (width, positions), *others = state.arrays
    begun = replace(state, positions=frozen_array(positions, float), width=width, arrays=tuple(others), phase="near")
    return replace(begun, round=0, stage_steps=0, damping=FIRST_DAMPING)


def from_source(state: State) -> State:
    """The exact stages from the next place of the source."""
    (place, admittance), *others = state.sources
    walls = frozen_array([*place, admittance, 0.0], float)
    return replace(state, walls=walls, sources=tuple(others), phase="rough", stage_steps=0, damping=NEW_DAMPING)


def hopeless(state: State) -> State:
    """Another attempt in place of one that explains too little; none left, or two of them alike: the best one on."""
    best = state.hopeless
    alike = best is not None and abs(state.cost - best[2]) < AGREED * best[2]
    if best is None or state.cost < best[2]:
        best = (state.positions, state.walls, state.cost)
    following = another(replace(state, sources=()) if alike else state)
    if following is not None:
        return replace(following, hopeless=best)
    return replace(state, positions=best[0], walls=best[1], hopeless=best, sources=(), arrays=(), **EXACT)


def another(state: State) -> State | None:
    """The next attempt, if any is left: from another place of the source, or another array."""
    if state.sources:
        return from_source(state)
    return begin(state) if state.arrays else None


def end(problem: Problem, state: State, settled: bool) -> State:
    """The end, or another attempt where too much is left unexplained."""
    best = state.best
    agreed = best is not None and abs(state.cost - best[2]) < AGREED * best[2]
    if best is None or state.cost < best[2]:
        best = (state.positions, state.walls, state.cost, settled)
    N, D = state.positions.shape
    left = best[2] / freedom(state.last - state.first + 1, N, D)
    state = replace(state, best=best)
    if left > CONVINCING and state.automatic and not agreed and (state.noise_told or left * GUESS > ROUGH):
        following = another(state)
        if following is not None:
            return following
    noise = state.noise_power if state.noise_told else state.noise_power * left
    positions, walls = _placed(problem, state.settings.room, best[0], best[1])
    ended = replace(state, positions=positions, walls=walls, cost=best[2], noise_power=frozen_array(noise, float))
    return replace(ended, finished=True, converged=best[3])


def _placed(problem: Problem, size, positions, walls) -> tuple[np.ndarray, np.ndarray]:
    """Positions and source in the symmetry nearest to the known microphones, or in the corner at the origin."""
    if len(problem.known):
        image = nearest_symmetry(positions[problem.known], problem.known_positions, size)
    else:
        image = min(room_symmetries(size), key=lambda image: tuple(np.round(image.of(positions).mean(axis=0), 9)))
    D = len(size)
    return (
        frozen_array(image.of(positions), float),
        frozen_array(np.concatenate([image.of(walls[:D]), walls[D:]]), float),
    )
