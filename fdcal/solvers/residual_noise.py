"""The residual at given positions: its noise, the microphones that do not fit, and better positions for these.

Everything here uses a part of the modes, evenly spaced: these are rough decisions, and few modes are enough.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..cost.leave_one_out import leave_one_out_chi_square, likelihood_landscapes
from ..cost.likelihood import DiffuseField, diffuse_field
from ..cost.noise_model import NoiseEstimate, estimate_noise
from ..model.power import mode_power
from ..model.problem import Problem
from .bounds import check_deadline


@dataclass(frozen=True)
class ResidualLimits:
    """How many modes are used, and which microphones are moved.

    Attributes
    ----------
    modes : modes at most from which the noise is estimated
    pressures : pressures, about, to which a deformation or a metric is fitted, which have few parameters
    suspect : leave-one-out chi-square (1 is expected) above which a microphone may stand in a wrong basin
    outlier : the same, above which it certainly does
    relocated : microphones at most that are relocated at once
    candidates : places at most to which one is relocated, about
    """

    modes: int = 24
    pressures: int = 4000
    suspect: float = 1.3
    outlier: float = 2.5
    relocated: int = 8
    candidates: int = 20_000


LIMITS = ResidualLimits()


def noise_at(
    problem: Problem, positions, modes: slice, near_field: bool = False, given_share: float = 0.0
) -> NoiseEstimate:
    """Return `fdcal.cost.noise_model.estimate_noise` of a part of the modes.

    Parameters
    ----------
    problem : Problem
    positions : (N, D) float64, metres
    modes : slice, modes in use
    near_field, given_share : as of `estimate_noise`
    """
    used = _spaced(problem, modes)
    p, k = problem.pressures[used], problem.wavenumbers[used]
    return estimate_noise(positions, p, k, problem.dimension, near_field, given_share)


def misfits(problem: Problem, positions, modes: slice, residual: NoiseEstimate) -> np.ndarray:
    """Return the leave-one-out chi-square of every microphone (N,), the whole residual taken as noise."""
    p, _, field = _rough_field(problem, modes, residual)
    return leave_one_out_chi_square(positions, p, field)


def relocated(problem: Problem, positions, modes: slice, residual: NoiseEstimate) -> np.ndarray:
    """Return the positions with the microphones that fit worst moved to where they fit best, the others held.

    A rough start puts some microphones into a wrong basin; these would diverge once less noise is assumed. The
    candidates cover the array, an eighth of the shortest wavelength apart: a coarse step of the paper's method for a
    few microphones. For an array of very many wavelengths they are further apart, so that there are
    `ResidualLimits.candidates` at most.

    Parameters
    ----------
    problem : Problem
    positions : (N, D) float64, metres
    modes : slice, modes in use
    residual : NoiseEstimate, of `noise_at` at these positions

    Returns
    -------
    (N, D) float64, metres
    """
    p, k, field = _rough_field(problem, modes, residual)
    x = np.array(positions)
    misfit = leave_one_out_chi_square(x, p, field)
    candidates = _lattice_over(x, np.pi / 4 / float(k.max()))
    worst = [n for n in np.argsort(-misfit)[: LIMITS.relocated] if misfit[n] > LIMITS.suspect and n in problem.free]
    while worst:
        check_deadline()
        costs = likelihood_landscapes(x, worst, np.vstack([x[worst], candidates]), p, field).sum(axis=0)
        own = np.arange(len(worst))
        costs[:, : len(worst)] = np.where(own[:, None] == own, costs[:, : len(worst)], np.inf)  # not onto another
        falls = np.diag(costs) - costs.min(axis=1)
        moving = np.flatnonzero(falls > 1.0)
        if not len(moving):
            break
        first = int(moving[0])  # the landscapes of the others change with it
        x[worst[first]] = np.vstack([x[worst], candidates])[int(np.argmin(costs[first]))]
        worst = worst[first + 1 :]
    return x


def _lattice_over(x: np.ndarray, apart: float) -> np.ndarray:
    """Return a lattice over positions x (N, D), with `apart` metres, or more, between its points : (C, D), metres."""
    size = np.ptp(x, axis=0) + 3 * apart
    apart = max(apart, float((np.prod(size) / LIMITS.candidates) ** (1 / x.shape[1])))
    axes = [np.arange(low - apart, high + 2 * apart, apart) for low, high in zip(x.min(0), x.max(0), strict=True)]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, x.shape[1])


def enough_modes(problem: Problem, modes: slice) -> np.ndarray:
    """Return indices of as many modes, evenly spaced, as a fit of few parameters needs : int64."""
    chosen = np.arange(len(problem.pressures))[modes]
    count = len(chosen) * problem.pressures.shape[1] // LIMITS.pressures
    return chosen[:: max(1, min(count, len(chosen) // LIMITS.modes))]


def _spaced(problem: Problem, modes: slice) -> np.ndarray:
    """At most `LIMITS.modes` of the modes, evenly spaced : int64."""
    chosen = np.arange(len(problem.pressures))[modes]
    return chosen[:: max(1, -(-len(chosen) // LIMITS.modes))]


def _rough_field(
    problem: Problem, modes: slice, residual: NoiseEstimate
) -> tuple[np.ndarray, np.ndarray, DiffuseField]:
    """Pressures, wavenumbers and the diffuse field of a part of the modes."""
    used = _spaced(problem, modes)
    p, k = problem.pressures[used], np.real(problem.wavenumbers[used])
    return p, k, diffuse_field(p, k, residual.shares(k) * mode_power(p), problem.dimension)
