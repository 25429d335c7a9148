"""Positions from short windows alone: starts, stages from low to high frequencies, and how far the data agree.

    F      Fisher information of everything that is free (`fdcal.cost.short_windows`)
    s_b    score of a block of groups;   lambda = sum_b s_b^T F^-1 s_b / P, 1 where the model holds
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..cost.short_windows import ShortField, ShortLikelihood, advanced, first_field, free_parameters, upright, with_direct_sound
from ..model.validation import Reals
from .levenberg_marquardt import FIRST_DAMPING, NewtonTerms, damped_step

STAGES = (600.0, 1500.0)  # Hz, highest frequencies of the first stages
MAX_STEP = 0.25  # longest move of a microphone in a step, over the shortest wavelength
STEPS, LAST_STEPS = 25, 40
DECREASE, LAST_DECREASE = 1.0, 0.02  # nats, at which a stage ends


def minimised(
    likelihood: ShortLikelihood, field: ShortField, free: Reals, steps: int = STEPS, least: float = DECREASE
) -> tuple[ShortField, float]:
    """Return the field of least cost near `field`, and its cost; free : (P,) bool."""
    damping, index, cost = FIRST_DAMPING, np.flatnonzero(free), np.inf
    longest = MAX_STEP * 2 * np.pi / float(likelihood.wavenumbers.max())

    def advance(field: ShortField, y: Reals) -> ShortField:
        return advanced(field, np.bincount(index, y, len(free)))

    for _ in range(steps):
        here = likelihood.terms(field)
        matrix = here.fisher[np.ix_(index, index)]
        step = damped_step(
            field,
            NewtonTerms(here.cost, here.gradient[index], matrix),
            lambda tried: likelihood.terms(tried, False).cost,
            lambda y, field=field: advance(field, y),
            lambda tried, field=field: float(np.abs(tried.positions - field.positions).max()),
            damping,
            longest,
        )
        field, damping, cost = step.unknowns, step.damping, step.cost
        if step.decrease < least:
            break
    return field, cost


def fitted(likelihood: ShortLikelihood, starts: Sequence[Reals], axes: int, warm: Sequence[Reals] = ()):
    """Return the likeliest field, its cost, and which parameters were free.

    starts, warm : positions (N, D), metres; those of `warm` begin with all frequencies.
    """
    N, T = likelihood.pressures.shape[2], int(likelihood.takes.max()) + 1
    alone, direct = free_parameters(N, T, axes), free_parameters(N, T, axes, direct=True)
    k, found = likelihood.wavenumbers, []
    lowest = np.unique(k)[min(3, len(np.unique(k)) - 1)]
    for number, positions in enumerate([*starts, *warm]):
        field = first_field(positions, T)
        for top in STAGES if number < len(starts) else STAGES[1:]:
            kept = k <= max(2 * np.pi * top / SPEED, lowest)
            part = replace(likelihood, wavenumbers=k[kept], takes=likelihood.takes[kept], pressures=likelihood.pressures[kept])
            field, _ = minimised(part, field, alone)
            field = with_direct_sound(part, field)
            field, _ = minimised(part, field, direct)
        found.append(minimised(likelihood, field, direct))
    field, _ = min(found, key=lambda one: one[1])
    if axes == 3:
        field, _ = minimised(likelihood, field, free_parameters(N, T, axes, degree=2, direct=True), LAST_STEPS)
        field = upright(field)
    free = free_parameters(N, T, axes, True, TOP, True)
    for _ in range(ROUNDS):
        likelihood = replace(likelihood, dispersion=dispersion(likelihood, field, free))
        field, cost = minimised(likelihood, field, free, LAST_STEPS, LAST_DECREASE)
    return field, cost, free, likelihood


ROUNDS = 3


def dispersion(likelihood: ShortLikelihood, field: ShortField, free: Reals) -> float:
    here, index = replace(likelihood, dispersion=1.0).terms(field), np.flatnonzero(free)
    scores = here.scores[:, index]
    order = np.lexsort((likelihood.wavenumbers, likelihood.takes))
    blocks = np.array_split(order, max(1, len(order) // PER_BLOCK))
    s = np.array([scores[b].sum(0) for b in blocks])
    s = s - s.mean(0)
    # eigenvalues of F on which the prior does not rule
    H = here.fisher[np.ix_(index, index)]
    w, v = np.linalg.eigh(H)
    keep = w > 1e-6 * w.max()
    return max(1.0, float(np.mean(np.sum((s @ v[:, keep]) ** 2, axis=0) / w[keep])))


PER_BLOCK = 1
import os
TOP = int(os.environ.get('TOP','4'))


SPEED = 343.0
