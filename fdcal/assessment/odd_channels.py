"""Channels and given positions that are not what they should be, and what is wrong with each.

inverted, gain     the gain or phase is far from that of the others
delayed            the phase against what the others predict falls with the frequency
high_pass          bass is cut, or less cut than that of the others, as by a first-order high-pass
dead               the others predict nothing of it, or it holds no more than they expect of noise
noisy              its noise is far above that of the others
misplaced          a given position that the pressures contradict
exchanged          two channels, or two given positions, each in the other's place
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..model.problem import Problem
from ..solvers.robust.state import State
from .calibration import DECIBELS_PER_NEPER, ChannelFault
from .channel_covariance import Uncertainty


@dataclass(frozen=True)
class OddThresholds:
    """Limits beyond which a channel or a given position is odd.

    Attributes
    ----------
    inverted : radians, phase
    gain_sigmas : spreads of the gains, or phases, of all channels
    median_of_normal : median absolute deviation of a normal distribution over its sigma
    least_gain : nepers of the gain, or radians of the phase, that are never odd
    noise : noise of a channel over that of the median channel
    least_noise : share of the power below which noise is not odd: the misfit of the field model may be a channel's
    unpredicted : share of a channel's variance, or of its power, that the others do not predict
    unpredicted_to_median : the same over that of the median channel
    coherent : share of the power that a delay must explain
    delay_gain : coherence at the best delay over that without delay
    longest_delay, delay_step : seconds, delays tried
    filter_sigmas : sigmas of a delay, or of a corner frequency
    least_delay, least_corner : seconds and hertz that are never odd
    misplaced_sigmas, misplaced : sigmas and metres, distance from a given position; the larger one counts
    exchanged_sigmas, exchanged : sigmas and metres within which a channel is in another's place, likewise
    exchanged_share : the same over the distance from its own given position
    """

    inverted: float = 2.5
    gain_sigmas: float = 4.0
    median_of_normal: float = 0.6745
    least_gain: float = 0.12
    noise: float = 12.0
    least_noise: float = 1e-4
    unpredicted: float = 0.5
    unpredicted_to_median: float = 3.0
    coherent: float = 0.5
    delay_gain: float = 1.02
    longest_delay: float = 2e-3
    delay_step: float = 1e-5
    filter_sigmas: float = 4.0
    least_delay: float = 2e-5
    least_corner: float = 3.0
    misplaced_sigmas: float = 3.0
    misplaced: float = 0.006
    exchanged_sigmas: float = 3.0
    exchanged: float = 0.005
    exchanged_share: float = 0.3


LIMITS = OddThresholds()


@dataclass(frozen=True)
class OddChannel:
    """A channel or a given position that stands out.

    Attributes
    ----------
    number : int, of the microphone, from 0
    kind : str, as above
    value : float, gain in decibels, phase in degrees, delay in seconds, distance from the given position in metres, or
        noise in decibels over the median channel, or corner frequency in hertz over that of the others; nan for an
        inverted channel
    unit : str, of the value; "" without one
    partner : int, the other microphone of an exchange, or -1
    """

    number: int
    kind: str
    value: float
    unit: str
    partner: int = -1


def odd_channels(problem: Problem, state: State, found: Uncertainty) -> tuple[OddChannel, ...]:
    """Return all channels and given positions that stand out, in the order of the microphones.

    Parameters
    ----------
    problem : Problem
        With modes of unit power (`fdcal.solvers.robust.unit_power`).
    state : State
    found : Uncertainty
    """
    odd = {}
    tau, terms = state.model.channel_noise, found.terms
    predicted = terms.corrected - terms.weighted / terms.precision
    tau = np.where(tau * state.model.share < LIMITS.least_noise, 1.0, tau)
    alone = np.mean(1 / (terms.precision * _variance(state, terms)), axis=0)
    lost = (alone > LIMITS.unpredicted) & (alone > LIMITS.unpredicted_to_median * np.median(alone))
    filtered, spreads = _filtered(problem, state, found), gain_spreads(state)
    for n in range(len(tau)):
        if n in filtered and tau[n] < LIMITS.noise and not lost[n]:
            odd[n] = filtered[n]
        elif abs(state.gains[n, 1]) > LIMITS.inverted and tau[n] < LIMITS.noise:
            odd[n] = OddChannel(n, "inverted", np.nan, "")
        elif tau[n] > LIMITS.noise or lost[n]:
            odd[n] = _faulty(problem, state, terms, predicted, n, bool(lost[n]))
        elif _far(state.gains[n, 0], spreads[0]):
            odd[n] = OddChannel(n, "gain", float(DECIBELS_PER_NEPER * state.gains[n, 0]), "dB")
        elif _far(state.gains[n, 1], spreads[1]):
            odd[n] = OddChannel(n, "gain", float(np.degrees(state.gains[n, 1])), "degrees")
    odd.update(_misplaced(problem, state, found))
    return tuple(odd[n] for n in sorted(odd))


def _variance(state: State, terms) -> np.ndarray:
    """Return the variance of every channel's corrected pressures : (M, N) float64."""
    return state.model.power[state.modes, None] + state.model.noise[state.modes, None] * state.model.channel_noise


