"""The search lattice of a field of three dimensions, searched from coarse to fine.

A lattice of three dimensions has a hundred times the candidates of a map, and W four times the columns, so that not
every candidate is tried. The cost of one microphone has no detail finer than a part of the shortest wavelength in use:

    coarse  candidates about an eighth of that wavelength apart, over the whole domain; the modes are summed from the
            lowest up, and after each quarter of them the worse half of the candidates is dropped
    fine    from the best few of these, and from where the microphone is, to neighbours at half the distance, and so on
            down to the lattice's own step, until none is lower

The result is the lowest candidate that was tried, never one above the place of the microphone. The rows of W are those
of `fdcal.cost.field_expansion`, which differ from those of the paper's dictionary by a factor of each column: Eq. 7
does not depend on it.
"""

from __future__ import annotations

import functools
import itertools

import numpy as np

from ..model.problem import Problem
from ..model.settings import Search
from ..model.validation import InputError
from .eq7 import LeaveOneOutFit
from .eq7_maps import map_of
from .field_expansion import FieldExpansion
from .map_nodes import from_nodes, node_counts, node_points

SPACING = 1 / 8  # of coarse candidates, of the shortest wavelength in use
LEAST_COARSE = 5  # coarse candidates along the shortest axis, at least
QUARTERS = 4  # parts of the modes, after each of which half of the coarse candidates is dropped
LEAST_KEPT = 32  # candidates that are never dropped before all modes are summed
SEEDS = 4  # coarse candidates that are refined
MAX_WALK = 40  # moves at the finest step


