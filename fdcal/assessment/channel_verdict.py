"""Whether the array that solver "robust" found can be trusted.

The codes and their order are those of `fdcal.assessment.verdict`. A faulty channel does not spoil the verdict of the
others: it is named, and the verdict is that of the rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..acoustics.fourier_bessel import array_f_max
from ..model.gauge import align
from ..model.problem import Problem
from ..model.validation import frozen_array, word_arguments
from ..solvers.robust.state import State
from ..solvers.robust.unit_power import in_unit_power
from . import findings
from .ambiguity import rms_radius
from .channel_covariance import Uncertainty, uncertainty
from .error_ellipses import one_sigma
from .odd_channels import OddChannel, channel_faults, exchange_back, healthy_channels, odd_channels


@dataclass(frozen=True)
class ChannelThresholds:
    """Limits beyond which a figure becomes a finding.

    Attributes
    ----------
    weaker_field : factor on the power of the field in the covariance: rooms are less isotropic than their model
    noise_share : noise over the power of the pressures
    relative_sigma : one sigma of the positions over the root mean square radius of the array
    stretch_sigma : one sigma of the least certain stretching of a blind array, relative
    noise_to_given : noise found over the noise given
    unexplained_share : share of the power left unexplained where the measurement is said to be free of noise
    odd_channels, odd_share : odd channels, and their part of all; more than the larger one are no single faults
    misplaced_share : part of the given positions that may be misplaced; one may always be
    rival_cost : nats within which another end of the solver counts
    rival_sigmas, rival_distance : sigmas and metres within which two ends are one; the larger one counts
    """

    weaker_field: float = 4.0
    noise_share: float = 0.3
    relative_sigma: float = 0.1
    stretch_sigma: float = 0.06
    noise_to_given: float = 2.0
    unexplained_share: float = 1e-4
    odd_channels: int = 2
    odd_share: float = 0.12
    misplaced_share: float = 0.2
    rival_cost: float = 8.0
    rival_sigmas: float = 3.0
    rival_distance: float = 1e-3


LIMITS = ChannelThresholds()


@dataclass(frozen=True)
class RobustVerdict:
    """The judgement on an array with the gains of its channels.

    Attributes
    ----------
    code : str
        good, too_noisy, undersampled, not_converged, known_position, model_mismatch, ambiguous or scale_undetermined.
    message : str
        What it means and what to do, one line; arguments stand in angle brackets.
    positions : (N, D) float64
        Metres, exchanges undone.
    covariance : (N, D, D) float64
        Metres^2.
    sigma : (N,) float64
        Metres, square root of the trace of the covariance.
    gains, gain_sigma : (N, 2) float64
        Log gain, nepers, and phase, radians.
    channel_noise : (N,) float64
        Over that of a healthy channel.
    odd : tuple of OddChannel
    stretch_sigma : float
        One sigma of the least certain stretching of the array, relative.
    noise_share : float
        Of the power.
    residual_to_noise : float
        Reduced chi-square of the pressures of the healthy channels.
    """

    code: str
    message: str
    positions: np.ndarray
    covariance: np.ndarray
    sigma: np.ndarray
    gains: np.ndarray
    gain_sigma: np.ndarray
    channel_noise: np.ndarray
    odd: tuple[OddChannel, ...]
    stretch_sigma: float
    noise_share: float
    residual_to_noise: float

    def worded(self, names: Mapping[str, str]) -> str:
        """Return the message with its arguments called as in `names`."""
        return word_arguments(self.message, names)


def judge(problem: Problem, state: State, names: Sequence[str] | None = None) -> RobustVerdict:
    """Return the verdict on where the solver ended.

    Parameters
    ----------
    problem : Problem
    state : State
    names : sequence of N str, optional
        Of the microphones; their numbers unless given.
    """
    problem = in_unit_power(problem)
    names = [str(n) for n in range(len(state.positions))] if names is None else list(names)
    found = uncertainty(problem, state, LIMITS.weaker_field)
    sigma = np.asarray(one_sigma(found.covariance))
    odd = odd_channels(problem, state, found)
    healthy = healthy_channels(len(sigma), odd)
    residual = _residual_to_noise(problem, state, found, healthy)
    code, message = _finding(problem, state, found, sigma, odd, names, residual)
    m = state.model
    return RobustVerdict(
        code, message, frozen_array(exchange_back(problem, state, odd), float), frozen_array(found.covariance, float),
        frozen_array(sigma, float), state.gains, found.gains, m.channel_noise, odd, found.stretch_sigma, m.share,
        residual,
    )  # fmt: skip


def _finding(
    problem: Problem, state: State, found: Uncertainty, sigma, odd, names: Sequence[str], residual: float
) -> tuple[str, str]:
    """Return code and message of the first finding in this order."""
    healthy = healthy_channels(len(sigma), odd)
    done = state.converged or state.finished  # the last rounds may end on their limit of steps, moving very little
    x, share = state.positions[healthy], state.model.share
    checks = (
        ("too_noisy", lambda: findings.mostly_noise(share) if share > LIMITS.noise_share else ""),
        ("model_mismatch", lambda: _many_odd(odd, names)),
        ("known_position", lambda: _known_position(problem, odd, names)),
        ("undersampled", lambda: _undersampled(problem, x, state.modes)),
        ("not_converged", lambda: "" if done else findings.NOT_CONVERGED),
        ("model_mismatch", lambda: _excess_noise(problem, share)),
        ("scale_undetermined", lambda: _loose_scale(problem, found)),
        ("ambiguous", lambda: _ambiguous(state, sigma, healthy)),
        ("good", lambda: _good(problem, sigma, odd, names, residual)),
    )
    return next((code, message) for code, check in checks if (message := check()))


def _residual_to_noise(problem: Problem, state: State, found: Uncertainty, healthy) -> float:
    """Return `RobustVerdict.residual_to_noise`."""
    terms, v = found.terms, state.model.noise[state.modes, None] * state.model.channel_noise
    free = problem.array_dimension + 2  # parameters of a channel, real ones
    freedom = np.sum((v * terms.precision)[:, healthy]) - free * np.sum(healthy) / 2  # in complex numbers
    return float(np.sum((v * np.abs(terms.weighted) ** 2)[:, healthy]) / max(freedom, 1.0))


def _many_odd(odd: Sequence[OddChannel], names: Sequence[str]) -> str:
    """Report that the odd channels are too many for single faults."""
    if len(odd) <= max(LIMITS.odd_channels, LIMITS.odd_share * len(names)):
        return ""
    return findings.unfitted([names[one.number] for one in odd])


def _known_position(problem: Problem, odd: Sequence[OddChannel], names: Sequence[str]) -> str:
    """Report wrong given positions that are too many, or leave too few, to hold the array."""
    wrong = [one for one in odd if one.number in problem.known and one.kind in ("misplaced", "exchanged")]
    misplaced = [one for one in wrong if one.kind == "misplaced"]
    few = len(wrong) > 0 and len(problem.known) - len(wrong) < problem.array_dimension + 1
    if few or len(misplaced) > max(1, LIMITS.misplaced_share * len(problem.known)):
        return findings.contradicted([names[one.number] for one in wrong])
    return ""


def _undersampled(problem: Problem, healthy: np.ndarray, modes: slice) -> str:
    if array_f_max(healthy, problem.sound_speed, problem.dimension) >= problem.frequencies[modes][-1]:
        return ""
    return findings.undersampled(problem, healthy, modes)


def _excess_noise(problem: Problem, share: float) -> str:
    """Report that more is left unexplained than the noise given."""
    if problem.noise_power is None:
        return ""
    given = float(np.median(problem.noise_power))
    if given > 0 and share > LIMITS.noise_to_given * given:
        return f"the residual is {share / given:.2g} times what the noise explains: {findings.CAUSES}"
    if given == 0 and share > LIMITS.unexplained_share:
        return findings.unexplained(share)
    return ""


def _loose_scale(problem: Problem, found: Uncertainty) -> str:
    loose = not len(problem.known) and found.stretch_sigma > LIMITS.stretch_sigma
    return findings.SCALE_UNDETERMINED if loose else ""


def _ambiguous(state: State, sigma, healthy) -> str:
    """Report positions that are hardly determined, or another end of the solver that is as likely."""
    size = rms_radius(state.positions[healthy])
    spread = findings.root_mean_square(sigma[healthy])
    if spread > LIMITS.relative_sigma * size:
        return findings.hardly_determined(spread)
    return _rival(state, max(LIMITS.rival_sigmas * spread, LIMITS.rival_distance), healthy)


def _rival(state: State, same: float, healthy) -> str:
    """Report another end that is as likely, or several ends of which no two agree; `same` is in metres."""
    ends = sorted((end for end in state.ends if np.isfinite(end.score)), key=lambda end: end.score)
    others = [align(end.positions, ends[0].positions, healthy) - ends[0].positions for end in ends[1:]]
    away = [float(np.sqrt(np.mean(np.sum(apart[healthy] ** 2, axis=1)))) for apart in others]
    for end, distance in zip(ends[1:], away, strict=True):
        if distance > same and end.score - ends[0].score < LIMITS.rival_cost:
            return findings.equally_likely(distance)
    if len(state.ends) > 2 and min(away, default=np.inf) > same:
        return (
            f"each of {len(state.ends)} starts of the search ended at another array; use more <modes>, or more known"
            " microphones"
        )
    return ""


def _good(problem: Problem, sigma, odd, names: Sequence[str], residual: float) -> str:
    """Return the message of an array that no check contradicts, and what is wrong with its odd channels."""
    given = problem.noise_power is not None and bool(np.any(problem.noise_power > 0))
    precision = findings.precision(sigma[healthy_channels(len(sigma), odd)], residual, given)
    if not odd:
        return f"nothing speaks against these positions; {precision}"
    faults = "; ".join(fault.text for fault in channel_faults(odd, names))
    return f"nothing speaks against the positions of the other microphones; {precision}; odd: {faults}"
