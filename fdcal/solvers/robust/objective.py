"""What a stage minimises: the likelihood of the modes in use, and the priors of gains and given positions.

Gains and given positions have Student t priors of NU degrees of freedom,

    -log p = (NU + d) / 2 log(1 + e^2 / (NU sigma^2)),

e the deviation, d its number of components. One wrong entry is outvoted, and a small sigma costs a matched array
nothing. In the Gauss-Newton matrix such a prior is a spring of stiffness w = (NU + d) / (NU sigma^2 + e^2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...cost.channel_likelihood import ChannelField, Terms, channel_terms

NU = 3.0  # degrees of freedom of the priors


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
    """

    gain_sigma: float
    phase_sigma: float
    known: np.ndarray
    places: np.ndarray
    known_sigma: float
    offsets: np.ndarray


@dataclass(frozen=True)
class Objective:
    """Pressures (M, N) of the modes in use, what is assumed of their field, and the priors."""

    pressures: np.ndarray
    field: ChannelField
    priors: Priors

    def evaluate(self, positions, gains, derivatives: int = 2):
        """Cost with priors, and `Terms` whose gradient and curvature hold the priors, too."""
        terms = channel_terms(positions, gains, self.pressures, self.field, derivatives)
        cost = terms.cost + add_priors(positions, gains, self.priors, terms)
        return cost, terms


def add_priors(positions, gains, priors: Priors, terms: Terms) -> float:
    """Cost of the priors; gradient and curvature of `terms`, if it has them, are added to in place."""
    D = positions.shape[1]
    cost = 0.0
    for column, sigma in enumerate((priors.gain_sigma, priors.phase_sigma)):
        if sigma > 0:
            e = gains[:, column] - priors.offsets[:, column]
            cost += (NU + 1) / 2 * np.sum(np.log1p(e**2 / (NU * sigma**2)))
            _add(terms, np.arange(len(e)), D + column, spring(e**2, sigma, 1) * e, spring(e**2, sigma, 1))
    if len(priors.known):
        e = positions[priors.known] - priors.places
        square = np.sum(e**2, axis=1)
        cost += (NU + D) / 2 * np.sum(np.log1p(square / (NU * priors.known_sigma**2)))
        w = spring(square, priors.known_sigma, D)
        for a in range(D):
            _add(terms, priors.known, a, w * e[:, a], w)
    return float(cost)


def spring(square, sigma: float, components: int):
    """Stiffness of the Student t prior at the squared deviation `square`."""
    return (NU + components) / (NU * sigma**2 + square)


def _add(terms: Terms, rows, column: int, gradient, stiffness) -> None:
    if terms.gradient is not None and terms.curvature is not None:
        terms.gradient[rows, column] += gradient
        terms.curvature[rows, column, rows, column] += stiffness
