"""Where attempts start: from the coherence of all modes, then affine images of the low ones.

The map of an affine image is fixed by the given positions or, blind, by the metric of greatest likelihood.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from ...model.gauge import align
from ...model.problem import Problem
from .. import initial_positions
from .coherence import coherence_start

MOST_SUBSETS = 40


def plan(problem: Problem, modes: int, noiseless: bool = False) -> list[tuple[str, int]]:
    """Starts in the order in which they are tried: kind and number of modes, the lowest for an affine image.

    The second is of another kind than the first: ends that agree then say more. Without noise the low modes are as
    good as the others, and their affine image comes first.
    """
    counts = list(dict.fromkeys(min(n, modes) for n in initial_positions.RULES.lowest(problem.dimension)))
    kinds = ("map", "metric") if len(problem.known) else ("metric",)
    affine = [(kind, n) for n in counts for kind in kinds]
    others = [*affine[2:], ("redirected", counts[0])]
    first = [affine[0], ("coherence", modes)] if noiseless else [("coherence", modes), affine[0]]
    return [*first, *affine[1:2], ("coherence", modes // 2), *others]


def start(problem: Problem, modes: int, noise: float | None, kind: str, lowest: int) -> np.ndarray:
    """Positions (N, D), metres, of one start. Raises InputError where the modes show too few directions.

    problem : with modes of unit power;  noise : share of it that is reported;  kind, lowest : of `plan`
    """
    if kind == "coherence":
        used = slice(0, modes, modes // lowest)
        p, k = problem.pressures[used], problem.wavenumbers[used]
        x = coherence_start(p, k, noise, problem.dimension, problem.array_dimension)
    elif kind == "redirected":
        x = initial_positions.redirected(_blind(problem), modes)
    elif kind == "metric":
        x = initial_positions.affine(_blind(problem), modes, lowest)
    else:
        return _mapped(problem, modes, lowest)
    return x if not len(problem.known) else aligned(problem, x)


def _blind(problem: Problem) -> Problem:
    D = problem.array_dimension
    return replace(problem, known=np.zeros(0, np.int64), known_positions=np.zeros((0, D)), frame=None)


def _mapped(problem: Problem, modes: int, lowest: int) -> np.ndarray:
    """The affine image under the map of the given positions that most of them agree on (least median of squares)."""
    shape, _, _ = initial_positions.singular_vectors(problem, modes, lowest)
    extended = np.column_stack([shape, np.ones(len(shape))])
    rows, places = extended[problem.known], problem.known_positions
    best = extended @ np.linalg.lstsq(rows, places, rcond=None)[0]
    D = shape.shape[1]
    if len(places) <= D + 2:
        return best
    score = np.inf
    for chosen in list(combinations(range(len(places)), D + 2))[:MOST_SUBSETS]:
        found = np.linalg.lstsq(rows[list(chosen)], places[list(chosen)], rcond=None)[0]
        error = np.median(np.linalg.norm(rows @ found - places, axis=1))
        if error < 0.5 * score:
            score, best = error, extended @ found
    return best


def aligned(problem: Problem, x) -> np.ndarray:
    """A blind array onto the given positions; onto the subset of D + 1 that leaves the least median error."""
    known, places, D = problem.known, problem.known_positions, x.shape[1]
    best, score = x, np.inf
    for chosen in list(combinations(range(len(known)), min(D + 1, len(known))))[:MOST_SUBSETS]:
        moved = onto(x, known[list(chosen)], places[list(chosen)])
        error = np.median(np.linalg.norm(moved[known] - places, axis=1))
        if error < score:
            best, score = moved, error
    return best


def onto(x, known, places) -> np.ndarray:
    """`x` moved, turned and mirrored as a whole so that microphones `known` come to `places`."""
    goal = np.zeros_like(x)
    goal[known] = places
    return align(x, goal, known)
