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
    return flood(cost, depth)[1]


def flood(cost: np.ndarray, depth: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the order in which points are added, the minima that survive, and where all others end.

    Parameters
    ----------
    cost, depth : as of `prominent_minima`

    Returns
    -------
    order : (P,) int64, flat indices, ascending in cost; of equal costs the first index is the lower one
    minima : (K,) int64, of `prominent_minima`
    heirs : (P,) int64; a minimum that is not prominent enough has joined the basin of the minimum that this names,
        which may in turn have joined another one; any other point names itself
    """
    cost = np.ascontiguousarray(cost, dtype=float)
    order = np.argsort(cost.ravel(), kind="stable")
    layers = cost.reshape(-1, *cost.shape[-2:])  # a map is one layer
    return order, *_flood(layers, order, float(depth))


@compiled
def _flood(cost, order, depth):
    nz, ny, nx = cost.shape
    basin = np.full(cost.size, -1, np.int64)  # union-find: of a point added, its parent; a minimum is its own
    flat = cost.ravel()
    survives = np.zeros(cost.size, np.bool_)
    heirs = np.arange(cost.size)
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
                    if not survives[one]:
                        heirs[one] = other
    survives[_minimum(basin, order[0])] = True  # the basin that all others have merged into
    return np.array([point for point in order if survives[point]]), heirs


@compiled
def _minimum(basin, point):
    while basin[point] != point:
        basin[point] = basin[basin[point]]  # path halving
        point = basin[point]
    return point
