"""The rows of W of one mode on a lattice as fine as a screen, for `fdcal.cost.lattice_search.candidate_costs`.

The radial functions J_l(k r) come from a spline through a few thousand radii, good to 1e-9, which is far quicker than a
library call at each radius.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..acoustics.lattice_dictionary import bessel_orders
from ..model.settings import Search

PER_RADIAN = 400  # points of the spline per radian of k r
FEWEST_POINTS = 64  # of the spline


@dataclass(frozen=True)
class _Distances:
    """Distances between the points of a lattice.

    Attributes
    ----------
    row : (d2max + 1,) int32, squared offset in steps to index of `radii`, -1 where there is none
    radii : (U,) float64, metres, ascending
    """

    row: np.ndarray
    radii: np.ndarray


@functools.lru_cache(maxsize=2)
def _distances(search: Search) -> _Distances:
    nx, ny = search.shape
    squared = np.unique(np.add.outer(np.arange(nx) ** 2, np.arange(ny) ** 2))
    row = np.full(squared[-1] + 1, -1, dtype=np.int32)
    row[squared] = np.arange(len(squared))
    return _Distances(row, search.step * np.sqrt(squared))


@functools.lru_cache(maxsize=128)
def _radial(k: complex, L: int, longest: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return a spline of J_0..J_L of k r over r from 0 to `longest`, metres."""
    from scipy.interpolate import CubicSpline  # takes a second to load: not before the first map

    radii = np.linspace(0.0, longest, max(FEWEST_POINTS, int(PER_RADIAN * abs(k) * longest)))
    return CubicSpline(radii, bessel_orders(k * radii, L))


class OneModeLattice:
    """A lattice with the radial functions of one mode; a `fdcal.cost.lattice_search.CandidateLattice`.

    Attributes
    ----------
    radial : (1, U, L + 1) complex128, J_l at U radii
    orders : (1,) int64, L
    shape : (ny, nx)
    """

    def __init__(self, search: Search, k: complex, L: int):
        self._search, self._distances = search, _distances(search)
        radii = self._distances.radii
        self.radial, self.orders = _radial(k, L, float(radii[-1]))(radii)[None], np.array([L])
        self.shape = tuple(search.shape[::-1])

    def nearest(self, point) -> np.ndarray:
        """Return the lattice point nearest to `point`, (2,) float64, metres."""
        return np.asarray(self._search.origin) + self._search.step * self._index(point)

    def _index(self, point) -> np.ndarray:
        index = np.rint((np.asarray(point) - self._search.origin) / self._search.step).astype(np.int64)
        return np.clip(index, 0, np.array(self._search.shape) - 1)

    def phases(self, centre) -> tuple[np.ndarray, np.ndarray]:
        """Return exp(j theta) and the row of `radial` of every point about `centre`, each (C,)."""
        x, y = (np.arange(count) - here for count, here in zip(self._search.shape, self._index(centre), strict=True))
        squared = np.add.outer(y**2, x**2)
        unit = np.add.outer(1j * y, x) / np.sqrt(np.maximum(squared, 1))
        unit[squared == 0] = 1.0
        return unit.ravel(), self._distances.row[squared.ravel()]
