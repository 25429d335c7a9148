"""Decisions of the joint solver at the end of a stage: is it good enough, and what follows."""

from __future__ import annotations

import numpy as np

from ...cost.noise_model import NOISE, NoiseEstimate
from ...model.power import mode_power
from ...model.problem import Problem
from .. import initial_positions
from ..residual_noise import LIMITS, misfits, noise_at
from .state import State
from .thresholds import NOISE_LIMITS, PRIOR


def needs_free_stage(problem: Problem, state: State, residual: NoiseEstimate) -> bool:
    """Return whether every microphone should be moved by itself once more.

    That is the case while the position error still falls and exceeds the noise, or a microphone is in a wrong basin.
    """
    highest = float(np.real(problem.wavenumbers[state.modes]).max())
    spread = (highest * residual.spread) ** 2 / residual.dimension > residual.noise
    falls = spread and residual.spread < 0.7 * state.field.spread
    return falls or (
        state.phase.steps > 1
        and float(misfits(problem, state.positions, state.modes, residual).max())
        > (LIMITS.outlier if only_noise_left(problem, residual) else LIMITS.suspect)
    )


def only_noise_left(problem: Problem, residual: NoiseEstimate) -> bool:
    """Return whether the residual is noise alone: wrong positions leave a position error, too."""
    share = float(np.median(residual.shares(problem.wavenumbers)))
    return share <= max(NOISE_LIMITS.noise_alone * residual.noise, NOISE_LIMITS.negligible)


def noise_differs(problem: Problem, state: State, other: State) -> bool:
    """Return whether `other` assumes much less noise than `state` or, if `state` assumes the least, a little more."""
    before, after = (float(np.median(s.field.noise / mode_power(problem.pressures))) for s in (state, other))
    least = before <= 2 * NOISE.near_field_floor
    return after < 0.5 * before or (least and 2 * before < after <= NOISE.near_field(problem.dimension))


def prior_helps(problem: Problem, state: State) -> bool:
    """Return whether there is so much noise that an angular prior estimated from the pressures helps."""
    noisy = float(np.median(state.field.noise_power / mode_power(problem.pressures))) >= PRIOR.least_noise
    return problem.dimension == 2 and noisy and state.settings.cost == "likelihood"


def low_noise(problem: Problem, state: State) -> float | None:
    """Return the share of the reported noise if it is so low that the near-field model must explain the rest."""
    share = float(np.median(state.field.noise_power / mode_power(problem.pressures)))
    return share if state.field.noise_given and share <= NOISE.near_field(problem.dimension) else None


def accepted(problem: Problem, state: State) -> bool:
    """Return whether the reported noise is low and the near-field model explains all but that."""
    given = low_noise(problem, state)
    if given is None:
        return False
    return noise_at(problem, state.positions, state.modes, True, given).chi_square <= NOISE.chi_square


def attempts(problem: Problem, state: State) -> list[tuple[str, float]]:
    """Return the attempts that are possible; the last of `initial_positions.attempts` is for the near-field model."""
    tries = initial_positions.attempts(problem, state.settings.modes)
    return tries if state.field.near_field or low_noise(problem, state) is not None else tries[:-1]


def worse_than_best(problem: Problem, state: State) -> bool:
    """Return whether an attempt before has ended at a lower cost by the same model."""
    best = state.attempt.best
    if best is None:
        return False
    near_field = best.near_field and low_noise(problem, state) is None
    return best.cost < noise_at(problem, state.positions, state.modes, near_field).cost


def confirmed(problem: Problem, state: State, residual: NoiseEstimate) -> bool:
    """Return whether the residual of an attempt is the reported noise or, if none is, that of another attempt, too.

    Two attempts may end at the same wrong positions, which leave a position error; an attempt with another direction
    hardly does.
    """
    redirected = ("redirected", 0) in attempts(problem, state)[: state.attempt.number + 1]
    best = state.attempt.best
    same = best is not None and abs(best.cost - residual.cost) < 1.0 + 1e-4 * abs(residual.cost)
    if low_noise(problem, state) is not None:
        return same and redirected
    noise = float(np.median(state.field.noise_power / mode_power(problem.pressures)))
    given = noise if state.field.noise_given else 0.0
    share = float(np.median(residual.shares(problem.wavenumbers)))
    if share <= max(NOISE_LIMITS.noise_alone * given, NOISE_LIMITS.negligible):
        return True
    alone = only_noise_left(problem, residual)
    return (alone and (share <= NOISE_LIMITS.confirmed * given or same)) or (same and redirected)
