"""Faults of channels and of given positions that the pressures show.

inverted, gain     phase or gain differ much from those of the other channels
delayed            the phase relative to the prediction by the others falls with frequency
high_pass          the channel has a first-order high-pass whose corner frequency differs from that of the others
dead               the other channels predict nothing of the signal
noisy              the noise is far above that of the others
misplaced          a given position contradicts the pressures
swapped            two channels, or two given positions, are exchanged
"""

from collections.abc import Mapping, Sequence

import numpy as np

from ..solvers.interface import Estimate
from .calibration import DECIBELS_PER_NEPER, ChannelFault

INVERTED_PHASE = 2.5  # radians, absolute phase above which a channel counts as inverted
MAX_NOISE = 12.0  # ratio of a channel's noise to that of the median channel above which the channel is noisy
# fraction of the power below which noise is not a fault, because the misfit of the field model may cause it
MIN_NOISE = 1e-4
# Noise that a position error of three sigmas can cause is not a fault either, as long as it is below 1 % of the power.
POSITION_SIGMAS, MAX_BY_POSITION = 3.0, 0.01
UNPREDICTED = 0.5  # fraction of a channel's variance or power that the others do not predict, above which it is dead
# The prediction of a healthy channel becomes worse with its distance from the others. In a sparse array some channels
# can hardly be predicted, and others by about half. Channels without much noise therefore only count as dead if all
# others are predicted clearly better, which means that their unpredicted fraction is below UNPREDICTED divided by this
# factor. Without this rule healthy channels count as dead in 24 of 48 sparse arrays. With it none does, and all dead
# channels of the suite `benchmarks field` are found.
PREDICTED_BETTER = 3.0
MAX_UNPREDICTED = 0.5  # fraction of unpredicted channels above which only noisy ones can be dead: the array is sparse


def faulty_channels(estimate: Estimate, covariance: np.ndarray, names: Sequence[str]) -> dict[int, ChannelFault]:
    """Return the faults of channels and given positions, by the number of the microphone, ascending.

    `covariance` (N, D, D), metres^2, of each position; `names` of the N microphones.
    """
    faulty, channels, field = {}, estimate.channels, estimate.field
    tau, gains = np.array(channels.noise), channels.gains
    contradicted = estimate.given.contradicted
    if contradicted is not None and estimate.given.sigma == 0:  # the error of a wrong exact position appears as noise
        tau[estimate.problem.known] = contradicted.noise
    square = POSITION_SIGMAS**2 * np.mean(np.abs(estimate.problem.wavenumbers[estimate.modes]) ** 2)  # 1/m^2
    by_position = square * np.trace(covariance, axis1=1, axis2=2) / estimate.problem.dimension
    least = np.clip(by_position, MIN_NOISE, MAX_BY_POSITION)
    quiet = tau * field.noise_fraction < MAX_BY_POSITION  # then the phase of the channel is well determined
    tau = np.where(tau * field.noise_fraction < least, 1.0, tau)
    variance = field.power[:, None] + field.noise[:, None] * channels.noise
    # fraction of the variance of each channel that the other channels do not predict
    fraction = np.mean(1 / (field.terms.precision * variance), axis=0)
    unpredicted = fraction > UNPREDICTED
    rest = fraction[(fraction <= UNPREDICTED) & (tau < MAX_NOISE)]
    unpredicted &= bool(np.all(rest < UNPREDICTED / PREDICTED_BETTER)) and np.mean(unpredicted) <= MAX_UNPREDICTED
    unpredicted[estimate.problem.known] = False  # a known microphone may be too far from the others for a prediction
    # The solver leaves channels with gross faults out when it estimates the prior sigma. If all channels differ by
    # several decibels, it leaves out too many. The limit therefore uses the median deviation if that is larger.
    scatter = np.median(np.abs(gains - np.median(gains, axis=0)), axis=0) / MEDIAN_OF_NORMAL
    far = np.abs(gains) > np.maximum(GAIN_SIGMAS * np.maximum(channels.spread, scatter), MIN_GAIN)
    filtered = _filtered(estimate, names)
    for n, name in enumerate(names):
        if n in filtered and tau[n] < MAX_NOISE and not unpredicted[n]:
            faulty[n] = filtered[n]
        elif abs(gains[n, 1]) > INVERTED_PHASE and (tau[n] < MAX_NOISE or quiet[n]):
            faulty[n] = ChannelFault(name, "inverted")
        elif tau[n] > MAX_NOISE or unpredicted[n]:
            faulty[n] = _unexplained(estimate, n, name, bool(unpredicted[n]))
        elif far[n, 0]:
            faulty[n] = ChannelFault(name, "gain", float(DECIBELS_PER_NEPER * gains[n, 0]), "dB")
        elif far[n, 1]:
            faulty[n] = ChannelFault(name, "gain", float(np.degrees(gains[n, 1])), "degrees")
    if estimate.ended:  # otherwise given positions cannot be judged
        faulty.update(_misplaced(estimate, covariance, names))
    return {n: faulty[n] for n in sorted(faulty)}


GAIN_SIGMAS = 4.0  # deviation of gain or phase that is a fault, in sigmas of all channels
MIN_GAIN = 0.12  # nepers of the gain, or radians of the phase, below which a deviation is never a fault
MEDIAN_OF_NORMAL = 0.6745  # median absolute deviation of a normal distribution, divided by its sigma
FILTER_SIGMAS = 4.0  # deviation of a delay or a corner frequency that is a fault, in its own sigmas
# seconds and hertz below which a deviation is never a fault
MIN_DELAY = 2e-5
MIN_CORNER = 3.0