def _filtered(problem: Problem, state: State, found: Uncertainty) -> dict[int, OddChannel]:
    """Return the channels that the solver found a delay or a high-pass for, where it is beyond its uncertainty."""
    c = problem.sound_speed * np.exp(state.model.log_speed)
    units = np.array([1 / c, c / (2 * np.pi)])
    least = np.maximum(LIMITS.filter_sigmas * found.filters * units, [LIMITS.least_delay, LIMITS.least_corner])
    value = state.model.filters * units
    odd = {int(n): OddChannel(int(n), "high_pass", float(value[n, 1]), "Hz") for n in _beyond(value, least, 1)}
    return odd | {int(n): OddChannel(int(n), "delayed", float(value[n, 0]), "s") for n in _beyond(value, least, 0)}


def _beyond(value, least, column: int) -> np.ndarray:
    return np.flatnonzero(np.abs(value[:, column]) > least[:, column])


def gain_spreads(state: State) -> np.ndarray:
    """Return the spreads of log gains, nepers, and of phases, radians, of all channels : (2,) float64.

    The solver's own are those of the channels whose gain it does not take for grossly wrong. Where the channels differ
    by several decibels these are too few, and the median deviation of all channels is larger.
    """
    scatter = np.median(np.abs(state.gains - np.median(state.gains, axis=0)), axis=0) / LIMITS.median_of_normal
    return np.maximum([state.model.gain_sigma, state.model.phase_sigma], scatter)


def _far(value: float, sigma: float) -> bool:
    return abs(value) > max(LIMITS.gain_sigmas * sigma, LIMITS.least_gain)


def _faulty(problem: Problem, state: State, terms, predicted, n: int, lost: bool) -> OddChannel:
    """Return what is wrong with a channel that its place and gain do not explain: delayed, dead or noisy."""
    q, e = terms.corrected[:, n], predicted[:, n]
    f = problem.frequencies[state.modes]
    steps = round(LIMITS.longest_delay / LIMITS.delay_step)
    delays = LIMITS.delay_step * np.arange(-steps, steps + 1)
    turned = np.abs((np.conj(e) * q) @ np.exp(2j * np.pi * np.outer(f, delays)))
    norm = np.sqrt(np.sum(np.abs(e) ** 2) * np.sum(np.abs(q) ** 2))
    best, undelayed = int(np.argmax(turned)), turned[steps]
    if not lost and turned[best] > np.sqrt(LIMITS.coherent) * norm and turned[best] > LIMITS.delay_gain * undelayed:
        return OddChannel(n, "delayed", float(delays[best]), "s")
    tau = state.model.channel_noise
    noise = float(10 * np.log10(tau[n] / np.median(tau)))
    if lost or undelayed < np.sqrt(1 - LIMITS.unpredicted) * norm:
        return OddChannel(n, "dead", noise, "dB")
    return OddChannel(n, "noisy", noise, "dB")


def _misplaced(problem: Problem, state: State, found: Uncertainty) -> dict[int, OddChannel]:
    """Return the given positions that the pressures contradict, and exchanges."""
    x = state.positions
    sigma = np.sqrt(np.trace(found.covariance, axis1=1, axis2=2))
    odd = {}
    for n, given in zip(problem.known.tolist(), problem.known_positions, strict=True):
        away = float(np.linalg.norm(x[n] - given))
        if away < max(LIMITS.misplaced_sigmas * sigma[n], LIMITS.misplaced):
            continue
        apart = np.linalg.norm(x - given, axis=1)
        apart[n] = np.inf
        other = int(np.argmin(apart))
        within = max(LIMITS.exchanged_sigmas * sigma[other], LIMITS.exchanged)
        if apart[other] >= min(within, LIMITS.exchanged_share * away):
            odd[n] = OddChannel(n, "misplaced", away, "m")
            continue
        odd[n] = OddChannel(n, "exchanged", away, "m", other)
        odd.setdefault(other, OddChannel(other, "exchanged", away, "m", n))
    return odd


def exchange_back(problem: Problem, state: State, odd: tuple[OddChannel, ...]) -> np.ndarray:
    """Return the positions with a free channel that was exchanged with a given one put in its own place.

    Returns
    -------
    (N, D) float64, metres
    """
    x = np.array(state.positions)
    known = set(problem.known.tolist())
    for one in odd:
        if one.kind == "exchanged" and one.number in known and one.partner not in known:
            x[[one.number, one.partner]] = x[[one.partner, one.number]]
    return x


def healthy_channels(count: int, odd: Sequence[OddChannel]) -> np.ndarray:
    """Return which of `count` channels are not odd : (N,) bool."""
    healthy = np.ones(count, bool)
    healthy[[one.number for one in odd]] = False
    return healthy


def channel_faults(odd: Sequence[OddChannel], names: Sequence[str]) -> tuple[ChannelFault, ...]:
    """Return odd channels as a result holds them, with the names of the microphones."""
    return tuple(
        ChannelFault(
            names[one.number],
            one.kind,
            one.value if np.isfinite(one.value) else None,
            one.unit if np.isfinite(one.value) else "",
            names[one.partner] if one.partner >= 0 else None,
        )
        for one in odd
    )