class SpaceLattice:
    """The candidates of a search domain of three dimensions, and the dictionary of any points of it.

    Parameters
    ----------
    problem : Problem, of an array and a field of three dimensions
    order_offset : added to ceil(k R) in the order of every mode

    Attributes
    ----------
    search : Search
    orders : (M,) int64, L of each mode that the microphones can carry
    points : (C, 3) float64, candidates, metres, x fastest

    Raises
    ------
    InputError
        The problem has no search domain.
    """

    def __init__(self, problem: Problem, order_offset: int):
        self._expansion = FieldExpansion(problem, order_offset)
        if problem.search is None:
            raise InputError("the measurement has no search domain", "give <search> and <radius>", key="search")
        self.search, self.orders = problem.search, self._expansion.carried.orders
        self._k = np.abs(problem.wavenumbers[self._expansion.carried.modes])
        self._origin, self._shape = np.array(self.search.origin), np.array(self.search.shape)

    @property
    def points(self) -> np.ndarray:
        """All candidates : (C, 3) float64, metres, x fastest."""
        axes = [np.arange(count) for count in self._shape[::-1]]
        return self._place(np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")][::-1], axis=1))

    def nearest(self, point) -> np.ndarray:
        """Return the lattice point nearest to `point` (..., 3), inside the search domain : (..., 3) float64, metres."""
        return self._place(self._index(point))

    def _place(self, index) -> np.ndarray:
        return self._origin + self.search.step * np.asarray(index)

    def _index(self, point) -> np.ndarray:
        index = np.rint((np.asarray(point) - self._origin) / self.search.step).astype(np.int64)
        return np.clip(index, 0, self._shape - 1)

    def dictionary(self, positions, centre, modes) -> list[np.ndarray]:
        """Return W of given positions, on the lattice or off it.

        Parameters
        ----------
        positions : (N, 3) float64, metres
        centre : (3,) float64, metres
        modes : sequence of int

        Returns
        -------
        list of (N, (L + 1)^2) complex128, one for each of `modes`
        """
        found: dict[int, np.ndarray] = {}
        for group in self._expansion.groups(modes):
            found |= zip(group.tolist(), self._expansion.rows(np.asarray(positions, float), centre, group), strict=True)
        return [found[mode] for mode in np.asarray(modes).tolist()]

    def best(self, centre, modes: slice, fits: list[LeaveOneOutFit], start) -> tuple[np.ndarray, float]:
        """Return the candidate of least cost that the search finds, and that cost, summed over the modes.

        Parameters
        ----------
        centre : (3,) float64, metres
        modes : slice, the modes in use
        fits : their `leave_one_out_fits`, in the same order
        start : (3,) float64, metres, where the microphone is; no candidate above its cost is returned

        Returns
        -------
        (3,) float64, metres, and float
        """
        numbers = np.arange(len(self.orders))[modes]
        cost = functools.partial(self._costs, np.asarray(centre, float), numbers, fits)
        stride = self._stride(float(self._k[numbers].max()))
        here = self._index(start)
        seeds = np.concatenate([here[None], self._coarse(cost, stride, len(numbers))])
        places = [self._refined(cost, seed, stride) for seed in seeds]
        lowest = min(range(len(places)), key=lambda i: (places[i][1], i))
        index, least = places[lowest]
        return self._place(index), least

    def _stride(self, k: float) -> int:
        """Return the distance of coarse candidates in steps of the lattice, a power of two."""
        most = min(2 * np.pi / k * SPACING / self.search.step, (self._shape.min() - 1) / (LEAST_COARSE - 1))
        return 2 ** max(int(np.log2(max(most, 1.0))), 0)

    def _coarse(self, cost, stride: int, modes: int) -> np.ndarray:
        """Return the indices of the best coarse candidates : (S, 3) int64."""
        axes = [np.unique(np.append(np.arange(0, count, stride), count - 1)) for count in self._shape]
        index = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
        total = np.zeros(len(index))
        for part in np.array_split(np.arange(modes), min(QUARTERS, modes)):
            if len(index) > LEAST_KEPT and part[0] > 0:
                kept = np.argsort(total, kind="stable")[: max(len(index) // 2, LEAST_KEPT)]
                index, total = index[kept], total[kept]
            total = total + cost(index, part)
        return index[np.argsort(total, kind="stable")[:SEEDS]]

    def _refined(self, cost, seed: np.ndarray, stride: int) -> tuple[np.ndarray, float]:
        """Return the candidate that neighbours at ever smaller distances lead to, and its cost."""
        around = np.array([step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)])
        index, least = seed, float(cost(seed[None])[0])
        while stride > 1:
            stride //= 2
            index, least, _ = self._lower(cost, index, least, stride * around)
        for _ in range(MAX_WALK):
            index, least, moved = self._lower(cost, index, least, around)
            if not moved:
                break
        return index, least

    def _lower(self, cost, index: np.ndarray, least: float, steps: np.ndarray) -> tuple[np.ndarray, float, bool]:
        """Return the lowest of a candidate and those at `steps` from it, and whether it is one of these."""
        near = index + steps
        near = near[np.all((near >= 0) & (near < self._shape), axis=1)]
        costs = cost(near)
        lowest = int(costs.argmin())
        if costs[lowest] < least:
            return near[lowest], float(costs[lowest]), True
        return index, least, False

    def _costs(self, centre, numbers: np.ndarray, fits: list[LeaveOneOutFit], index, part=None) -> np.ndarray:
        """Return the cost of candidates, summed over the modes, or over a `part` of them : (C,) float64."""
        part = np.arange(len(numbers)) if part is None else part
        points, total = self._place(index), np.zeros(len(index))
        for group in self._expansion.groups(numbers[part]):
            for number, rows in zip(group, self._expansion.rows(points, centre, group), strict=True):
                total += fits[int(number - numbers[0])].cost_of(rows)
        return total


def layer_landscape(
    problem: Problem, lattice: SpaceLattice, fits: list[LeaveOneOutFit], centre, modes: slice, height: float,
    search: Search | None = None,
) -> np.ndarray:  # fmt: skip
    """Return the cost of each of `modes` with the microphone in a horizontal layer.

    Parameters
    ----------
    lattice : SpaceLattice of the problem
    fits : of the modes, without the microphone
    centre : (3,) float64, metres
    modes : slice
    height : of the layer, metres
    search : lattice of the layer; that of the search domain unless given

    Returns
    -------
    (modes, ny, nx) float64
    """
    domain = lattice.search
    search = domain if search is None else search
    maps = []
    for number, fit in zip(np.arange(len(lattice.orders))[modes], fits, strict=True):
        counts = node_counts(domain, float(np.real(problem.wavenumbers[number])))
        points = node_points(domain, counts)
        points = np.column_stack([points, np.full(len(points), height)])
        rows = lattice.dictionary(points, centre, [number])[0]
        maps.append(map_of(fit, rows, counts, [from_nodes(domain, search, axis, counts[axis]) for axis in (0, 1)]))
    return np.stack(maps)


@functools.lru_cache(maxsize=3)
def space_lattice(problem: Problem, order_offset: int) -> SpaceLattice:
    """Return the lattice of the search domain of a problem in three dimensions."""
    return SpaceLattice(problem, order_offset)
