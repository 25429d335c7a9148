"""Local minima of a map and their prominence, by the watershed algorithm, compiled.

Steepest descent from neighbour to neighbour divides the map into the basins of all its minima. The pass between two
basins is the lowest place where they touch. Passes are taken in ascending order: at each the two basins merge, and the
one with the higher minimum ends. The climb from that minimum to the pass is its prominence.

Only the passes are sorted, which are a few per cent of the points.
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
    return merged_basins(cost, depth)[0]


def merged_basins(cost: np.ndarray, depth: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the minima that survive, and where all others end.

    Of two equal costs the one with the lower index counts as lower.

    Parameters
    ----------
    cost, depth : as of `prominent_minima`

    Returns
    -------
    minima : (K,) int64, of `prominent_minima`
    heirs : (P,) int64; a minimum that is not prominent enough has joined the basin of the minimum that this names,
        which may in turn have joined another one; any other point names itself
    """
    cost = np.ascontiguousarray(cost, dtype=float)
    flat, layers = cost.ravel(), cost.reshape(-1, *cost.shape[-2:])  # a map is one layer
    basins = _basins(layers)
    passes = _passes(layers, basins)
    passes = passes[np.argsort(flat[passes[:, 0]], kind="stable")]
    ended, heirs = _merge(flat, basins, passes, float(depth))
    minima = np.flatnonzero((basins == np.arange(cost.size)) & ~ended)
    return minima[np.argsort(flat[minima], kind="stable")], heirs


@compiled
def _basins(cost):
    """Return the minimum at which steepest descent over neighbours ends, from each point : (P,) int64."""
    nz, ny, nx = cost.shape
    basin = np.empty(cost.size, np.int64)  # first the lowest neighbour, or the point itself
    for h in range(nz):
        for j in range(ny):
            for i in range(nx):
                lowest, least = 0, np.inf
                for k in range(max(h - 1, 0), min(h + 2, nz)):
                    for m in range(max(j - 1, 0), min(j + 2, ny)):
                        for n in range(max(i - 1, 0), min(i + 2, nx)):
                            if cost[k, m, n] < least:  # the first of equal ones, whose index is lowest
                                lowest, least = (k * ny + m) * nx + n, cost[k, m, n]
                basin[(h * ny + j) * nx + i] = lowest
    for point in range(cost.size):
        _end(basin, point)
    return basin


@compiled
def _end(parents, point):
    """Follow the parents of a point to one that is its own, and make that one the parent of all on the way."""
    end = point
    while parents[end] != end:
        end = parents[end]
    while parents[point] != end:
        parents[point], point = end, parents[point]
    return end


@compiled
def _passes(cost, basins):
    """Return the points that have a lower neighbour in another basin, with that basin : (E, 2) int64."""
    nz, ny, nx = cost.shape
    found, count = np.empty((1024, 2), np.int64), 0
    for h in range(nz):
        for j in range(ny):
            for i in range(nx):
                here = (h * ny + j) * nx + i
                for k in range(max(h - 1, 0), min(h + 2, nz)):
                    for m in range(max(j - 1, 0), min(j + 2, ny)):
                        for n in range(max(i - 1, 0), min(i + 2, nx)):
                            there = (k * ny + m) * nx + n
                            if basins[there] == basins[here] or cost[k, m, n] > cost[h, j, i]:
                                continue
                            if count and found[count - 1, 0] == here and found[count - 1, 1] == basins[there]:
                                continue
                            if count == len(found):
                                found = np.concatenate((found, np.empty_like(found)))
                            found[count] = here, basins[there]
                            count += 1
    return found[:count]


@compiled
def _merge(cost, basins, passes, depth):
    """Return which minima end, and the heirs of those that are not prominent enough : (P,) bool, (P,) int64."""
    union, heirs, ended = basins.copy(), np.arange(cost.size), np.zeros(cost.size, np.bool_)
    for row in range(len(passes)):
        here, there = passes[row]
        one, other = _end(union, here), _end(union, there)
        if one == other:
            continue
        if (cost[one], one) < (cost[other], other):
            one, other = other, one  # `one` is the higher minimum: its basin ends here
        ended[one] = cost[here] - cost[one] <= depth
        union[one] = other
        if ended[one]:
            heirs[one] = other
    return ended, heirs
