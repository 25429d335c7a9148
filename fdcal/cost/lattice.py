"""The search of solver "descent": the candidate with the lowest Eq. 7 for one microphone, in a plane and in space.

In a plane all candidates of the lattice are searched. Compiled loops compute their rows of W from the lattice's table
of radial functions. The cost of a candidate is a sum over modes, and no term is negative; the search therefore drops a
candidate as soon as its partial sum exceeds the full sum at the present position. Once the positions are nearly right,
a step takes at most a tenth of the time of a map (`fdcal.cost.maps`). The result is the argmin of the landscape; of
equal values it is the first in lattice order.

A lattice in space has a hundred times as many candidates as one in a plane, and W has four times as many columns.
Evaluating all candidates in every step would take too long. The cost of one microphone has no detail finer than a
fraction of the shortest wavelength in use, so that it suffices to try some candidates:

    coarse  candidates at most an eighth of that wavelength apart, over the whole domain; the modes are summed from the
            lowest up, and after each quarter of them the worse half of the candidates is dropped
    fine    from each of the best few of these, and from the present position, the search moves once to the lowest
            neighbour at half the distance, at a quarter, and so on, and at the step of the lattice until none is lower

The result is the lowest candidate that was tried; its cost is never higher than that at the present position. The rows
of W are those of `fdcal.cost.eq7`. Their columns differ from the paper's dictionary by constant factors, which do not
change Eq. 7.

The compiled loops compute rows of W for many points together, with real and imaginary parts in separate arrays and the
points along the last axis, so that the compiler can use vector instructions. The symbols are those of `fdcal.cost.eq7`.
Arrays are copied in loops, because for `a[i:] = b[i:]` numba also compiles the code of an error message, which takes
longer than compiling all other code here.
"""

import functools
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..acoustics.compiled import compiled
from ..acoustics.dictionary import LatticeDictionary, max_order
from ..model.problem import Problem
from ..model.validation import Bools, Complexes, Integers, Reals
from . import eq7

SPACING = 1 / 8  # spacing of coarse candidates, in shortest wavelengths
MIN_COARSE = 5  # smallest number of coarse candidates along the shortest axis
QUARTERS = 4  # number of parts of the modes; after each part half of the coarse candidates are dropped
MIN_KEPT = 32  # smallest number of candidates that are kept until all modes are summed
SEEDS = 4  # number of coarse candidates that are refined
MAX_WALK = 40  # largest number of further moves at the finest step


class PlaneLattice(LatticeDictionary):
    """The candidates of a search domain in the plane, with every mode that the microphones can carry (`eq7`).

    Raises InputError for a field of three dimensions, without a search domain, or if no mode can be carried.
    """

    def __init__(self, problem: Problem, order_offset: int):
        search = eq7.search_domain(problem)
        eq7.require_plane_field(problem)
        eq7.require_modes(problem, order_offset, 1)
        k = problem.wavenumbers[: eq7.usable_modes(problem, order_offset)]
        super().__init__(search, k, max_order(k, search.radius, order_offset))

    def best(self, centre: Reals, modes: slice, fits: list[eq7.LeaveOneOutFit], start: Reals) -> tuple[Reals, float]:
        """Return the candidate (2,), metres, with the lowest cost summed over `modes`, and that cost.

        `centre` (2,), metres, is a point of the lattice; `fits` are the `leave_one_out_fits` of these modes; `start`
        (2,), metres, is the present position of the microphone.
        """
        orders = self.orders[modes]
        K, r0, p_n = 2 * orders + 1, np.array([fit.r0 for fit in fits]), np.array([fit.p_n for fit in fits])
        columns = np.zeros((len(K), K.max() + 1, K.max()), complex)
        for m, fit in enumerate(fits):
            columns[m, : K[m], : K[m]], columns[m, K[m], : K[m]] = fit.Z.T, fit.alpha
        lower = ~np.any(np.triu(columns[:, :-1], 1), axis=(1, 2))  # which of the transposed Z are lower triangular
        here = self.index(start)
        best, least = pruned_search(*self.phases(centre), self.radial(modes), orders, columns, lower, r0, p_n, here)
        return self.points[best], least


