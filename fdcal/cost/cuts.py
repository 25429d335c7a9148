"""Eq. 7 of one microphone along a line, mode by mode: a cut through the maps of `fdcal.cost.eq7_maps`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..model.problem import Problem
from .channel_correction import ChannelCorrection, equalised
from .eq7_maps import expansion_of, fits_and_rows, require_carried


def eq7_cut(
    problem: Problem,
    positions,
    n: int,
    modes: Sequence[int],
    order_offset: int,
    points,
    channels: ChannelCorrection | None = None,
) -> np.ndarray:
    """Return the cost of each of `modes` with microphone `n` at each of `points`, the others at `positions`.

    Parameters
    ----------
    problem : Problem
    positions : (N, D) float64, metres
    n : int, microphone
    modes : (P,) int, counted from 1
    order_offset : added to ceil(k R) in the order of every mode
    points : (S, D) float64, metres, along the line
    channels : gains and noise that the solver estimates; None for the pressures as recorded

    Returns
    -------
    (P, S) float64, relative to the power of the pressures of all P modes, so that the sum is that of their map

    Raises
    ------
    InputError
        There is no search domain, or a mode has too many functions for the microphones at this order.

    Examples
    --------
    >>> import fdcal
    >>> measurement = fdcal.load("tiny")
    >>> eq7_cut(measurement.problem(), measurement.positions, 5, (1, 2, 3), 2, measurement.positions[5:8]).shape
    (3, 3)
    """
    require_carried(problem, modes, order_offset)
    x, points = np.asarray(positions, float), np.asarray(points, float)
    expansion = expansion_of(problem, order_offset)
    numbers = np.searchsorted(expansion.carried.modes, np.asarray(modes) - 1)
    pressures, scale = equalised(problem.pressures, channels)
    costs = np.empty((len(numbers), len(points)))
    for group in expansion.groups(numbers):
        fits, rows = fits_and_rows(pressures, scale, expansion, x, n, points, group)
        for number, fit, w in zip(group, fits, rows, strict=True):
            costs[numbers == number] = fit.cost_of(np.ascontiguousarray(w))
    return costs / float(np.sum(np.abs(pressures[np.asarray(modes) - 1]) ** 2))
