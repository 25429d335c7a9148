"""What a stage minimises: the likelihood of the modes in use, and the priors of gains, given positions and sound speed.

The unknowns in one vector: the P parameters of every microphone (its coordinates, log gain, phase and, where a channel
has a filter, delay and corner), then the logarithm of the sound speed over the one that the wavenumbers suppose. The
likelihood depends on wavenumber times length only, so that a faster sound is a smaller array:

    d cost / d log c = -sum_n (x_n - x_0) . d cost / d x_n - d_n d cost / d d_n + kappa_n d cost / d kappa_n

Gains and given positions have Student t priors of NU degrees of freedom,

    -log p = (NU + d) / 2 log(1 + e^2 / (NU sigma^2)),

e the deviation, d its number of components. One wrong entry is outvoted, and a small sigma costs a matched array
nothing. In the Gauss-Newton matrix such a prior is a spring of stiffness w = (NU + d) / (NU sigma^2 + e^2).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...cost.channel_likelihood import ChannelField, Terms, channel_terms
from .settings import FILTERS

NU = 3.0  # degrees of freedom of the priors


@dataclass(frozen=True)
class Unknowns:
    """What a step moves.

    Attributes
    ----------
    positions : (N, D) float64, metres
    channels : (N, 2) or (N, 4) float64, log gain, nepers, phase, radians, delay, metres, corner, rad/m
    log_speed : float, logarithm of the sound speed over that of the measurement
    """

    positions: np.ndarray
    channels: np.ndarray
    log_speed: float = 0.0

    @property
    def vector(self) -> np.ndarray:
        """All of them in one vector (N P + 1,)."""
        return np.append(np.column_stack([self.positions, self.channels]).ravel(), self.log_speed)

    def at(self, vector: np.ndarray) -> Unknowns:
        """Return the unknowns in a vector as that of these."""
        D = self.positions.shape[1]
        each = vector[:-1].reshape(len(self.positions), -1)
        return Unknowns(each[:, :D], each[:, D:], float(vector[-1]))

    def by_speed(self) -> np.ndarray:
        """Return the direction (N P,) of the microphones' parameters that a faster sound is equal to."""
        D = self.positions.shape[1]
        direction = np.zeros((len(self.positions), D + self.channels.shape[1]))
        direction[:, :D] = self.positions.mean(axis=0) - self.positions
        if self.channels.shape[1] > 2:
            direction[:, D + 2], direction[:, D + 3] = -self.channels[:, 2], self.channels[:, 3]
        return direction.ravel()


@dataclass(frozen=True)
class Priors:
    """Spread of what is not the same for every microphone.

    Attributes
    ----------
    gain_sigma : float, nepers, and phase_sigma : float, radians; 0 for gains that are fixed
    known : (A,) int64, microphones whose position is given, at `places` (A, D), metres
    known_sigma : float, metres, of every coordinate
    offsets : (N, 2) float64, nepers and radians, about which the gains lie: 0, or of a channel whose gain is
        grossly different (inverted polarity)
    speed_sigma : float, of the logarithm of the sound speed; 0 for one that is fixed
    known_tail : float, degrees of freedom of the prior of the given positions; of many a wrong one is not outvoted
    """

    gain_sigma: float
    phase_sigma: float
    known: np.ndarray
    places: np.ndarray
    known_sigma: float
    offsets: np.ndarray
    speed_sigma: float = 0.0
    known_tail: float = NU

    def of_known(self, positions) -> tuple[float, np.ndarray, np.ndarray]:
        """Return the cost of the given positions, their deviations (A, D), metres, and their stiffness (A,), 1/m^2."""
        e, nu = positions[self.known] - self.places, self.known_tail
        square, D = np.sum(e**2, axis=1), e.shape[1]
        cost = (nu + D) / 2 * float(np.sum(np.log1p(square / (nu * self.known_sigma**2))))
        return cost, e, spring(square, self.known_sigma, D, nu)