class SpaceLattice:
    """The candidates of a search domain of three dimensions; `orders` (M,) int64 are those of its modes."""

    def __init__(self, problem: Problem, order_offset: int):
        self._expansion = eq7.expansion_of(problem, order_offset)
        self._search, self.orders = eq7.search_domain(problem), self._expansion.carried.orders
        self._k = np.abs(problem.wavenumbers[self._expansion.carried.modes])
        self._shape, self.nearest = np.array(self._search.shape), self._search.nearest

    @property
    def points(self) -> np.ndarray:
        """All candidates : (C, 3) float64, metres, x fastest."""
        return self._place(_grid([np.arange(count) for count in self._shape[::-1]])[:, ::-1])

    def _place(self, index: ArrayLike) -> np.ndarray:
        return np.asarray(self._search.origin) + self._search.step * np.asarray(index)

    def dictionary(self, positions: Reals, centre: Reals, modes: Sequence[int]) -> list[np.ndarray]:
        """Return W (N, (L + 1)^2) of each of `modes` at positions (N, 3) about a centre (3,), metres."""
        found: dict[int, np.ndarray] = {}
        for group in self._expansion.groups(modes):
            found |= zip(group.tolist(), self._expansion.rows(np.asarray(positions, float), centre, group), strict=True)
        return [found[mode] for mode in modes]

    def best(self, centre: Reals, modes: slice, fits: list[eq7.LeaveOneOutFit], start: Reals) -> tuple[Reals, float]:
        """Return the candidate (3,), metres, with the lowest cost that the search finds, and that cost.

        The cost is summed over `modes`. `fits` are the `leave_one_out_fits` of these modes; `start` (3,), metres, is
        the present position of the microphone.
        """
        numbers = np.arange(len(self.orders))[modes]

        def cost(index: np.ndarray, part: np.ndarray) -> np.ndarray:
            """Return the cost of candidates, summed over a part of the modes : (C,) float64."""
            points, total = self._place(index), np.zeros(len(index))
            for group in self._expansion.groups(numbers[part]):
                for number, rows in zip(group, self._expansion.rows(points, centre, group), strict=True):
                    total += fits[int(number - numbers[0])].cost_of(rows)
            return total

        wavelength = 2 * np.pi / float(self._k[numbers].max())
        max_stride = min(wavelength * SPACING / self._search.step, (self._shape.min() - 1) / (MIN_COARSE - 1))
        stride = 2 ** max(int(np.log2(max(max_stride, 1.0))), 0)  # between coarse candidates, in steps of the lattice
        everything = np.arange(len(numbers))
        coarse = _grid([np.unique(np.append(np.arange(0, count, stride), count - 1)) for count in self._shape.tolist()])
        sums = np.zeros(len(coarse))
        for some in np.array_split(everything, min(QUARTERS, len(everything))):
            if len(coarse) > MIN_KEPT and some[0] > 0:
                kept = np.argsort(sums, kind="stable")[: max(len(coarse) // 2, MIN_KEPT)]
                coarse, sums = coarse[kept], sums[kept]
            sums = sums + cost(coarse, some)
        seeds = [self._search.index(start), *coarse[np.argsort(sums, kind="stable")[:SEEDS]]]
        found = [self._refined(functools.partial(cost, part=everything), seed, stride) for seed in seeds]
        index, least = min(found, key=lambda one: one[1])
        return self._place(index), least

    def _refined(self, cost: Callable[..., np.ndarray], index: np.ndarray, stride: int) -> tuple[np.ndarray, float]:
        """Return the candidate (3,) at the end of moves to lower neighbours at decreasing distances, and its cost.

        `index` (3,) is the candidate to begin with, and `stride` the distance of coarse candidates, in steps.
        """
        around = np.delete(_grid([np.arange(-1, 2)] * 3), 13, axis=0)  # without the candidate itself
        least = float(cost(index[None])[0])
        for reach in [stride >> halved for halved in range(1, stride.bit_length())] + [1] * MAX_WALK:
            near = index + reach * around
            near = near[np.all((near >= 0) & (near < self._shape), axis=1)]
            costs = cost(near)
            lowest = int(costs.argmin())
            if costs[lowest] < least:
                index, least = near[lowest], float(costs[lowest])
            elif reach == 1:
                break
        return index, least


def _grid(axes: list[np.ndarray]) -> np.ndarray:
    """Return all combinations of the values along three axes : (C, 3), the last axis fastest."""
    return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)


plane_lattice = functools.lru_cache(maxsize=3)(PlaneLattice)
space_lattice = functools.lru_cache(maxsize=3)(SpaceLattice)

BLOCK = 32  # number of candidates that are evaluated together


@compiled
def pruned_search(
    unit: Complexes,
    row: Integers,
    radial: Complexes,
    orders: Integers,
    columns: Complexes,
    triangular: Bools,
    r0: Reals,
    p_n: Complexes,
    start: int,
):
    """Return the number of the candidate with the lowest cost summed over the modes, and that cost.

    First the cost of candidate `start` is computed. Then the costs of all candidates are summed mode by mode, beginning
    with the lowest mode, which is the cheapest. After each mode, candidates whose sum exceeds the cost of `start` are
    dropped.

    unit, row : (C,), from `LatticeDictionary.phases`; radial : (M, U, Lmax + 1), its `radial`; orders : (M,), L of each
    mode; columns : (M, Kmax + 1, Kmax), the transposed Z of each mode, followed by the row alpha; triangular : (M,),
    whether the transposed Z is lower triangular; r0, p_n : (M,), from `fdcal.cost.eq7.LeaveOneOutFit`
    """
    floor = r0.sum()
    kept, total = np.array([start]), np.array([floor])
    for m in range(len(orders)):
        _add_mode(unit, row, radial[m], orders[m], columns[m], triangular[m], p_n[m], kept, total)
    least = total[0]
    kept, total = np.arange(len(unit)), np.full(len(unit), floor)
    for m in range(len(orders)):
        _add_mode(unit, row, radial[m], orders[m], columns[m], triangular[m], p_n[m], kept, total)
        low = total <= least
        kept, total = kept[low], total[low]
    best = start
    for c in range(len(kept)):  # of several equal costs the first in the order of the lattice is chosen
        if total[c] < least or (total[c] == least and kept[c] < best):
            best, least = kept[c], total[c]
    return best, least


@compiled
def _add_mode(
    unit: Complexes,
    row: Integers,
    J: Complexes,
    L: int,
    columns: Complexes,
    triangular: bool,
    p_n: complex,
    kept: Integers,
    total: Reals,
):
    """Add the excess of one mode's cost over r0 to the sums `total` of the candidates `kept`."""
    re, im, work = np.empty((2 * L + 1, BLOCK)), np.empty((2 * L + 1, BLOCK)), np.empty((3, BLOCK))
    which, block = np.empty(BLOCK, np.int64), np.empty(BLOCK)
    for first in range(0, len(kept), BLOCK):
        count = min(BLOCK, len(kept) - first)
        for c in range(BLOCK):
            which[c] = kept[first + min(c, count - 1)]
        block[:] = 0.0
        _rows(J, unit, row, which, L, re, im)
        _add_excess(re, im, columns, p_n, 2 * L + 1, triangular, work, block)
        for c in range(count):
            total[first + c] += block[c]


@compiled
def _rows(J: Complexes, unit: Complexes, row: Integers, which: Integers, L: int, re: Reals, im: Reals):
    """Compute re[L + l] + j im[L + l] = J_l exp(j l theta), l = -L..L, for the points `which`.

    `row` holds the row of each point in J, and `unit` its exp(j theta).
    """
    for c in range(len(which)):
        point = which[c]
        r, u, v = row[point], unit[point].real, unit[point].imag
        x, y, sign = 1.0, 0.0, 1.0  # x + j y is exp(j l theta)
        re[L, c], im[L, c] = J[r, 0].real, J[r, 0].imag
        for l in range(1, L + 1):  # noqa: E741
            x, y, sign = x * u - y * v, x * v + y * u, -sign
            a, b = J[r, l].real, J[r, l].imag
            re[L + l, c], im[L + l, c] = a * x - b * y, a * y + b * x
            re[L - l, c], im[L - l, c] = sign * (a * x + b * y), sign * (b * x - a * y)


@compiled
def _add_excess(
    re: Reals, im: Reals, columns: Complexes, p_n: complex, K: int, triangular: bool, work: Reals, total: Reals
):
    """Add |p_n - w alpha|^2 / (1 + |w Z|^2) of a block of candidates to `total`; `work` (3, BLOCK) is overwritten."""
    leverage, x, y = work[0], work[1], work[2]
    leverage[:] = 1.0
    for j in range(K + 1):
        x[:] = 0.0
        y[:] = 0.0
        for i in range(min(j + 1, K) if triangular else K):
            a, b = columns[j, i].real, columns[j, i].imag
            u, v = re[i], im[i]
            for c in range(BLOCK):
                x[c] += a * u[c] - b * v[c]
                y[c] += a * v[c] + b * u[c]
        if j < K:
            for c in range(BLOCK):
                leverage[c] += x[c] * x[c] + y[c] * y[c]
    for c in range(BLOCK):  # the last column was alpha, so that x + j y is w alpha
        total[c] += ((p_n.real - x[c]) ** 2 + (p_n.imag - y[c]) ** 2) / leverage[c]
