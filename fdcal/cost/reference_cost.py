"""One number for any positions, whatever solver found them: Eq. 7 over all modes, relative to their power, in decibels.

Solvers minimise costs of their own, which cannot be compared: a likelihood of other modes or another noise, Eq. 7 of
the modes in use with a weight of the known microphones. Here the modes are all that the microphones can carry, the
order of each is fixed, and every microphone has the weight 1. It is a residual: 0 dB where the positions explain
nothing, and it falls as the positions improve, down to the noise or the truncation of the expansion. Rotations,
translations and mirror images do not change it.

The pressures are those recorded, unless the solver estimates the channels: then they are divided by its gains, and
each channel has the weight 1 / noise. Otherwise one inverted or dead channel outweighs all positions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..model.problem import Problem
from ..model.validation import InputError
from .channel_correction import ChannelCorrection, SolverState, equalised
from .expansion import expansion_of

ORDER_OFFSET = 2  # added to ceil(k R): with the paper's 0 the truncation hides a centimetre
MIN_MODES = 3  # with fewer carried modes the order is lowered
LOWEST = 1e-16  # relative cost at which the decibels end


def decibels(relative_cost: float) -> float:
    """Return a relative cost in decibels, -160 at least; NaN for NaN."""
    return float(10 * np.log10(np.maximum(relative_cost, LOWEST)))


def reference_cost_of(problem: Problem) -> ReferenceCost | None:
    """Return the reference cost of a problem; None without a search domain or with too few microphones for any mode."""
    try:
        return ReferenceCost(problem)
    except InputError:
        return None


class ReferenceCost:
    """Eq. 7 over all modes that the microphones can carry, relative to the power of their pressures.

    `order_offset` is added to ceil(k R) in the order of every mode; it is lowered for an array that carries fewer than
    MIN_MODES modes with it. `count` is the number of modes. Raises InputError without a search domain, or with too
    few microphones for any mode.

    Examples
    --------
    >>> import fdcal
    >>> measurement = fdcal.load("tiny")
    >>> round(ReferenceCost(measurement.problem())(measurement.positions))
    -59
    """

    def __init__(self, problem: Problem, order_offset: int = ORDER_OFFSET):
        for offset in range(order_offset, -1, -1):
            self._expansion = expansion_of(problem, offset)
            if len(self._expansion.carried.modes) >= min(MIN_MODES, len(problem.pressures)):
                break
        carried = self._expansion.carried
        self.order_offset, self.count = carried.order_offset, len(carried.modes)
        if not self.count:
            fault = f"{problem.pressures.shape[1]} microphones are too few for the cost of any mode"
            raise InputError(fault, "use a smaller <radius>, or more microphones", key="radius")
        self._groups = self._expansion.groups(np.arange(self.count))
        self._pressures = problem.pressures[carried.modes]

    def __call__(self, positions: ArrayLike, channels: ChannelCorrection | None = None) -> float:
        """Return the cost of positions (N, D), metres, in dB, with `RunState.channels`; NaN where one is not finite."""
        positions = np.asarray(positions, float)
        if not np.isfinite(positions).all():
            return float("nan")
        pressures, scale = equalised(self._pressures, channels)
        left, centre = 0.0, positions.mean(axis=0)
        for group in self._groups:  # |W W^+ p - p|^2 over modes of one order is the last diagonal of R in [W p] = Q R
            W = scale[:, None] * self._expansion.rows(positions, centre, group)
            R = np.asarray(np.linalg.qr(np.concatenate([W, pressures[group][:, :, None]], axis=2), mode="r"))
            left += float(np.sum(np.abs(R[:, -1, -1]) ** 2))
        return decibels(left / float(np.sum(np.abs(pressures) ** 2)))

    def of(self, state: SolverState) -> float:
        """Return the cost of a state of any solver (`RunState`), its channels included, dB."""
        return self(state.positions, state.channels)
