"""Basins of attraction of a map: from each place, the local minimum where descent of that one microphone ends.

Descent follows the gradient of the cost, interpolated between the places of the lattice, and stays inside the map. From
place to neighbouring place alone it would keep to eight directions, and the borders between basins would be straight
lines. It ends at the minima that the map marks: one that is too shallow to be marked belongs to the minimum whose basin
it joins in the watershed algorithm (`fdcal.cost.watershed`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..acoustics.compiled import compiled
from ..model.settings import Search
from ..model.validation import frozen_array
from .landscapes import DEPTH
from .watershed import merged_basins

STRIDE = 0.7  # of descent, in steps of the lattice
OUTSIDE = -1  # of a place from which descent ends at the edge of the map, beyond which the cost is unknown


@dataclass(frozen=True)
class Basins:
    """The basins of attraction of a map.

    Attributes
    ----------
    labels : (ny, nx) int64, number of the minimum where descent from each place ends, or OUTSIDE; of a volume
        (nz, ny, nx)
    minima : (K, 2) int64, rows and columns of the minima, the lowest first, as `landscapes.local_minima` has them; of a
        volume (K, 3)
    """

    labels: np.ndarray
    minima: np.ndarray

    @property
    def shares(self) -> np.ndarray:
        """Share of the map that each basin holds : (K,) float64."""
        return np.bincount(self.labels[self.labels >= 0], minlength=len(self.minima)) / self.labels.size

    def at(self, search: Search, place) -> int:
        """Return the number of the basin of a place (2,) or (3,), metres; OUTSIDE beyond the lattice `search`."""
        dimension = self.labels.ndim
        index = np.rint((np.asarray(place, float)[:dimension] - search.origin[:dimension]) / search.step).astype(int)
        inside = np.all((index >= 0) & (index < self.labels.shape[::-1]))
        return int(self.labels[tuple(index[::-1])]) if inside else OUTSIDE

    @property
    def outside(self) -> float:
        """Share of the map from which descent ends at its edge."""
        return float(np.mean(self.labels == OUTSIDE))


def basins_of(cost: np.ndarray, depth: float = DEPTH) -> Basins:
    """Return the basins of attraction of a map.

    Parameters
    ----------
    cost : (ny, nx) float64, or (nz, ny, nx) of a volume
    depth : least prominence of a minimum, as a share of the map's range
    """
    minima, heirs = merged_basins(cost, depth * float(np.ptp(cost)))
    order = np.argsort(cost.ravel(), kind="stable")
    layers = np.ascontiguousarray(cost, dtype=float).reshape(-1, *cost.shape[-2:])
    places = np.stack(np.unravel_index(minima, cost.shape), axis=1)
    inside = np.all((places > 0) & (places < np.array(cost.shape) - 1), axis=1)
    numbers = np.full(cost.size, OUTSIDE)
    numbers[minima[inside]] = np.arange(np.count_nonzero(inside))
    level = np.zeros(layers.shape)  # a map does not slope across its one layer
    slopes = np.stack([np.gradient(layers, axis=axis) if layers.shape[axis] > 1 else level for axis in range(3)])
    labels = numbers[_descend(layers, slopes, order, heirs)].reshape(cost.shape)
    return Basins(frozen_array(labels, np.int64), frozen_array(places[inside], np.int64))


@compiled
def _descend(cost, slopes, order, heirs):
    """Return where descent from each point ends : (P,) int64, flat indices of minima."""
    ends = np.full(cost.size, -1, np.int64)
    for here in order:  # ascending: of each lower neighbour the end is known
        lowest = _lowest_neighbour(cost, ends, here)
        if lowest < 0:  # a minimum
            end = here
            while heirs[end] != end:
                end = heirs[end]
        else:
            end = _trace(slopes, ends, here)
            end = end if end >= 0 else ends[lowest]
        ends[here] = end
    return ends


@compiled
def _lowest_neighbour(cost, ends, here):
    """The lowest of the neighbours whose end is known; -1 without any."""
    nz, ny, nx = cost.shape
    flat, lowest = cost.ravel(), -1
    h, j, i = here // (nx * ny), here // nx % ny, here % nx
    for k in range(max(h - 1, 0), min(h + 2, nz)):
        for m in range(max(j - 1, 0), min(j + 2, ny)):
            for n in range(max(i - 1, 0), min(i + 2, nx)):
                there = (k * ny + m) * nx + n
                if ends[there] >= 0 and (lowest < 0 or flat[there] < flat[lowest]):
                    lowest = there
    return lowest


@compiled
def _trace(slopes, ends, here):
    """Where descent from a point ends: followed until the places around it agree; -1 where they never do."""
    shape = slopes.shape[1:]
    place, slope = np.zeros(3), np.zeros(3)
    place[:] = here // (shape[1] * shape[2]), here // shape[2] % shape[1], here % shape[2]
    for _ in range(2 * (shape[0] + shape[1] + shape[2])):
        slope[:] = 0.0
        low, share = _cell(place, shape)
        for corner in range(8):
            weight, h, j, i = _corner(low, share, corner)
            if weight > 0:
                slope += weight * slopes[:, h, j, i]
        for axis in range(3):
            outwards = place[axis] <= 0 < slope[axis] or (place[axis] >= shape[axis] - 1 and slope[axis] < 0)
            slope[axis] = 0.0 if outwards else slope[axis]
        length = np.sqrt(np.sum(slope**2))
        if length == 0:
            return -1
        for axis in range(3):
            place[axis] = min(max(place[axis] - STRIDE * slope[axis] / length, 0.0), shape[axis] - 1.0)
        end = _common_end(ends, place, shape)
        if end >= 0:
            return end
    return -1


@compiled
def _cell(place, shape):
    """The lowest corner of the cell that holds a place (3,), and how far the place is into the cell, 0 to 1."""
    low = np.zeros(3, np.int64)
    for axis in range(3):
        low[axis] = max(min(int(place[axis]), shape[axis] - 2), 0)
    return low, place - low


@compiled
def _corner(low, share, number):
    """Weight and indices of one of the eight corners of a cell."""
    k, m, n = number // 4, number // 2 % 2, number % 2
    weight = (share[0] if k else 1 - share[0]) * (share[1] if m else 1 - share[1]) * (share[2] if n else 1 - share[2])
    return weight, low[0] + k, low[1] + m, low[2] + n


@compiled
def _common_end(ends, place, shape):
    """The end of the corners of a cell whose ends are known, where it is the same; -1 where it is not."""
    low, share = _cell(place, shape)
    common = -1
    for corner in range(8):
        weight, h, j, i = _corner(low, share, corner)
        end = ends[(h * shape[1] + j) * shape[2] + i] if weight > 0 else -1
        if end >= 0 and common >= 0 and end != common:
            return -1
        common = end if end >= 0 else common
    return common