@dataclass(frozen=True)
class Evaluation:
    """The cost with priors, its gradient (F,) and Gauss-Newton matrix (F, F), and the `Terms` of the likelihood alone.

    Gradient and matrix are empty where the cost alone was wanted.
    """

    cost: float
    gradient: np.ndarray
    matrix: np.ndarray
    terms: Terms


@dataclass(frozen=True)
class Objective:
    """Pressures (M, N) of the modes in use, what is assumed of their field at `log_speed`, and the priors."""

    pressures: np.ndarray
    field: ChannelField
    priors: Priors
    log_speed: float = 0.0

    def evaluate(self, unknowns: Unknowns, derivatives: int = 2) -> Evaluation:
        """Return the cost with priors and what `derivatives`, as of `channel_terms`, ask for."""
        field = self.field
        if unknowns.log_speed != self.log_speed:
            field = replace(field, wavenumbers=field.wavenumbers * np.exp(self.log_speed - unknowns.log_speed))
        terms = channel_terms(unknowns.positions, unknowns.channels, self.pressures, field, derivatives)
        return self.with_priors(unknowns, terms, derivatives)

    def with_priors(self, unknowns: Unknowns, terms: Terms, derivatives: int = 2) -> Evaluation:
        """Return `evaluate` for the `terms` of the likelihood at the unknowns."""
        gradient, matrix = _with_speed(unknowns, terms) if derivatives else (np.zeros(0), np.zeros((0, 0)))
        cost = terms.cost + _add_priors(unknowns, self.priors, gradient, matrix)
        return Evaluation(cost, gradient, matrix, terms)


def _with_speed(unknowns: Unknowns, terms: Terms) -> tuple[np.ndarray, np.ndarray]:
    """Return gradient (F,) and matrix (F, F) of the likelihood by all unknowns."""
    gradient, curvature = terms.newton()
    direction = unknowns.by_speed()
    H = curvature.reshape(direction.size, direction.size)
    across = H @ direction
    matrix = np.block([[H, across[:, None]], [across[None], np.array([[direction @ across]])]])
    return np.append(gradient.ravel(), direction @ gradient.ravel()), matrix


def _add_priors(unknowns: Unknowns, priors: Priors, gradient, matrix) -> float:
    """Cost of the priors; gradient and matrix, where they are not empty, are added to in place."""
    D, known = unknowns.positions.shape[1], priors.known
    P = D + unknowns.channels.shape[1]
    every = np.arange(len(unknowns.positions))
    cost = 0.0

    def add(index, slope, stiffness) -> None:
        if len(gradient):
            gradient[index] += slope
            matrix[index, index] += stiffness

    for column, sigma in enumerate((priors.gain_sigma, priors.phase_sigma)):
        if sigma > 0:
            e = unknowns.channels[:, column] - priors.offsets[:, column]
            cost += (NU + 1) / 2 * np.sum(np.log1p(e**2 / (NU * sigma**2)))
            add(P * every + D + column, spring(e**2, sigma, 1) * e, spring(e**2, sigma, 1))
    for column, sigma in enumerate((FILTERS.delay_sigma, FILTERS.corner_sigma)[: unknowns.channels.shape[1] - 2], 2):
        e = unknowns.channels[:, column] / sigma
        cost += np.sum(e**2) / 2
        add(P * every + D + column, e / sigma, 1 / sigma**2)
    if len(known):
        of_known, e, w = priors.of_known(unknowns.positions)
        cost += of_known
        for a in range(D):
            add(P * known + a, w * e[:, a], w)
    if priors.speed_sigma > 0:
        e = unknowns.log_speed / priors.speed_sigma
        cost += e**2 / 2
        add(-1, e / priors.speed_sigma, 1 / priors.speed_sigma**2)
    return float(cost)


def spring(square, sigma: float, components: int, freedom: float = NU):
    """Stiffness of the Student t prior at the squared deviation `square`."""
    return (freedom + components) / (freedom * sigma**2 + square)
