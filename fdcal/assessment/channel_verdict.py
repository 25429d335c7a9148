"""Whether the array found can be trusted. A faulty channel is named and does not spoil the verdict of the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..acoustics.fourier_bessel import array_f_max
from ..model.gauge import align
from ..model.problem import Problem
from ..solvers.robust.state import State
from ..solvers.robust.unit_power import in_unit_power
from .channel_covariance import uncertainty
from .odd_channels import OddChannel, exchange_back, odd_channels

WEAKER = 4.0  # factor on the power of the field in the covariance: rooms are less isotropic than their model
TOO_NOISY = 0.3  # share of the power
LOOSE = 0.1  # one sigma over the array's root mean square radius
LOOSE_STRETCH = 0.06  # one sigma of the least certain stretching of a blind array
MISFIT = 2.0  # noise found over the noise given
CROWD = 2, 0.12  # channels that may be odd, and part of them
MANY = 0.2  # part of the given positions that may be misplaced
RIVAL = 8.0  # nats within which another end counts
AGREED = 3.0  # sigmas within which two ends are one


@dataclass(frozen=True)
class RobustVerdict:
    """What to think of an array found.

    Attributes
    ----------
    code : good, too_noisy, undersampled, known_position, model_mismatch, ambiguous or scale_undetermined
    positions : (N, D) float64, metres, exchanges undone
    covariance : (N, D, D) float64, metres^2
    sigma : (N,) float64, metres, root of its trace
    gains, gain_sigma : (N, 2) float64, nepers and radians
    channel_noise : (N,) float64, over that of a sound channel
    odd : tuple of OddChannel
    stretch_sigma, noise_share : float
    """

    code: str
    positions: np.ndarray
    covariance: np.ndarray
    sigma: np.ndarray
    gains: np.ndarray
    gain_sigma: np.ndarray
    channel_noise: np.ndarray
    odd: tuple[OddChannel, ...]
    stretch_sigma: float
    noise_share: float


def judge(problem: Problem, state: State) -> RobustVerdict:
    """Verdict on where the solver ended."""
    problem = in_unit_power(problem)
    found = uncertainty(problem, state, WEAKER)
    sigma = np.sqrt(np.maximum(np.trace(found.covariance, axis1=1, axis2=2), 0.0))
    odd = odd_channels(problem, state, found)
    sound = np.ones(len(sigma), bool)
    sound[[one.number for one in odd]] = False
    code = _code(problem, state, found, sigma, odd, sound)
    x = exchange_back(problem, state, odd)
    m = state.model
    return RobustVerdict(
        code, x, found.covariance, sigma, state.gains, found.gains, m.channel_noise, odd, found.stretch_sigma, m.share
    )


def _code(problem: Problem, state: State, found, sigma, odd, sound) -> str:
    share = state.model.share
    if share > TOO_NOISY:
        return "too_noisy"
    x = state.positions[sound]
    if np.sum(~sound) > max(CROWD[0], CROWD[1] * len(sigma)):
        return "model_mismatch"
    wrong = [one for one in odd if one.number in problem.known and one.kind in ("misplaced", "exchanged")]
    displaced = [one for one in wrong if one.kind == "misplaced"]
    few = len(wrong) > 0 and len(problem.known) - len(wrong) < problem.array_dimension + 1
    if few or len(displaced) > max(1, MANY * len(problem.known)):
        return "known_position"
    if array_f_max(x, problem.sound_speed, problem.dimension) < problem.frequencies[state.modes][-1]:
        return "undersampled"
    given = problem.noise_power
    if given is not None and share > max(MISFIT * float(np.median(given)), 1e-4 if np.median(given) == 0 else 0.0):
        return "model_mismatch"
    size = float(np.sqrt(np.mean(np.sum((x - x.mean(axis=0)) ** 2, axis=1))))
    if not len(problem.known) and found.stretch_sigma > LOOSE_STRETCH:
        return "scale_undetermined"
    if np.sqrt(np.mean(sigma[sound] ** 2)) > LOOSE * size or _rival(problem, state, sigma, sound):
        return "ambiguous"
    return "good"


def _rival(problem: Problem, state: State, sigma, sound) -> bool:
    """Whether another attempt ended elsewhere, as likely; or no two ends agree although several were tried."""
    ends = sorted(state.ends, key=lambda end: end.score)
    best, allowed = ends[0], max(AGREED * float(np.sqrt(np.mean(sigma[sound] ** 2))), 1e-3)
    agree = 1
    for end in ends[1:]:
        if not np.isfinite(end.score):
            continue
        apart = (align(end.positions, best.positions, sound) - best.positions)[sound]
        away = float(np.sqrt(np.mean(np.sum(apart**2, axis=1)))) > allowed
        if away and end.score - best.score < RIVAL:
            return True
        agree += not away
    return agree < 2 and len(ends) > 2
