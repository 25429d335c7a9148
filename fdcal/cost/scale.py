"""The scale of a map of costs, and the one rule for the marks on it: page, pictures, files and replays follow it.

A map shows DECADES decades of cost below its highest value, or as many as it has. A local minimum counts where the
climb out of it to a lower one exceeds DEPTH of this scale: 1 dB of the full 40 dB. What is less than that above the
lowest cost fits as well. Colours reach from the 2nd to the 98th percentile of the costs, over LEAST_RANGE at least.
Costs below the end of the scale keep their order, but their distances vanish: a valley that reaches below it is one
minimum, and all such valleys fit equally. A map that is negative somewhere, such as a log-likelihood, has a linear
scale from its lowest to its highest value.

This module loads before the compiled code: the first picture of the page needs it.
"""

from dataclasses import dataclass

import numpy as np

from ..model.validation import Reals

DECADES = 4
LEAST_RANGE = 0.01  # dB, of the colours: at a random start a map of all modes spans about 0.1 dB
DEPTH = 1 / (10 * DECADES)  # of the scale
BELOW = 1e-6  # of a distance below the end of the scale that remains
FEW_MODES = 8  # on the lattice of a solver, the valleys of a sum of fewer modes are chains of false minima
OUTSIDE = -1  # of a place from which descent ends at the edge of the map, beyond which the cost is unknown


def on_scale(cost: Reals) -> np.ndarray:
    """Return where on the scale of a map its costs lie: 0 at the lower end to 1; float64 of the same shape.

    What is no finite number counts as the highest of the others, so that it neither spoils the scale nor is a minimum.
    """
    cost = np.asarray(cost, float)
    finite = np.isfinite(cost)
    cost = np.where(finite, cost, cost[finite].max(initial=-np.inf) if finite.any() else 0.0)
    low, high = float(cost.min()), float(cost.max())
    if low == high:
        return np.zeros(cost.shape)
    if low < 0:
        return (cost - low) / (high - low)
    decades = np.log10(np.maximum(cost, np.finfo(float).tiny) / high)
    span = min(DECADES, -float(decades.min()))
    return np.where(decades < -span, BELOW * (decades + span), 1 + decades / span)


@dataclass(frozen=True)
class Minima:
    """What is marked on a map."""

    lowest: np.ndarray  # (L, D) float64, metres: the lowest cost, then the local minima that fit as well
    others: np.ndarray  # (K, D) float64, metres: the other local minima, the lowest first
    count: int  # local minima; the edges of the map have none, since the cost beyond them is unknown
    end: float | None  # the end of the scale, a cost, where the lowest cost is below it; or None