def _filtered(estimate: Estimate, names: Sequence[str]) -> dict[int, ChannelFault]:
    """Return the channels with a significant delay or high-pass.

    In a field of few waves, `PositionSpread.excess` enlarges the part of a variance that is due to the data. Here the
    whole variance is enlarged, which gives an upper bound of sigma.
    """
    c = estimate.problem.sound_speed * np.exp(estimate.log_speed)
    units = np.array([1 / c, c / (2 * np.pi)])
    wider = np.sqrt(1 + estimate.spread.excess)
    value, sigma = estimate.channels.filters * units, wider * estimate.channels.filter_sigma * units
    value = value - np.median(value, axis=0)
    scatter = np.median(np.abs(value), axis=0) / MEDIAN_OF_NORMAL
    limits = np.maximum(GAIN_SIGMAS * scatter, [MIN_DELAY, MIN_CORNER])
    beyond = np.abs(value) > np.maximum(FILTER_SIGMAS * sigma, limits)
    found = {}
    for column, kind, unit in ((1, "high_pass", "Hz"), (0, "delayed", "s")):  # a channel with both counts as delayed
        for n in map(int, np.flatnonzero(beyond[:, column])):
            found[n] = ChannelFault(names[n], kind, float(value[n, column]), unit)
    return found


COHERENT = 0.5  # smallest fraction of the power of a delayed channel that the delayed prediction explains
DELAY_GAIN = 1.02  # smallest ratio of the coherence with a delay to that without one
# seconds, largest delay that is tried, and difference of two successive delays
MAX_DELAY = 2e-3
DELAY_STEP = 1e-5


def _unexplained(estimate: Estimate, n: int, name: str, unpredicted: bool) -> ChannelFault:
    """Return the fault of a channel that position and gain do not explain: delayed, dead or noisy."""
    terms = estimate.field.terms
    q, e = terms.corrected[:, n], terms.corrected[:, n] - terms.weighted[:, n] / terms.precision[:, n]
    steps, f = round(MAX_DELAY / DELAY_STEP), estimate.problem.frequencies[estimate.modes]
    delays = DELAY_STEP * np.arange(-steps, steps + 1)
    product = np.abs((np.conj(e) * q) @ np.exp(2j * np.pi * np.outer(f, delays)))
    norm = np.sqrt(np.sum(np.abs(e) ** 2) * np.sum(np.abs(q) ** 2))
    best, undelayed = int(np.argmax(product)), product[steps]
    if not unpredicted and product[best] > np.sqrt(COHERENT) * norm and product[best] > DELAY_GAIN * undelayed:
        return ChannelFault(name, "delayed", float(delays[best]), "s")
    dead = unpredicted or undelayed < np.sqrt(1 - UNPREDICTED) * norm
    level = 10 * np.log10(estimate.channels.noise[n] / np.median(estimate.channels.noise))
    return ChannelFault(name, "dead" if dead else "noisy", float(level), "dB")


# A given position is wrong if its microphone is found farther from it than both limits, in sigmas and in metres.
MISPLACED_SIGMAS = 3.0
MIN_MISPLACED = 0.006
# Two microphones are exchanged if the second one is found at the given position of the first one. Its distance from
# there must be below the larger of two limits, in sigmas and in metres, and below this fraction of the distance at
# which the first one is found.
EXCHANGED_SIGMAS = 3.0
MIN_EXCHANGED = 0.005
EXCHANGED_FRACTION = 0.3


def _misplaced(estimate: Estimate, covariance, names: Sequence[str]) -> dict[int, ChannelFault]:
    """Return the wrong and the exchanged given positions."""
    problem, faulty, x = estimate.problem, {}, shown_positions(estimate)
    sigma = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
    found = estimate.given.contradicted
    usual = np.sqrt(x.shape[1]) * estimate.given.sigma  # metres; an error of this size is usual and not a fault
    for i, (n, given) in enumerate(zip(map(int, problem.known), problem.known_positions, strict=True)):
        away = float(np.linalg.norm(x[n] - given))
        near = away < max(MISPLACED_SIGMAS * np.hypot(sigma[n], usual), MIN_MISPLACED)
        right = near if x is estimate.positions or found is None else not found.wrong[i]
        if right:
            continue
        apart = np.linalg.norm(x - given, axis=1)
        apart[n] = np.inf
        other = int(np.argmin(apart))
        if apart[other] >= min(max(EXCHANGED_SIGMAS * sigma[other], MIN_EXCHANGED), EXCHANGED_FRACTION * away):
            faulty[n] = ChannelFault(names[n], "misplaced", away, "m")
            continue
        faulty[n] = ChannelFault(names[n], "swapped", away, "m", names[other])
        faulty.setdefault(other, ChannelFault(names[other], "swapped", away, "m", names[n]))
    return faulty


def shown_positions(estimate: Estimate) -> np.ndarray:
    """Return the positions (N, D), metres, that the pressures show.

    They differ from the estimate where exact given positions are wrong, because these never move in the estimate.
    """
    found = estimate.given.contradicted
    return estimate.positions if found is None or estimate.given.sigma > 0 else found.positions


def exchanged_back(estimate: Estimate, faulty: Mapping[int, ChannelFault], names: Sequence[str]) -> np.ndarray:
    """Return the positions (N, D), metres, after exchanges of a free channel and a known one were undone."""
    x, shown = np.array(estimate.positions), shown_positions(estimate)
    known = set(estimate.problem.known.tolist())
    for n, fault in faulty.items():
        if fault.partner is None or n not in known:
            continue
        partner = names.index(fault.partner)
        if partner not in known:
            x[partner] = shown[n]
            if estimate.given.sigma > 0:
                x[n] = shown[partner]
    return x
