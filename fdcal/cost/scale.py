"""The colour scale of a cost map, and the rule for the marks on it, common to page, pictures, files and replays.

A map shows DECADES decades of cost below its highest value, or fewer if the costs span fewer. A local minimum counts if
the climb from it to a lower minimum exceeds the fraction DEPTH of this scale, which is 1 dB of the full 40 dB. Minima
whose cost is within this fraction of the lowest cost count as fitting the data as well as the lowest one. Colours range
from the 2nd to the 98th percentile of the costs, and over LEAST_RANGE at least. Costs below the lower end of the scale
keep their order, but their differences are made very small. A valley that reaches below this end is therefore one
minimum, and all such valleys count as fitting equally well. A map with negative values, such as a log-likelihood, has a
linear scale from its lowest to its highest value.

The first picture of the page needs this module, which therefore loads no compiled code.
"""

from dataclasses import dataclass

import numpy as np

from ..model.validation import Reals

DECADES = 4  # largest number of decades of cost that a map shows
LEAST_RANGE = 0.01  # dB, smallest range of the colours; at a random start a map of all modes spans about 0.1 dB
DEPTH = 1 / (10 * DECADES)  # smallest prominence of a local minimum, as a fraction of the scale
BELOW = 1e-6  # factor by which differences of costs below the end of the scale are reduced
FEW_MODES = 8  # with at most this many modes, a solver's coarse lattice shows a valley as a chain of false minima
OUTSIDE = -1  # basin of points from which descent ends at the edge of the map, beyond which the cost is unknown


def on_scale(cost: Reals) -> np.ndarray:
    """Return the costs of a map on its scale, from 0 at the lower end to 1 at the upper : float64 of the same shape.

    Values that are not finite count as the highest finite one, so that they are never a minimum.
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
    """The marks on a map."""

    lowest: np.ndarray  # (L, D) float64, metres, position of the lowest cost, then local minima that fit as well
    others: np.ndarray  # (K, D) float64, metres, the other local minima, the lowest first
    count: int  # number of local minima; those at an edge do not count, because the cost beyond it is unknown
    end: float | None  # cost at the lower end of the scale if the lowest cost is below it, else None
