"""The single checks of the verdict on an array with the gains of its channels.

Each returns a message, or "" where there is nothing to report; arguments stand in angle brackets, as in
`fdcal.assessment.findings`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..acoustics.fourier_bessel import array_f_max
from ..model.gauge import align
from ..model.problem import Problem
from ..solvers.robust.state import State
from . import findings, given_findings
from .ambiguity import rms_radius
from .channel_covariance import Uncertainty
from .error_ellipses import one_sigma
from .given_check import GivenCheck
from .odd_channels import OddChannel, channel_faults, healthy_channels


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
    rival_cost : nats within which another end of the solver counts
    rival_sigmas, rival_distance : sigmas and metres within which two ends are one; the larger one counts
    uneven_noise : noise of a healthy channel over that of the median channel
    uneven_share : part of the healthy channels above that level; more than it are no single noisy channels
    uneven_share_of_power : share of the power that its noise must exceed: a recording leaves as much by leakage
    uneven_channels : fewest such channels
    unfinished : Newton step left over one sigma of its coordinate
    """

    weaker_field: float = 4.0
    noise_share: float = 0.3
    relative_sigma: float = 0.1
    stretch_sigma: float = 0.06
    noise_to_given: float = 2.0
    unexplained_share: float = 1e-4
    odd_channels: int = 2
    odd_share: float = 0.12
    rival_cost: float = 8.0
    rival_sigmas: float = 3.0
    rival_distance: float = 1e-3
    uneven_noise: float = 2.0
    uneven_share: float = 0.1
    uneven_share_of_power: float = 1e-4
    uneven_channels: int = 3
    unfinished: float = 3.0


LIMITS = ChannelThresholds()


@dataclass(frozen=True)
class ChannelEvidence:
    """What the verdict on an array rests on.

    Attributes
    ----------
    found : Uncertainty, by the curvature at the minimum
    covariance : (N, D, D) float64, metres^2, with the step left and the spread of the search
    sigma : (N,) float64, metres, square root of its trace
    odd : tuple of OddChannel
    step_left : float, Newton step left over one sigma of its coordinate, the largest of healthy channels
    given : GivenCheck
    stretch : float or None, sound speed that follows from a given distance over that of the problem
    single_wave : whether there are hardly any reflections, so that nothing is known of single channels
    """

    found: Uncertainty
    covariance: np.ndarray
    sigma: np.ndarray
    odd: tuple[OddChannel, ...]
    step_left: float
    given: GivenCheck
    stretch: float | None = None
    single_wave: bool = False

    @property
    def healthy(self) -> np.ndarray:
        """Which channels are not odd : (N,) bool."""
        return healthy_channels(len(self.sigma), self.odd)


def first_finding(problem: Problem, state: State, seen: ChannelEvidence, names: Sequence[str]) -> tuple[str, str]:
    """Return code and message of the first finding in this order; "good" is the last.

    Parameters
    ----------
    problem : Problem
        With modes of unit power.
    state : State
    seen : ChannelEvidence
    names : sequence of N str
    """
    x, share = state.positions[seen.healthy], state.model.share
    ended = state.converged or state.finished
    checks = (
        ("too_noisy", lambda: findings.mostly_noise(share) if share > LIMITS.noise_share else ""),
        ("model_mismatch", lambda: findings.SINGLE_WAVE if seen.single_wave else ""),
        ("model_mismatch", lambda: _many_odd(seen.odd, names) or _uneven_noise(state, seen.healthy)),
        ("known_position", lambda: given_findings.disagreement(problem, seen.odd, seen.given, names)),
        ("undersampled", lambda: _undersampled(problem, x, state.modes)),
        ("not_converged", lambda: "" if ended and seen.step_left < LIMITS.unfinished else findings.NOT_CONVERGED),
        ("model_mismatch", lambda: _excess_noise(problem, share)),
        ("sound_speed", lambda: _implied_speed(problem, state, seen)),
        ("scale_undetermined", lambda: "" if seen.stretch is not None else _loose_scale(problem, seen.found)),
        ("ambiguous", lambda: _ambiguous(problem, state, seen)),
        ("good", lambda: _good(problem, state, seen, names)),
    )
    return next((code, message) for code, check in checks if (message := check()))


def residual_to_noise(problem: Problem, state: State, found: Uncertainty, healthy) -> float:
    """Return the reduced chi-square of the pressures of the healthy channels."""
    terms, v = found.terms, found.goal.field.noise[:, None] * state.model.channel_noise
    free = problem.array_dimension + 2  # parameters of a channel, real ones
    freedom = np.sum((v * terms.precision)[:, healthy]) - free * np.sum(healthy) / 2  # in complex numbers
    return float(np.sum((v * np.abs(terms.weighted) ** 2)[:, healthy]) / max(freedom, 1.0))


