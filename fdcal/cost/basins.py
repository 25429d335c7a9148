"""Local minima of a map, their basins, and the path of one microphone downhill.

Whether a minimum counts depends on its prominence (`fdcal.cost.scale`), which a watershed algorithm computes. Steepest
descent from neighbour to neighbour assigns every point of the map to the basin of a minimum. The pass between two
basins is the lowest point where they touch. The passes are visited in ascending order, and at each of them its two
basins merge; the climb from the higher of their two minima to the pass is the prominence of that minimum. Only the
passes, a few per cent of all points, must be sorted.

The basin of a minimum that is too shallow to count belongs to the basin with which it merges.

The path of a microphone follows the negative gradient of the cost, interpolated between lattice points. It stays in the
basin in which it begins, so that it ends at the minimum that the map marks there. From a minimum that is too shallow to
count, the path continues at the nearest point of the basin with a lower cost.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from ..acoustics.compiled import compiled
from ..model.settings import Search
from ..model.validation import Integers, Reals, frozen_array
from .scale import DEPTH, OUTSIDE, on_scale

STRIDE = 0.7  # length of the steps of a path, in steps of the lattice


def merged_basins(cost: np.ndarray, depth: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the flat indices (K,) of minima whose prominence exceeds `depth`, and for each point its minimum (P,).

    Both are int64. `depth` is in the unit of `cost`. The minima are in ascending order of cost, and the global one is
    always among them. Of two equal costs, the one with the lower index counts as lower.
    """
    cost = np.ascontiguousarray(cost, dtype=float)
    flat, layers = cost.ravel(), cost.reshape(-1, *cost.shape[-2:])  # a map of two dimensions has one layer
    basins = _roots(_lowest_neighbours(layers))
    passes = _passes(layers, basins)
    passes = passes[np.argsort(flat[passes[:, 0]], kind="stable")]
    ended, heirs = _merge(flat, basins, passes, float(depth))
    minima = np.flatnonzero((basins == np.arange(cost.size)) & ~ended)
    return minima[np.argsort(flat[minima], kind="stable")], _roots(heirs)[basins]


@compiled
def _lowest_neighbours(cost: Reals):
    """Return the lowest neighbour of each point, or the point itself if no neighbour is lower : (P,) int64."""
    nz, ny, nx = cost.shape
    found = np.empty(cost.size, np.int64)
    for h in range(nz):
        for j in range(ny):
            for i in range(nx):
                lowest, least = 0, np.inf
                for k in range(max(h - 1, 0), min(h + 2, nz)):
                    for m in range(max(j - 1, 0), min(j + 2, ny)):
                        for n in range(max(i - 1, 0), min(i + 2, nx)):
                            if cost[k, m, n] < least:  # < keeps the first of equal costs, which has the lowest index
                                lowest, least = (k * ny + m) * nx + n, cost[k, m, n]
                found[(h * ny + j) * nx + i] = lowest
    return found


@compiled
def _roots(parents: Integers):
    """Return the root of each point's tree : (P,) int64; a root is its own parent."""
    basin = parents.copy()
    for point in range(len(basin)):
        _root(basin, point)
    return basin


@compiled
def _root(parents: Integers, point: int):
    """Return the root of a point's tree, and make it the parent of all points on the way (union-find)."""
    root = point
    while parents[root] != root:
        root = parents[root]
    while parents[point] != root:
        parents[point], point = root, parents[point]
    return root


@compiled
def _passes(cost: Reals, basins: Integers):
    """Return pairs of a point and another basin in which it has a neighbour of no higher cost : (E, 2) int64."""
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
                                found = np.append(found, found, axis=0)
                            found[count, 0], found[count, 1] = here, basins[there]
                            count += 1
    return found[:count]


@compiled
def _merge(cost: Reals, basins: Integers, passes: Integers, depth: float):
    """Return for each of P points whether it is a minimum too shallow to count, and the minimum with which it merges.

    The latter is the point itself unless it is too shallow. `passes` must be in ascending order of their cost.
    """
    union, heirs, ended = basins.copy(), np.arange(cost.size), np.zeros(cost.size, np.bool_)
    for row in range(len(passes)):
        here, there = passes[row]
        one, other = _root(union, here), _root(union, there)
        if one == other:
            continue
        if (cost[one], one) < (cost[other], other):
            one, other = other, one  # now `one` is the higher minimum, whose basin merges into that of `other`
        ended[one] = cost[here] - cost[one] <= depth
        union[one] = other
        if ended[one]:
            heirs[one] = other
    return ended, heirs


