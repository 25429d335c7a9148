"""Maps for the eye: the cost of moving one microphone, mode by mode, as finely as a screen shows it, and its minima.

    mode_shape    the sound field of one mode, as the microphones heard it
    each_mode     costs of single modes over the search lattice, as the solver at work reckons them
    finer         the same domain with a lattice as fine as the screen
    local_minima  where a map is lower than all around
    cost_at       a map read off between its points

The formula is `fdcal.cost.lattice_search.all_candidates`. On a fine lattice the radial functions J_l(k r) come from
a spline
through a few thousand radii, good to 1e-9, which is far quicker than the library's function at each radius.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..acoustics.fourier_bessel import bessel_orders, fourier_bessel, max_order
from ..model.measurement import Problem
from ..model.scene import Search
from ..model.validation import InputError
from .eq7 import coefficients, known_weights, leave_one_out

FINE = 500  # points along the longer edge of a fine map
DEPTH = 1e-3  # of a map's span, that a hollow must be deep to count as a local minimum
PER_RADIAN = 400  # points of the spline for one radian of k r


def each_mode(problem: Problem, solver, state, n: int, modes: Sequence[int]) -> np.ndarray:
    """Cost of each of `modes` (counted from 1) with microphone `n` moved over the search lattice : (P, ny, nx).

    `solver` is the module whose `state` is looked at: it says what the cost is. Raises InputError as it does.
    """
    low, high = min(modes), max(modes)
    maps = solver.landscape(problem, state, n, slice(low - 1, high))
    return maps[np.asarray(modes) - low]


def fine_mode(problem: Problem, solver, state, n: int, mode: int, search: Search) -> np.ndarray:
    """Cost of one mode, counted from 1, with microphone `n` moved over `search`, any lattice of the same area.

    As `each_mode`, (ny, nx) float64; of Eq. 7 the centre of the expansion is the point of `search` nearest to that of
    `state`.
    """
    if not hasattr(state, "centre"):  # a likelihood, which has none and takes any lattice
        return solver.landscape(problem, state, n, slice(mode - 1, mode), search)[0]
    from .lattice_search import all_candidates  # compiled code, which a page loads before its first map

    k = complex(problem.wavenumbers[mode - 1])
    L = int(max_order(problem.wavenumbers[mode - 1 : mode], search.radius, state.order_offset)[0])
    rings = _rings(search)
    lattice = _OneMode(search, rings, _radial(k, L, rings.longest)(rings.radii)[None], np.array([L]))
    centre = lattice.nearest(state.centre)
    W = fourier_bessel(np.asarray(state.positions), k, L, centre)
    weights = known_weights(problem, state.settings.known_weight)
    fits = leave_one_out([W], problem.pressures[mode - 1 : mode], n, weights=weights)
    return all_candidates(lattice, centre, slice(0, 1), fits).reshape(rings.shape)


def mode_shape(problem: Problem, positions, mode: int, order_offset: int) -> np.ndarray:
    """Real part of the pressure of one mode (counted from 1) over the search lattice, greatest 1 : (ny, nx) float64.

    W alpha of Eq. 6 with the microphones at `positions` (N, 2), metres, and the phase of most pressure; true to the
    room where the positions are and among the microphones. Raises InputError where there is no plane lattice.
    """
    search = problem.search
    if problem.dimension != 2 or search is None:
        raise InputError("the shape of a mode is drawn of two-dimensional fields with a search domain")
    positions, k = np.asarray(positions, float), problem.wavenumbers[mode - 1]
    most = (len(positions) - 2) // 2  # 2L + 1 functions for the microphones
    L = min(int(max_order(k[None], search.radius, order_offset)[0]), most)
    centre = positions.mean(axis=0)
    alpha = coefficients(fourier_bessel(positions, complex(k), L, centre), problem.pressures[mode - 1])
    x, y = (o + search.step * np.arange(n) for o, n in zip(search.origin, search.shape, strict=True))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    field = fourier_bessel(points, complex(k), L, centre) @ alpha
    field = np.real(field * np.exp(-0.5j * np.angle(np.sum(field**2))))
    field /= field[np.abs(field).argmax()]
    return field.reshape(len(y), len(x))


def finer(search: Search, count: int = FINE) -> Search:
    """The same area, the cells at its edge included, with `count` points along its longer edge."""
    step = search.step * max(search.shape) / count
    corner = np.subtract(search.origin, search.step / 2)
    numbers = [max(round(search.step * n / step), 2) for n in search.shape]
    origin = tuple(float(x) for x in corner + step / 2)
    return replace(search, origin=origin, size=tuple((n - 1) * step for n in numbers), step=step)


@dataclass(frozen=True)
class _Rings:
    """Distances between points of a lattice: (ny, nx), row of a squared offset in steps, radii (U,), metres."""

    shape: tuple[int, int]
    row: np.ndarray
    radii: np.ndarray

    @property
    def longest(self) -> float:
        return float(self.radii[-1])


@functools.lru_cache(maxsize=2)
def _rings(search: Search) -> _Rings:
    nx, ny = search.shape
    squared = np.unique(np.add.outer(np.arange(nx) ** 2, np.arange(ny) ** 2))
    row = np.full(squared[-1] + 1, -1, dtype=np.int32)
    row[squared] = np.arange(len(squared))
    return _Rings((ny, nx), row, search.step * np.sqrt(squared))


@functools.lru_cache(maxsize=128)
def _radial(k: complex, L: int, longest: float) -> Callable[[np.ndarray], np.ndarray]:
    """J_0..J_L of k r for r from 0 to `longest`, metres."""
    from scipy.interpolate import CubicSpline  # a second to load, which the page does without until its first map

    radii = np.linspace(0.0, longest, max(64, int(PER_RADIAN * abs(k) * longest)))
    return CubicSpline(radii, bessel_orders(k * radii, L))


class _OneMode:
    """A lattice with the table of one mode, as `fdcal.cost.lattice_search` reads it."""

    def __init__(self, search: Search, rings: _Rings, radial: np.ndarray, orders: np.ndarray):
        self._search, self._rings, self.radial, self.orders = search, rings, radial, orders

    def nearest(self, point) -> np.ndarray:
        return np.asarray(self._search.origin) + self._search.step * self._index(point)

    def _index(self, point) -> np.ndarray:
        index = np.rint((np.asarray(point) - self._search.origin) / self._search.step).astype(np.int64)
        return np.clip(index, 0, np.array(self._search.shape) - 1)

    def phases(self, centre) -> tuple[np.ndarray, np.ndarray]:
        """exp(j theta) and row of `radial` of every point about `centre`."""
        x, y = (np.arange(count) - here for count, here in zip(self._search.shape, self._index(centre), strict=True))
        squared = np.add.outer(y**2, x**2)
        unit = np.add.outer(1j * y, x) / np.sqrt(np.maximum(squared, 1))
        unit[squared == 0] = 1.0
        return unit.ravel(), self._rings.row[squared.ravel()]


def local_minima(cost: np.ndarray, depth: float = DEPTH) -> np.ndarray:
    """Rows and columns (K, 2) int64 of the bottoms of the hollows of `cost` (ny, nx), the deepest hollow first.

    A hollow counts where one must climb by `depth` of the map's whole span to leave it for a lower one: a valley that
    crosses a lattice aslant has a string of smaller ones. Bottoms at the edge, beyond which nothing is known, do not
    count.
    """
    from .watershed import bottoms

    rows, columns = np.divmod(bottoms(cost, depth * float(np.ptp(cost))), cost.shape[1])
    inside = (rows > 0) & (columns > 0) & (rows < cost.shape[0] - 1) & (columns < cost.shape[1] - 1)
    return np.stack([rows, columns], axis=1)[inside]


def places(indices: np.ndarray, search: Search) -> np.ndarray:
    """Rows and columns (K, 2) of a map over `search` as positions (K, 2) float64, metres."""
    return np.asarray(search.origin)[:2] + search.step * np.asarray(indices)[:, ::-1]


def cost_at(cost: np.ndarray, search: Search, point) -> float:
    """A map (ny, nx) over `search` read off at a point (2,), metres, between its points in proportion."""
    place = (np.asarray(point, float)[:2] - search.origin[:2]) / search.step
    x, y = np.clip(place, 0, np.array(cost.shape[::-1]) - 1)
    i, j = min(int(x), cost.shape[1] - 2), min(int(y), cost.shape[0] - 2)
    u, v = x - i, y - j
    low, high = cost[j, i : i + 2] @ [1 - u, u], cost[j + 1, i : i + 2] @ [1 - u, u]
    return float((1 - v) * low + v * high)
