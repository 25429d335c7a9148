"""The numbers that decide how given positions are weighed against the pressures."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class GivenRules:
    """How given positions are weighed against the pressures.

    Attributes
    ----------
    sigma, sigma_spread, most_sigma : metres, nepers, metres: log-normal prior of one sigma of a given coordinate, and
        its greatest value
    wrong : probability that a given position is wrong, that two are exchanged, or that the sound speed is wrong
    decades : greatest distance of a wrong position over the least one
    sizes : range of relative errors of the sound speed
    inaccurate : that sigma over the expected one from which all given positions are inaccurate
    agree : probability of the disagreement found from which the given positions are taken as they are
    close : metres, an error of a given position that no tape shows
    examined : given positions of which every subset and pair is examined; of more, those that fit least
    most_wrong : given positions at most that may be wrong where there are more
    tried : subsets at most on which an array is laid
    weaker_field : factor on the power of the field for the covariance, as of the verdict: rooms are less isotropic
        than their model
    steps, stride, negligible, damping : of the search for the array without given positions: steps at most, metres
        moved in one at most, nats after which it ends, first damping
    """

    sigma: float = 3e-3
    sigma_spread: float = 0.6
    most_sigma: float = 0.04
    wrong: float = 0.05
    decades: float = 1e3
    sizes: float = 0.1
    inaccurate: float = 2.0
    agree: float = 0.2
    close: float = 1e-3
    examined: int = 7
    most_wrong: int = 12
    tried: int = 40
    weaker_field: float = 4.0
    steps: int = 8
    stride: float = 0.1
    negligible: float = 0.05
    damping: float = 1e-6


GIVEN = GivenRules()
