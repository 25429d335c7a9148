"""Two given positions that were exchanged: the hypotheses "i and j exchanged" against "each is where it was given".

The pressures fix the shape of the array without the given positions. It is moved onto them, as they are and with two of
them exchanged; the Student t prior of the given positions says which is likelier. Mere outliers leave few positions to
hold the array, and with four of them wrong ones are named; an exchange leaves all.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from ...model.problem import Problem
from ...model.validation import frozen_array
from . import starts
from .objective import NU
from .settings import EXCHANGES
from .state import State


def resolved(problem: Problem, state: State) -> State:
    """Return `state` with two given positions exchanged, and the array moved onto them, where that is much likelier."""
    known, D = problem.known, state.positions.shape[1]
    places = state.model.places
    if len(known) < D + 2:  # fewer fit whatever is exchanged
        return state
    sigma = float(np.hypot(state.model.known_sigma, EXCHANGES.least_sigma))
    as_given, moved = _likeliest(state.positions, known, places, sigma)
    away = np.linalg.norm(moved[known] - places, axis=1)
    if away.max() < EXCHANGES.apart:
        return state
    count = EXCHANGES.examined
    suspects = np.argsort(-away)[:count] if len(known) > count else np.arange(len(known))
    pairs = list(combinations(np.sort(suspects), 2))
    found = [(*_likeliest(state.positions, known, _exchanged(places, *pair), sigma), pair) for pair in pairs]
    cost, moved, pair = min(found, key=lambda one: one[0])
    if cost + np.log(len(pairs)) > as_given - EXCHANGES.nats:
        return state
    model = replace(state.model, places=frozen_array(_exchanged(places, *pair), float))
    moved = frozen_array(moved, float)
    return replace(state, positions=moved, shape=moved, model=model)


def _exchanged(places: np.ndarray, i: int, j: int) -> np.ndarray:
    order = np.arange(len(places))
    order[[i, j]] = j, i
    return places[order]


def _likeliest(x, known, places, sigma: float) -> tuple[float, np.ndarray]:
    """Cost of the given positions where the array lies best, and the array there: on a subset, or on all that fit."""
    D = x.shape[1]
    best, there = np.inf, x
    for chosen in list(combinations(range(len(known)), D + 1))[: starts.MOST_SUBSETS]:
        moved = starts.onto(x, known[list(chosen)], places[list(chosen)])
        near = np.linalg.norm(moved[known] - places, axis=1) < EXCHANGES.apart
        for subset in (np.array(chosen), np.flatnonzero(near)):
            if len(subset) <= D:
                continue
            moved = starts.onto(x, known[subset], places[subset])
            square = np.sum((moved[known] - places) ** 2, axis=1)
            cost = (NU + D) / 2 * float(np.sum(np.log1p(square / (NU * sigma**2))))
            if cost < best:
                best, there = cost, moved
    return best, there
