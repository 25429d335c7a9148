"""Channels and given positions that are not what they should be, and what is wrong with each.

inverted, gain     the gain is far from that of the others
delayed            the phase against what the others predict falls with the frequency
dead               the others predict nothing of it, or it holds no more than they expect of noise
noisy              its noise is far above that of the others
misplaced          a given position that the pressures contradict
exchanged          two channels, or two given positions, each in the other's place
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model.problem import Problem
from ..solvers.robust.state import State
from .channel_covariance import Uncertainty

INVERTED = 2.5  # radians
GAIN = 4.0, 0.12  # times the spread of the channels, and nepers or radians: further away is odd
NOISY = 12.0  # channel noise over that of the others
LEAST_NOISE = 1e-6  # of the power, that matters at all
DEAD = 0.5  # part of its variance, or of its power, that the others do not predict
COHERENT = 0.5  # of the power that a delay must explain
MISPLACED = 3.0, 0.006  # sigmas and metres
EXCHANGED = 4.0, 0.02  # sigmas and metres within which a channel is in another's place


@dataclass(frozen=True)
class OddChannel:
    """number : of the microphone;  kind : as above;  partner : of an exchange, or -1;  value : dB, s, m or tau."""

    number: int
    kind: str
    value: float
    partner: int = -1


def odd_channels(problem: Problem, state: State, found: Uncertainty) -> tuple[OddChannel, ...]:
    """All channels and given positions that stand out, in the order of the microphones."""
    odd = {}
    tau, terms = state.model.channel_noise, found.terms
    predicted = terms.corrected - terms.weighted / terms.precision
    N = len(tau)
    tau = np.where(tau * state.model.share < LEAST_NOISE, 1.0, tau)
    alone = np.mean(1 / (terms.precision * _variance(state, terms)), axis=0)
    lost = (alone > DEAD) & (alone > 3 * np.median(alone))
    for n in range(N):
        gain = state.gains[n]
        if abs(gain[1]) > INVERTED and tau[n] < NOISY:
            odd[n] = OddChannel(n, "inverted", 0.0)
        elif tau[n] > NOISY or lost[n]:
            odd[n] = _faulty(problem, state, terms, predicted, n, bool(lost[n]))
        elif _far(gain[0], state.model.gain_sigma) or _far(gain[1], state.model.phase_sigma):
            odd[n] = OddChannel(n, "gain", float(20 / np.log(10) * gain[0]))
    odd.update(_misplaced(problem, state, found))
    return tuple(odd[n] for n in sorted(odd))


def _variance(state: State, terms) -> np.ndarray:
    """Variance of every channel's corrected pressures (M, N)."""
    return state.model.power[state.modes, None] + state.model.noise[state.modes, None] * state.model.channel_noise


def _far(value: float, sigma: float) -> bool:
    return abs(value) > max(GAIN[0] * sigma, GAIN[1])


def _faulty(problem: Problem, state: State, terms, predicted, n: int, lost: bool) -> OddChannel:
    """A channel that its place and gain do not explain: delayed, dead or noisy."""
    q, e = terms.corrected[:, n], predicted[:, n]
    f = problem.frequencies[state.modes]
    delays = np.linspace(-2e-3, 2e-3, 401)
    turned = np.abs((np.conj(e) * q) @ np.exp(2j * np.pi * np.outer(f, delays)))
    norm = np.sqrt(np.sum(np.abs(e) ** 2) * np.sum(np.abs(q) ** 2))
    best = int(np.argmax(turned))
    if not lost and turned[best] > np.sqrt(COHERENT) * norm and turned[best] > 1.02 * turned[200]:
        return OddChannel(n, "delayed", float(delays[best]))
    if lost or turned[200] < np.sqrt(1 - DEAD) * norm:
        return OddChannel(n, "dead", float(state.model.channel_noise[n]))
    return OddChannel(n, "noisy", float(state.model.channel_noise[n]))


def _misplaced(problem: Problem, state: State, found: Uncertainty) -> dict:
    """Given positions that the pressures contradict, and exchanges."""
    known, places, x = problem.known, problem.known_positions, state.positions
    sigma = np.sqrt(np.trace(found.covariance, axis1=1, axis2=2))
    odd = {}
    for i, n in enumerate(known):
        away = np.linalg.norm(x[n] - places[i])
        if away < max(MISPLACED[0] * sigma[n], MISPLACED[1]):
            continue
        apart = np.linalg.norm(x - places[i], axis=1)
        apart[n] = np.inf
        other = int(np.argmin(apart))
        exchanged = apart[other] < max(EXCHANGED[0] * sigma[other], EXCHANGED[1]) and apart[other] < 0.3 * away
        odd[int(n)] = OddChannel(
            int(n), "exchanged" if exchanged else "misplaced", float(away), other if exchanged else -1
        )
        if exchanged and other not in odd:
            odd[other] = OddChannel(other, "exchanged", float(away), int(n))
    return odd


def exchange_back(problem: Problem, state: State, odd) -> np.ndarray:
    """Positions (N, D) with a free channel that was exchanged with a given one put in its own place."""
    x = np.array(state.positions)
    known = set(problem.known.tolist())
    for one in odd:
        if one.kind == "exchanged" and one.number in known and one.partner not in known:
            x[[one.number, one.partner]] = x[[one.partner, one.number]]
    return x
