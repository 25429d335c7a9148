"""A search domain round an estimate, for a measurement that comes without one.

Solvers but `descent` and a random start need none; maps, the cost and the order rule do.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .measurement import Measurement
from .settings import Search

MARGIN = 0.25  # beyond the outermost estimates, of the longest side of the array
LEAST_MARGIN = 0.05  # m
CELLS = {2: 120, 3: 60}  # steps along the longest side, at most, by the number of coordinates
STEPS = (1.0, 2.0, 5.0)  # digits of a step, m


def search_round(positions) -> Search:
    """Return a search domain round positions.

    Parameters
    ----------
    positions : (N, D) float64
        Metres.

    Returns
    -------
    Search
        Its step is 1, 2 or 5 times a power of ten. R is the distance from its centre to its corner; in space, where
        the corners hold nothing, that to the outermost position, and the margin.

    Examples
    --------
    >>> search_round([[0.0, 0.0], [1.0, 0.0], [0.0, 0.6]]).size
    (1.5, 1.1)
    """
    positions = np.asarray(positions, float)
    low, high = positions.min(axis=0), positions.max(axis=0)
    margin = max(MARGIN * float((high - low).max()), LEAST_MARGIN)
    sides = high - low + 2 * margin
    step = _round_step(float(sides.max()) / CELLS[len(sides)])
    cells = np.ceil(sides / step - 1e-9).astype(int)
    centre, size = (low + high) / 2, cells * step
    outermost = float(np.linalg.norm(positions - centre, axis=1).max()) + margin
    radius = float(np.linalg.norm(size)) / 2 if len(size) == 2 else outermost
    return Search(tuple((centre - size / 2).tolist()), tuple(size.tolist()), step, radius)


def with_search_domain(measurement: Measurement, positions) -> Measurement:
    """Return a measurement with a search domain: its own, or one round `positions` (N, D), metres."""
    if measurement.search is not None:
        return measurement
    return replace(measurement, search=search_round(positions))


def _round_step(least: float) -> float:
    """Return the smallest of STEPS times a power of ten that is not below `least`, m."""
    power = 10.0 ** np.floor(np.log10(least))
    return float(next(step * power for step in (*STEPS, 10.0) if step * power >= least * (1 - 1e-9)))
