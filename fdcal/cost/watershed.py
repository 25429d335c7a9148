"""Hollows of a map, by flooding: water rises from every bottom, and where two lakes meet the shallower one ends.

What is left of a lake's depth when it ends is how much one must climb to get out of it (its prominence). Compiled.
"""

from __future__ import annotations

import numpy as np

from ..acoustics.compiled import compiled


def bottoms(cost: np.ndarray, depth: float) -> np.ndarray:
    """Flat indices (K,) int64 of the lowest points of all hollows deeper than `depth`, the lowest of all first.

    Parameters
    ----------
    cost : (ny, nx) float64
    depth : in the unit of `cost`
    """
    cost = np.ascontiguousarray(cost, dtype=float)
    return _flood(cost, np.argsort(cost.ravel(), kind="stable"), float(depth))


@compiled
def _flood(cost, order, depth):
    ny, nx = cost.shape
    lake = np.full(ny * nx, -1, np.int64)  # of a point under water: the point it leads to; a bottom leads to itself
    flat = cost.ravel()
    survives = np.zeros(ny * nx, np.bool_)
    for here in order:
        lake[here] = here
        j, i = here // nx, here % nx
        for dj in range(-1, 2):
            for di in range(-1, 2):
                if not (0 <= j + dj < ny and 0 <= i + di < nx):
                    continue
                there = (j + dj) * nx + i + di
                if lake[there] < 0 or there == here:
                    continue
                one, other = _bottom(lake, here), _bottom(lake, there)
                if one == other:
                    continue
                if flat[one] < flat[other]:
                    one, other = other, one  # `one` is the higher, which ends here
                survives[one] = flat[here] - flat[one] > depth
                lake[one] = other
    survives[_bottom(lake, order[0])] = True  # the lake that all others have ended in
    return np.array([point for point in order if survives[point]])


@compiled
def _bottom(lake, point):
    while lake[point] != point:
        lake[point] = lake[lake[point]]
        point = lake[point]
    return point
