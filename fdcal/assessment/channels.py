"""Channels and given positions that are not what they should be, and what is wrong with each.

inverted, gain     the gain or phase is far from that of the others
delayed            the phase against what the others predict falls with the frequency
high_pass          bass is cut, or less cut than that of the others, as by a first-order high-pass
dead               the others predict nothing of it, or it holds no more than they expect of noise
noisy              its noise is far above that of the others
misplaced          a given position that the pressures contradict
exchanged          two channels, or two given positions, each in the other's place
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..solvers.interface import Estimate
from .calibration import DECIBELS_PER_NEPER, ChannelFault


@dataclass(frozen=True)
class FaultyChannel:
    """A channel or a given position that stands out."""

    number: int  # of the microphone, from 0
    kind: str  # as above
    # gain in decibels, phase in degrees, delay in seconds, distance from the given position in metres, or noise in
    # decibels over the median channel, or corner frequency in hertz over that of the others; nan for an inverted
    # channel
    value: float
    unit: str  # of the value; "" without one
    partner: int = -1  # the other microphone of an exchange, or -1


INVERTED_PHASE = 2.5  # radians, phase
MAX_NOISE = 12.0  # noise of a channel over that of the median channel
# fraction of the power below which noise is no fault: the misfit of the field model may be a channel's
MIN_NOISE = 1e-4
UNPREDICTED = 0.5  # fraction of a channel's variance, or of its power, that the others do not predict
UNPREDICTED_TO_MEDIAN = 3.0  # the same over that of the median channel


def faulty_channels(estimate: Estimate, covariance: np.ndarray) -> tuple[FaultyChannel, ...]:
    """Return all channels and given positions that stand out; `covariance` (N, D, D), metres^2, of each position."""
    faulty, channels = {}, estimate.channels
    tau, gains, terms = np.array(channels.noise), channels.gains, estimate.field.terms
    contradicted = estimate.given.contradicted
    if contradicted is not None and estimate.given.sigma == 0:  # there the error of a position has become noise
        tau[estimate.problem.known] = contradicted.noise
    tau = np.where(tau * estimate.field.noise_fraction < MIN_NOISE, 1.0, tau)
    variance = estimate.field.power[:, None] + estimate.field.noise[:, None] * channels.noise
    alone = np.mean(1 / (terms.precision * variance), axis=0)
    lost = (alone > UNPREDICTED) & (alone > UNPREDICTED_TO_MEDIAN * np.median(alone))
    lost[estimate.problem.known] = False  # their positions hold them, however far the others are
    filtered, spreads = _filtered(estimate), gain_spreads(estimate)
    for n in range(len(tau)):
        if n in filtered and tau[n] < MAX_NOISE and not lost[n]:
            faulty[n] = filtered[n]
        elif abs(gains[n, 1]) > INVERTED_PHASE and tau[n] < MAX_NOISE:
            faulty[n] = FaultyChannel(n, "inverted", np.nan, "")
        elif tau[n] > MAX_NOISE or lost[n]:
            faulty[n] = _unexplained(estimate, n, bool(lost[n]))
        elif _far(gains[n, 0], spreads[0]):
            faulty[n] = FaultyChannel(n, "gain", float(DECIBELS_PER_NEPER * gains[n, 0]), "dB")
        elif _far(gains[n, 1], spreads[1]):
            faulty[n] = FaultyChannel(n, "gain", float(np.degrees(gains[n, 1])), "degrees")
    if estimate.converged:  # an array that was not found contradicts no given position
        faulty.update(_misplaced(estimate, covariance))
    return tuple(faulty[n] for n in sorted(faulty))


GAIN_SIGMAS = 4.0  # spreads of the gains, or phases, of all channels
MEDIAN_OF_NORMAL = 0.6745  # median absolute deviation of a normal distribution over its sigma
FILTER_SIGMAS = 4.0  # sigmas of a delay, or of a corner frequency
# seconds and hertz that are never a fault
MIN_DELAY = 2e-5
MIN_CORNER = 3.0


def _filtered(estimate: Estimate) -> dict[int, FaultyChannel]:
    """Return the channels that the solver found a delay or a high-pass for, where it is beyond its uncertainty.

    Where few waves make a field less random than assumed, the part of sigma that the data decide grows; here all of
    it does, which is an upper bound.
    """
    c = estimate.problem.sound_speed * np.exp(estimate.log_speed)
    units = np.array([1 / c, c / (2 * np.pi)])
    wider = np.sqrt(1 + estimate.spread.excess)
    value, sigma = estimate.channels.filters * units, wider * estimate.channels.filter_sigma * units
    value = value - np.median(value, axis=0)
    scatter = np.median(np.abs(value), axis=0) / MEDIAN_OF_NORMAL
    limits = np.maximum(GAIN_SIGMAS * scatter, [MIN_DELAY, MIN_CORNER])
    beyond = np.abs(value) > np.maximum(FILTER_SIGMAS * sigma, limits)
    found = {int(n): FaultyChannel(int(n), "high_pass", float(value[n, 1]), "Hz") for n in np.flatnonzero(beyond[:, 1])}
    delayed = {int(n): FaultyChannel(int(n), "delayed", float(value[n, 0]), "s") for n in np.flatnonzero(beyond[:, 0])}
    return found | delayed


def gain_spreads(estimate: Estimate) -> np.ndarray:
    """Return the spreads of log gains, nepers, and of phases, radians, of all channels : (2,) float64.

    The solver's own are those of the channels whose gain it does not take for grossly wrong. Where the channels differ
    by several decibels these are too few, and the median deviation of all channels is larger.
    """
    gains = estimate.channels.gains
    scatter = np.median(np.abs(gains - np.median(gains, axis=0)), axis=0) / MEDIAN_OF_NORMAL
    return np.maximum(estimate.channels.spread, scatter)


MIN_GAIN = 0.12  # nepers of the gain, or radians of the phase, that are never a fault


def _far(value: float, sigma: float) -> bool:
    return abs(value) > max(GAIN_SIGMAS * sigma, MIN_GAIN)


COHERENT = 0.5  # fraction of the power that a delay must explain
DELAY_GAIN = 1.02  # coherence at the best delay over that without delay
# seconds, delays tried
MAX_DELAY = 2e-3
DELAY_STEP = 1e-5


def _unexplained(estimate: Estimate, n: int, lost: bool) -> FaultyChannel:
    """Return what is wrong with a channel that its place and gain do not explain: delayed, dead or noisy."""
    terms = estimate.field.terms
    q, e = terms.corrected[:, n], terms.corrected[:, n] - terms.weighted[:, n] / terms.precision[:, n]
    steps = round(MAX_DELAY / DELAY_STEP)
    delays = DELAY_STEP * np.arange(-steps, steps + 1)
    f = estimate.problem.frequencies[estimate.modes]
    turned = np.abs((np.conj(e) * q) @ np.exp(2j * np.pi * np.outer(f, delays)))
    norm = np.sqrt(np.sum(np.abs(e) ** 2) * np.sum(np.abs(q) ** 2))
    best, undelayed = int(np.argmax(turned)), turned[steps]
    if not lost and turned[best] > np.sqrt(COHERENT) * norm and turned[best] > DELAY_GAIN * undelayed:
        return FaultyChannel(n, "delayed", float(delays[best]), "s")
    tau = estimate.channels.noise
    noise = float(10 * np.log10(tau[n] / np.median(tau)))
    if lost or undelayed < np.sqrt(1 - UNPREDICTED) * norm:
        return FaultyChannel(n, "dead", noise, "dB")
    return FaultyChannel(n, "noisy", noise, "dB")


# sigmas and metres, distance from a given position; the larger one counts
MISPLACED_SIGMAS = 3.0
MIN_MISPLACED = 0.006
# sigmas and metres within which a channel is in another's place, likewise
EXCHANGED_SIGMAS = 3.0
MIN_EXCHANGED = 0.005
EXCHANGED_FRACTION = 0.3  # the same over the distance from its own given position


def _misplaced(estimate: Estimate, covariance) -> dict[int, FaultyChannel]:
    """Return the given positions that the pressures contradict, and exchanges."""
    problem, faulty, x = estimate.problem, {}, shown_positions(estimate)
    sigma, found = np.sqrt(np.trace(covariance, axis1=1, axis2=2)), estimate.given.contradicted
    usual = np.sqrt(x.shape[1]) * estimate.given.sigma  # where all are inaccurate none of them is wrong
    for i, (n, given) in enumerate(zip(problem.known.tolist(), problem.known_positions, strict=True)):
        away = float(np.linalg.norm(x[n] - given))
        if x is estimate.positions or found is None:
            right = away < max(MISPLACED_SIGMAS * np.hypot(sigma[n], usual), MIN_MISPLACED)
        else:
            right = not found.wrong[i]
        if right:
            continue
        apart = np.linalg.norm(x - given, axis=1)
        apart[n] = np.inf
        other = int(np.argmin(apart))
        within = max(EXCHANGED_SIGMAS * sigma[other], MIN_EXCHANGED)
        if apart[other] >= min(within, EXCHANGED_FRACTION * away):
            faulty[n] = FaultyChannel(n, "misplaced", away, "m")
            continue
        faulty[n] = FaultyChannel(n, "exchanged", away, "m", other)
        faulty.setdefault(other, FaultyChannel(other, "exchanged", away, "m", n))
    return faulty


def shown_positions(estimate: Estimate) -> np.ndarray:
    """Return where the pressures show the microphones (N, D), metres, also those at exact positions that are wrong.

    Exact positions never move in the estimate, however far the pressures put the microphone.
    """
    found = estimate.given.contradicted
    return estimate.positions if found is None or estimate.given.sigma > 0 else found.positions


def exchanged_back(estimate: Estimate, faulty: Sequence[FaultyChannel]) -> np.ndarray:
    """Return the positions (N, D), metres, with a free channel that was exchanged with a given one in its own place."""
    x, shown = np.array(estimate.positions), shown_positions(estimate)
    known = set(estimate.problem.known.tolist())
    for one in faulty:
        if one.kind == "exchanged" and one.number in known and one.partner not in known:
            x[one.partner] = shown[one.number]
            if estimate.given.sigma > 0:
                x[one.number] = shown[one.partner]
    return x


def healthy_channels(count: int, faulty: Sequence[FaultyChannel]) -> np.ndarray:
    """Return which of `count` channels are healthy : (N,) bool."""
    healthy = np.ones(count, bool)
    healthy[[one.number for one in faulty]] = False
    return healthy


def channel_faults(faulty: Sequence[FaultyChannel], names: Sequence[str]) -> tuple[ChannelFault, ...]:
    """Return faulty channels as a result holds them, with the names of the microphones."""
    return tuple(
        ChannelFault(
            names[one.number],
            one.kind,
            one.value if np.isfinite(one.value) else None,
            one.unit if np.isfinite(one.value) else "",
            names[one.partner] if one.partner >= 0 else None,
        )
        for one in faulty
    )