def _many_odd(odd: Sequence[OddChannel], names: Sequence[str]) -> str:
    """Report that the odd channels are too many for single faults."""
    if len(odd) <= max(LIMITS.odd_channels, LIMITS.odd_share * len(names)):
        return ""
    return findings.unfitted([names[one.number] for one in odd])


def _uneven_noise(state: State, healthy: np.ndarray) -> str:
    """Report that the residual of many healthy channels is far above that of the others.

    Noise is alike in channels of one kind, before or behind their gains; what a sound field without sources cannot
    explain is not.
    """
    corrected = state.model.channel_noise[healthy]
    recorded = corrected * np.exp(2 * state.gains[healthy, 0])
    high = np.all([tau > LIMITS.uneven_noise * np.median(tau) for tau in (corrected, recorded)], axis=0)
    high &= corrected * state.model.share > LIMITS.uneven_share_of_power
    if np.sum(high) < max(LIMITS.uneven_channels, LIMITS.uneven_share * len(corrected)):
        return ""
    many = f"{np.sum(high)} of {len(high)} microphones"
    return f"the residual of {many} is {LIMITS.uneven_noise:g} times that of the median one, or more: {findings.CAUSES}"


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


def _implied_speed(problem: Problem, state: State, seen: ChannelEvidence) -> str:
    """Report a sound speed that the air can hardly have: of a given distance, or found from given positions."""
    if seen.stretch is None and state.model.log_speed:
        found = float(np.exp(state.model.log_speed))
        return findings.implied_speed(problem.sound_speed, found, seen.found.log_speed, "position of a microphone")
    return findings.implied_speed(problem.sound_speed, seen.stretch, seen.found.stretch_sigma)


def _loose_scale(problem: Problem, found: Uncertainty) -> str:
    loose = not len(problem.known) and found.stretch_sigma > LIMITS.stretch_sigma
    return findings.SCALE_UNDETERMINED if loose else ""


def _ambiguous(problem: Problem, state: State, seen: ChannelEvidence) -> str:
    """Report positions that are hardly determined or cannot be checked, or another end that is as likely."""
    healthy = seen.healthy
    alone = findings.root_mean_square(np.asarray(one_sigma(seen.found.covariance))[healthy])
    rival = _rival(state, max(LIMITS.rival_sigmas * alone, LIMITS.rival_distance), healthy)
    spread, size = findings.root_mean_square(seen.sigma[healthy]), rms_radius(state.positions[healthy])
    if rival or spread > LIMITS.relative_sigma * size:
        return rival or findings.hardly_determined(spread)
    return given_findings.unchecked(problem, seen.given, spread)


def _rival(state: State, same: float, healthy) -> str:
    """Report another end that is as likely, or several ends of which no two agree; `same` is in metres."""
    ends = sorted((end for end in state.ends if np.isfinite(end.score)), key=lambda end: end.score)
    others = [align(end.positions, ends[0].positions, healthy) - ends[0].positions for end in ends[1:]]
    away = [float(np.sqrt(np.mean(np.sum(apart[healthy] ** 2, axis=1)))) for apart in others]
    for end, distance in zip(ends[1:], away, strict=True):
        if distance > same and end.score - ends[0].score < LIMITS.rival_cost:
            return findings.equally_likely(distance)
    starts = sum(not end.regrouped for end in state.ends)
    independent = [distance for end, distance in zip(ends[1:], away, strict=True) if not end.regrouped]
    if starts > 2 and min(independent, default=np.inf) > same:
        return (
            f"each of {starts} starts of the search ended at another array; use more <modes>, or more known microphones"
        )
    return ""


def _good(problem: Problem, state: State, seen: ChannelEvidence, names: Sequence[str]) -> str:
    """Return the message of an array that no check contradicts, and what is wrong with its odd channels."""
    given = problem.noise_power is not None and bool(np.any(problem.noise_power > 0))
    residual = residual_to_noise(problem, state, seen.found, seen.healthy)
    sought = seen.healthy & ~np.isin(np.arange(len(seen.sigma)), problem.known)
    precision = findings.precision(seen.sigma[sought if np.any(sought) else seen.healthy], residual, given)
    precision += given_findings.inaccuracy(problem, state)
    if not seen.odd:
        return f"nothing speaks against these positions; {precision}"
    faults = "; ".join(fault.text for fault in channel_faults(seen.odd, names))
    return f"nothing speaks against the positions of the other microphones; {precision}; odd: {faults}"
