"""Local minima of a map and their prominence, by the watershed algorithm, compiled.

Points are added in ascending order of cost. Each minimum starts a basin; where two basins meet, the one with the higher
minimum ends. The climb from that minimum to the meeting point is its prominence.
"""

from __future__ import annotations

import numpy as np

from ..acoustics.compiled import compiled


def prominent_minima(cost: np.ndarray, depth: float) -> np.ndarray:
    """Return the local minima whose prominence exceeds `depth`, the lowest first.

    Parameters
    ----------
    cost : (ny, nx) or (nz, ny, nx) float64
    depth : least prominence, in the unit of `cost`

    Returns
    -------
    (K,) int64, flat indices; the global minimum is always one of them
    """
    cost = np.ascontiguousarray(cost, dtype=float)
    layers = cost.reshape(-1, *cost.shape[-2:])  # a map is one layer
    return _flood(layers, np.argsort(cost.ravel(), kind="stable"), float(depth))


@compiled
def _flood(cost, order, depth):
    nz, ny, nx = cost.shape
    basin = np.full(cost.size, -1, np.int64)  # union-find: of a point added, its parent; a minimum is its own
    flat = cost.ravel()
    survives = np.zeros(cost.size, np.bool_)
    for here in order:
        basin[here] = here
        h, j, i = here // (nx * ny), here // nx % ny, here % nx
        for dh in range(-1, 2):
            for dj in range(-1, 2):
                for di in range(-1, 2):
                    if not (0 <= h + dh < nz and 0 <= j + dj < ny and 0 <= i + di < nx):
                        continue
                    there = ((h + dh) * ny + j + dj) * nx + i + di
                    if basin[there] < 0 or there == here:
                        continue
                    one, other = _minimum(basin, here), _minimum(basin, there)
                    if one == other:
                        continue
                    if flat[one] < flat[other]:
                        one, other = other, one  # `one` is the higher minimum: its basin ends here
                    survives[one] = flat[here] - flat[one] > depth
                    basin[one] = other
    survives[_minimum(basin, order[0])] = True  # the basin that all others have merged into
    return np.array([point for point in order if survives[point]])


@compiled
def _minimum(basin, point):
    while basin[point] != point:
        basin[point] = basin[basin[point]]  # path halving
        point = basin[point]
    return point
