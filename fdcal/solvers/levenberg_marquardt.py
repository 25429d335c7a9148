"""One damped Gauss-Newton step (Levenberg-Marquardt), for any cost with a gradient and a Gauss-Newton matrix.

The caller provides functions that apply a step y of the parameters to the unknowns, and that measure how far positions
move. The same code can therefore move positions in a subspace (`fdcal.solvers.starts`), positions together with the
gains of the channels (`fdcal.solvers.robust.objective`), and the parameters of `fdcal.cost.short_windows`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ..acoustics.compiled import check_deadline

Unknowns = TypeVar("Unknowns")
FIRST_DAMPING = 1e-3  # damping, dimensionless, of the first step, and of the step after one that has failed


@dataclass(frozen=True)
class NewtonTerms:
    """Cost, its gradient (P,) and its Gauss-Newton matrix (P, P) with respect to the P parameters."""

    cost: float
    gradient: np.ndarray
    curvature: np.ndarray


@dataclass(frozen=True)
class DampedStep(Generic[Unknowns]):
    """Result of a damped step."""

    unknowns: Unknowns  # unchanged if no step lowers the cost
    cost: float
    decrease: float  # decrease of the cost
    damping: float  # damping of the next step
    moved: float  # metres, largest change of a coordinate; 0 without a step


MIN_DAMPING = 1e-9  # smallest damping of the next step
MAX_DAMPING = 1e6  # no step is tried with a damping above this
INCREASE = 6.0  # factor on the damping after a trial that does not lower the cost
DECREASE = 10.0  # divisor of the damping after a step
# A parabola is fitted to the cost along a step. If its minimum lies before this fraction of the step, the step is
# shortened to it. The Gauss-Newton matrix can have half the curvature of the cost; whole steps would then alternate
# about the minimum.
OVERSHOT = 0.9
# Rounding errors hide a relative decrease of the cost below this. No further trial follows one that fails and predicts
# a smaller decrease.
MIN_DECREASE = 1e-12


def damped_step(
    unknowns: Unknowns,
    terms: NewtonTerms,
    cost: Callable[[Unknowns], float],
    advance: Callable[[np.ndarray], Unknowns],
    length: Callable[[Unknowns], float],
    damping: float,
    max_step: float,
) -> DampedStep[Unknowns]:
    """Return the first of a series of steps with increasing damping that lowers the cost; no step if none does.

    cost : returns the cost at some unknowns; advance : returns the unknowns after a step (P,) of the parameters;
    length : returns how far positions have moved in these unknowns, metres; damping : damping of the first trial,
    dimensionless; max_step : largest step, metres. A longer one could leave the basin; the damping is then increased
    """
    g, H = terms.gradient, terms.curvature
    scale = np.maximum(np.diag(H), 1e-12 * np.diag(H).max())

    def finite(tried: Unknowns) -> float:
        try:
            return cost(tried)
        except np.linalg.LinAlgError:  # a covariance is singular, as with two microphones at one position without noise
            return np.inf

    while damping < MAX_DAMPING:
        check_deadline()
        damped = H + damping * np.diag(scale)
        try:
            y = cho_solve(cho_factor(damped, check_finite=False), -g, check_finite=False)
        except np.linalg.LinAlgError:  # with a free gauge and low damping, rounding errors can make H indefinite
            y = np.linalg.lstsq(damped, -g, rcond=None)[0]
        tried, slope = advance(y), float(g @ y)
        lower = finite(tried) if length(tried) <= max_step else np.inf
        if lower < terms.cost:
            bend = lower - terms.cost - slope  # the parabola is cost + slope t + bend t^2 at the fraction t
            if 0 < -slope < 2 * OVERSHOT * bend:
                shorter = advance(-slope / (2 * bend) * y)
                if (between := finite(shorter)) < lower:
                    tried, lower = shorter, between
            return DampedStep(tried, lower, terms.cost - lower, max(damping / DECREASE, MIN_DAMPING), length(tried))
        if -slope < MIN_DECREASE * abs(terms.cost):
            break
        damping = max(damping, FIRST_DAMPING) * INCREASE
    return DampedStep(unknowns, terms.cost, 0.0, FIRST_DAMPING, 0.0)