@dataclass(frozen=True)
class Basins:
    """The basins of the minima of a map that count."""

    # (ny, nx), or (nz, ny, nx) for a volume, int64: number of the minimum to whose basin each point belongs, or OUTSIDE
    labels: np.ndarray
    minima: Integers  # (K, 2) int64, row and column, or (K, 3), with the layer first; the lowest minimum first

    def at(self, search: Search, place: Reals) -> int:
        """Return the number of the basin at a position (2,) or (3,), metres; OUTSIDE if it is not in the lattice."""
        dimension = self.labels.ndim
        index = np.rint((np.asarray(place, float)[:dimension] - search.origin[:dimension]) / search.step).astype(int)
        inside = np.all((index >= 0) & (index < self.labels.shape[::-1]))
        return int(self.labels[tuple(index[::-1])]) if inside else OUTSIDE


def basins_of(cost: np.ndarray, depth: float = DEPTH) -> Basins:
    """Return the local minima of a map (ny, nx) or volume (nz, ny, nx), and their basins.

    A minimum counts if its prominence, the climb that is needed to reach a lower minimum, exceeds the fraction `depth`
    of the map's scale. Minima at the edge do not count, because the cost beyond it is unknown.
    """
    minima, owners = merged_basins(on_scale(cost), depth)
    places = np.stack(np.unravel_index(minima, cost.shape), axis=1)
    inside = np.all((places > 0) & (places < np.array(cost.shape) - 1), axis=1)
    numbers = np.full(cost.size, OUTSIDE)
    numbers[minima[inside]] = np.arange(np.sum(inside))
    return Basins(frozen_array(numbers[owners].reshape(cost.shape), np.int64), frozen_array(places[inside], np.int64))


SHORTEST = 0.05  # length of the shortest step of a path that is tried, in steps of the lattice
MAX_STEPS = 2000  # largest number of steps of a path
REACH = 4.0  # longest jump out of a shallow minimum on a path to the edge of the map, in steps of the lattice


@dataclass(frozen=True)
class DescentPath:
    """The path of one microphone downhill."""

    points: Reals  # (P, D) float64, metres, from the start to the minimum
    costs: Reals  # (P,) float64, descending
    basin: int  # number of the basin, or OUTSIDE for a path that ends at the edge of the map


def descent_path(cost: np.ndarray, search: Search, basins: Basins, place: Reals) -> DescentPath:
    """Return the path downhill from the point `place`, (2,) or (3,) float64, metres.

    `cost` (ny, nx) or (nz, ny, nx) float64 is a map on the lattice `search`, and `basins` are its basins. A point
    outside the lattice is first moved to the edge.
    """
    origin, last = np.asarray(search.origin[: cost.ndim]), np.array(cost.shape) - 1
    here = np.clip(((np.asarray(place, float)[: cost.ndim] - origin) / search.step)[::-1], 0.0, last)  # as indices
    own = basins.labels[tuple(np.rint(here).astype(int))]
    slopes = np.gradient(cost)

    def height(at: Reals) -> float:
        return float(map_coordinates(cost, at[:, None], order=1)[0])

    def step_from(at: Reals, level: float) -> tuple[Reals, float] | None:
        """Return the next point downhill in the basin and its cost, or None."""
        slope = np.array([map_coordinates(one, at[:, None], order=1)[0] for one in slopes])
        slope[((at <= 0) & (slope > 0)) | ((at >= last) & (slope < 0))] = 0.0  # the path stays inside the map
        length, stride = float(np.linalg.norm(slope)), STRIDE
        while length > 0 and stride > SHORTEST:
            there = np.clip(at - stride * slope / length, 0.0, last)
            lower = height(there)
            if lower < level and basins.labels[tuple(np.rint(there).astype(int))] == own:
                return there, lower
            stride /= 2
        # This is a minimum that is too shallow to count: continue at the nearest lower point.
        lower = np.argwhere((basins.labels == own) & (cost < level))
        away = np.linalg.norm(lower - at, axis=1)
        if not len(lower) or away.min() > (REACH if own == OUTSIDE else np.inf):
            return None
        found = lower[int(away.argmin())]
        return found.astype(float), float(cost[tuple(found)])

    points, costs = [here], [height(here)]
    while len(points) < MAX_STEPS and (step := step_from(points[-1], costs[-1])) is not None:
        points.append(step[0])
        costs.append(step[1])
    return DescentPath(origin + search.step * np.array(points)[:, ::-1], np.array(costs), int(own))
