"""Maps of the cost of moving one microphone, for display: planes, lines and volumes of any resolution.

    eq7_maps, cost_volume           Eq. 7 with fixed orders, relative to the power: the page can show it for any solver
    descent_maps                    Eq. 7 as a step of solver "descent" minimises it
    likelihood_maps                 the negative log-likelihood, which the other solvers minimise
    cost_maps                       one of these, as the page requests it
    partial_sums                    the map while modes are added one by one
    map_minima, minima_of           the minima that are marked on a map
    landscape_panels                the landscapes of one microphone, for each mode and their sum: the paper's Fig. 1
    mode_shape                      the sound field of one mode, reconstructed from the recorded pressures

The spacing of a lattice is far smaller than the detail of the field. With microphone n at x, all costs are simple
functions of two fields, such as r0 + |p_n - f|^2 / (1 + h) in `fdcal.cost.eq7`:

    f(x)   prediction of the pressure at x by the other microphones, which has no wavenumber above k
    h(x)   variance of the error of this prediction, which has no wavenumber above 2 k

Both are computed at a few dozen Chebyshev nodes along each axis and interpolated to the lattice, exactly except for
rounding errors; the cost is computed from them afterwards. Maps on different lattices therefore agree at common points.
In three dimensions a map shows the horizontal layer at the height of the microphone.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular
from scipy.ndimage import map_coordinates
from scipy.special import jv

from ..acoustics.dictionary import fourier_bessel, max_order
from ..model.problem import ChannelCorrection, Problem, SolverState, equalised
from ..model.settings import Search
from ..model.validation import Complexes, InputError, Reals, frozen_array
from . import eq7
from .kernels import diffuse_correlation
from .likelihood import isotropic_field
from .scale import DECADES, DEPTH, FEW_MODES, Minima, on_scale

NEGLIGIBLE = 1e-15  # size below which the Chebyshev coefficients of a map are omitted
VOLUME_NEGLIGIBLE = 1e-8  # the same for a volume
MAX_VALUES = 10_000_000  # largest number of values of W in memory at the same time; they take 160 MB
FINE = 500  # number of points along the longer edge of a fine map


# Chebyshev nodes over a search domain, and the interpolation from them to a lattice.


def area(search: Search, dimension: int = 2) -> np.ndarray:
    """Return the lowest and the highest coordinates of the domain, edge cells included : (2, D), metres."""
    low = np.asarray(search.origin)[:dimension] - search.step / 2
    return np.stack([low, low + search.step * np.array(search.shape[:dimension])])


@functools.lru_cache(maxsize=1024)
def node_counts(
    search: Search, wavenumber: float, dimension: int = 2, negligible: float = NEGLIGIBLE
) -> tuple[int, ...]:
    """Return the numbers of nodes along each axis that resolve wavenumbers up to 2 k, where k is `wavenumber`, rad/m.

    They are multiples of 4, so that several modes can use the same tables. They suffice for all Chebyshev coefficients
    of a plane wave of wavenumber 2 k that are not below `negligible`.
    """
    low, high = area(search, dimension)
    counts: list[int] = []
    for half in (high - low) / 2:
        z = 2 * wavenumber * half
        degrees = np.arange(int(z) + 1, int(1.5 * z) + 60)  # the coefficients are J_l(z), which decrease for l > z
        counts.append(4 * (int(degrees[np.argmax(jv(degrees, z) < negligible)]) // 4 + 1))
    return tuple(counts)


def node_points(search: Search, counts: Sequence[int], height: Sequence[float] | Reals) -> np.ndarray:
    """Return the nodes of the domain, `counts` along each axis : (C, D) metres, x fastest.

    `height` is z (1,), common to all nodes, for a horizontal layer in space, and otherwise empty.
    """
    low, high = area(search, len(counts))
    axes = [a + (b - a) * (1 + chebpts1(count)) / 2 for a, b, count in zip(low, high, counts, strict=True)]
    points = np.stack([x.ravel() for x in np.meshgrid(*axes[::-1], indexing="ij")][::-1], axis=1)
    return np.concatenate([points, np.tile(height, (len(points), 1))], axis=1)


def _from_nodes(domain: Search, places: np.ndarray, axis: int, count: int) -> np.ndarray:
    """Return the matrix (P, count) that interpolates on an axis from the nodes of `domain` to places (P,), metres."""
    low, high = area(domain, len(domain.origin))[:, axis]
    weight = np.full(count, 2.0 / count)
    weight[0] /= 2
    there = np.asarray(chebvander(np.asarray((2 * places - low - high) / (high - low)), count - 1))
    return (there * weight) @ np.asarray(chebvander(chebpts1(count), count - 1)).T


@functools.lru_cache(maxsize=128)
def _onto_lattice(domain: Search, search: Search, counts: tuple[int, ...]) -> list[np.ndarray]:
    """Return the matrices of `_from_nodes` along x and y onto a lattice."""
    places = [o + search.step * np.arange(n) for o, n in zip(search.origin[:2], search.shape[:2], strict=True)]
    return [_from_nodes(domain, places[axis], axis, count) for axis, count in enumerate(counts)]


def _stacked(h: np.ndarray, f: np.ndarray, counts: Sequence[int]) -> np.ndarray:
    """Return h and f, each (C,) at the nodes, as one array of h, Re f and Im f : (3, [nz,] ny, nx) float64."""
    return np.stack([h, np.real(f), np.imag(f)]).reshape(3, *counts[::-1])


def _interpolated(values: np.ndarray, onto: list[np.ndarray]) -> np.ndarray:
    """Return h, Re f and Im f on a lattice, (3, [nz,] ny, nx), from `values` at the nodes (see `_stacked`).

    `onto` are the matrices of `_from_nodes` along x, y and, for a volume, z.
    """
    values = onto[1] @ (values @ onto[0].T)
    if len(onto) == 3:
        values = (onto[2] @ values.reshape(3, len(values[0]), -1)).reshape(3, -1, *values.shape[2:])
    np.maximum(values[0], 0.0, out=values[0])
    return values


# Eq. 7 with one microphone moved.


@dataclass(frozen=True)
class NodeTerms:
    """The contribution of one mode to the cost: its fit without the microphone, and h, Re f and Im f at the nodes."""

    fit: eq7.LeaveOneOutFit
    values: Reals  # (3, [nz,] ny, nx) float64

    @property
    def counts(self) -> tuple[int, ...]:
        """Numbers of nodes along x, y and, for a volume, z."""
        return self.values.shape[:0:-1]

    def on(self, onto: list[np.ndarray]) -> np.ndarray:
        """Return the cost on a lattice ([nz,] ny, nx); `onto` are the matrices of `_from_nodes` along its axes."""
        return self.fit.cost(*_interpolated(self.values, onto))


@dataclass(frozen=True)
class MovedMicrophone:
    """The terms of Eq. 7, with microphone `n` anywhere and the others at their positions, for fixed orders."""

    problem: Problem
    expansion: eq7.FieldExpansion  # has the order of each mode
    positions: Reals  # (N, D) float64, metres
    n: int  # counted from 0
    centre: Reals  # (D,) float64, metres, centre of the expansion
    pressures: Complexes  # (M, N) complex128, pressures of all modes of the problem, times `scale`
    scale: Reals  # (N,) float64, square root of the weight of each microphone

    @property
    def domain(self) -> Search:
        """The search domain, which the nodes cover."""
        return eq7.search_domain(self.problem)

    def fits(self, modes: Sequence[int], points: np.ndarray) -> Iterator[tuple[int, eq7.LeaveOneOutFit, np.ndarray]]:
        """Yield each of `modes`, counted from 1, with its fit and its rows of W (C, K) at points (C, D), metres."""
        carried, count = self.expansion.carried.modes, len(self.positions)
        places = np.concatenate([self.positions, points])
        for group in self.expansion.groups(np.searchsorted(carried, np.asarray(modes) - 1)):
            values = len(places) * eq7.functions(self.problem, int(self.expansion.carried.orders[group[0]]))
            for batch in np.array_split(group, min(-(-len(group) * values // MAX_VALUES), len(group))):
                rows = self.expansion.rows(places, self.centre, batch)
                W = self.scale[:, None] * rows[:, :count]
                fits = eq7.leave_one_out_fits(list(W), self.pressures[carried[batch]], self.n)
                yield from zip(carried[batch] + 1, fits, self.scale[self.n] * rows[:, count:], strict=True)

    def at_nodes(
        self, modes: Sequence[int], dimension: int = 2, negligible: float = NEGLIGIBLE
    ) -> Iterator[tuple[int, NodeTerms]]:
        """Yield each of `modes`, counted from 1, with its terms at the nodes along x, y and, if `dimension` is 3, z."""
        k = np.real(self.problem.wavenumbers)
        counts = [node_counts(self.domain, float(k[mode - 1]), dimension, negligible) for mode in modes]
        for shape in sorted(set(counts)):
            points = node_points(self.domain, shape, self.positions[self.n, dimension:])
            alike = [mode for mode, count in zip(modes, counts, strict=True) if count == shape]
            for mode, fit, rows in self.fits(alike, points):
                yield mode, NodeTerms(fit, _stacked(*fit.terms(rows), shape))

    def maps(self, modes: Sequence[int], search: Search | None) -> np.ndarray:
        """Return the cost of each of `modes` on the lattice `search`, by default that of the domain : (P, ny, nx)."""
        search, numbers = self.domain if search is None else search, np.asarray(modes)
        maps = np.empty((len(numbers), *search.shape[1::-1]))
        for mode, terms in self.at_nodes(modes):
            maps[numbers == mode] = terms.on(_onto_lattice(self.domain, search, terms.counts))
        return maps

    def power(self, modes: Sequence[int]) -> float:
        """Return the power of the pressures of `modes`, by which the cost on the page is divided."""
        return float(np.sum(np.abs(self.pressures[np.asarray(modes) - 1]) ** 2))


def _on_the_page(
    problem: Problem, positions: Reals, n: int, modes: Sequence[int], order_offset: int,
    channels: ChannelCorrection | None,
) -> MovedMicrophone:  # fmt: skip
    """Return the terms of the reference cost of `fdcal.cost.eq7`, with the order of each mode fixed by `order_offset`.

    The terms of a mode depend neither on the solver nor on the other modes that are chosen. Raises InputError if the
    microphones cannot carry one of `modes`: its expansion then has too many functions (`eq7.carried_modes`).
    """
    eq7.require_carried(problem, modes, order_offset)
    x, (pressures, scale) = np.asarray(positions, float), equalised(problem.pressures, channels)
    return MovedMicrophone(problem, eq7.expansion_of(problem, order_offset), x, n, x.mean(axis=0), pressures, scale)


def eq7_maps(
    problem: Problem, positions: Reals, n: int, modes: Sequence[int], order_offset: int, search: Search | None = None,
    channels: ChannelCorrection | None = None,
) -> np.ndarray:  # fmt: skip
    """Return the cost of each of `modes` with microphone `n` moved, relative to the power of all : (P, ny, nx).

    `modes` (P,) count from 1. `order_offset` is added to ceil(k R) in the order of every mode. `search` is a lattice
    inside the search domain of the problem, by default the domain's own. `channels` are the gains and the noise that
    the solver has estimated; with None the recorded pressures are used. Raises InputError if the microphones cannot
    carry one of `modes`.
    """
    moved = _on_the_page(problem, positions, n, modes, order_offset, channels)
    return moved.maps(modes, search) / moved.power(modes)


@dataclass(frozen=True)
class CostVolume:
    """The cost of moving one microphone through a domain of three dimensions, for evaluation on any lattice."""

    domain: Search
    modes: tuple[NodeTerms, ...]
    power: float  # power of the pressures of all these modes, by which the cost is divided

    def on(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, cancelled: Callable[[], bool] = lambda: False
    ) -> np.ndarray | None:
        """Return the cost at all points (x, y, z) of a lattice, metres : (nz, ny, nx).

        `cancelled` is called before each mode; if it returns True, the result is None.
        """
        places = [np.atleast_1d(np.asarray(axis, float)) for axis in (x, y, z)]

        @functools.cache
        def onto(counts: tuple[int, ...]) -> list[np.ndarray]:
            return [_from_nodes(self.domain, *one) for one in zip(places, range(3), counts, strict=True)]

        total = np.zeros([len(axis) for axis in places[::-1]])
        for terms in self.modes:
            if cancelled():
                return None
            total += terms.on(onto(terms.counts))
        return total / self.power


def cost_volume(
    problem: Problem, positions: Reals, n: int, modes: Sequence[int], order_offset: int,
    channels: ChannelCorrection | None = None, cancelled: Callable[[], bool] = lambda: False,
    negligible: float = VOLUME_NEGLIGIBLE,
) -> CostVolume | None:  # fmt: skip
    """Return the cost of `eq7_maps`, summed over `modes`, with microphone `n` anywhere in the search domain.

    The result is None if `cancelled` returns True before the end. Chebyshev coefficients below `negligible` are
    omitted; a larger value saves time. Raises InputError for an array in a plane.
    """
    moved = _on_the_page(problem, positions, n, modes, order_offset, channels)
    if len(moved.domain.origin) != 3 or len(moved.centre) != 3:
        raise InputError("the array is in a plane", "use a map of two dimensions", key="dimension")
    found: list[NodeTerms] = []
    for _, terms in moved.at_nodes(modes, 3, negligible):
        if cancelled():
            return None
        found.append(terms)
    return CostVolume(moved.domain, tuple(found), moved.power(modes))


def descent_maps(
    problem: Problem, positions: Reals, n: int, modes: Sequence[int], order_offset: int, known_weight: float = 1.0,
    centre: Reals | None = None, search: Search | None = None,
) -> np.ndarray:  # fmt: skip
    """Return the cost that a step of "descent" on microphone `n` minimises, for each of `modes` : (P, ny, nx).

    `modes` count from 1. The squared residuals of known microphones have the weight `known_weight`. The expansion is
    about `centre` (D,), metres, by default the point of the search lattice that is nearest to the centroid of the
    microphones. `search` is as in `eq7_maps`.
    """
    eq7.require_carried(problem, modes, order_offset)
    x, domain = np.asarray(positions, float), eq7.search_domain(problem)
    scale = np.sqrt(eq7.known_weights(problem, known_weight))
    scale[n] = 1.0  # even if this microphone is known, because here it is moved
    if centre is None:
        centre = domain.nearest(x.mean(axis=0))
    expansion, pressures = eq7.expansion_of(problem, order_offset), scale * problem.pressures
    return MovedMicrophone(problem, expansion, x, n, np.asarray(centre), pressures, scale).maps(modes, search)


# The likelihood with one microphone moved.


def likelihood_maps(
    problem: Problem, positions: Reals, n: int, modes: slice, noise: Reals, search: Search | None = None
):
    """Return the cost of every mode with microphone `n` moved : (modes, ny, nx) float64.

    It is the cost of `fdcal.cost.likelihood` minus N log v, for real wavenumbers and a diffuse field. With s and v the
    power of field and noise, and V = 1 + h,

        cost(x) = log det (C_-n / v) + p_-n^H C_-n^-1 p_-n + log V + |p_n - f|^2 / (v V).

    `noise` (modes,) is v, in the unit of abs(pressures)**2. The maps are exact if v is at least 1e-6 of the power.
    Raises LinAlgError for positions that are not finite.
    """
    x, domain = np.ascontiguousarray(positions, float), eq7.search_domain(problem)
    if not np.isfinite(x).all():
        raise np.linalg.LinAlgError("positions are not finite")
    p, others = problem.pressures[modes], np.delete(x, n, axis=0)
    field = isotropic_field(p, problem.wavenumbers[modes], noise, problem.dimension)
    between = np.linalg.norm(others[:, None] - others, axis=-1)

    @functools.cache
    def to_nodes(counts: tuple[int, ...]) -> Reals:
        return np.linalg.norm(others[:, None] - node_points(domain, counts, x[n, 2:]), axis=-1)

    maps: list[np.ndarray] = []
    for m, (k, s, v) in enumerate(zip(field.wavenumbers.tolist(), field.power, field.noise, strict=True)):
        counts, rest = node_counts(domain, k), np.delete(p[m], n)
        # With C_-n = G G^T, c the covariance between the others and a node, and t = G^-1 c, the prediction is
        # f = t^T G^-1 p_-n, and the variance of its error is v V = s + v - |t|^2.
        G = np.linalg.cholesky(s * diffuse_correlation(k * between, problem.dimension) + v * np.eye(len(rest)))
        inverse: Reals = solve_triangular(G, np.eye(len(G)), lower=True, check_finite=False)
        y = inverse @ rest
        t = (s * inverse) @ diffuse_correlation(k * to_nodes(counts), problem.dimension)
        constant = 2 * np.log(np.diagonal(G)).sum() - len(rest) * np.log(v) + np.vdot(y, y).real
        h, f = (s - np.einsum("ij,ij->j", t, t)) / v, y @ t
        onto = _onto_lattice(domain, domain if search is None else search, counts)
        h, re, im = _interpolated(_stacked(h, f, counts), onto)
        error = (p[m, n].real - re) ** 2 + (p[m, n].imag - im) ** 2
        maps.append(constant + np.log1p(h) + error / (v * (1.0 + h)))
    return np.stack(maps)


# What the page shows.


class HasLandscape(Protocol):
    """The part of a solver that maps need: its traits and the cost that it minimises."""

    TRAITS: Any

    def landscape(self, problem: Problem, state: Any, n: int, modes: slice, search: Search | None, /) -> np.ndarray: ...


def cost_maps(
    problem: Problem, solver: HasLandscape, state: SolverState, n: int, modes: Sequence[int], order_offset: int | None,
    search: Search | None = None,
) -> np.ndarray:  # fmt: skip
    """Return the cost of each of `modes`, counted from 1, with microphone `n` moved : (P, ny, nx).

    With `order_offset`, the cost is Eq. 7 at the fixed orders ceil(k R) + `order_offset`; if that is None, it is the
    cost that the solver minimises. Eq. 7 is relative to the power of all `modes`.
    """
    if order_offset is not None:
        return eq7_maps(problem, state.positions, n, modes, order_offset, search, state.channels)
    low, power = min(modes), mode_powers(problem, solver, state, modes, order_offset)
    cost = solver.landscape(problem, state, n, slice(low - 1, max(modes)), search)[np.asarray(modes) - low]
    return cost if power is None else cost / power.sum()


def mode_powers(
    problem: Problem, solver: HasLandscape, state: Any, modes: Sequence[int], order_offset: int | None
) -> Reals | None:
    """Return the power (P,) of `modes`, by whose sum a map of Eq. 7 is divided; None for a map of a likelihood.

    Without `order_offset` the map is that of the solver. A solver that moves one microphone at a time also minimises
    Eq. 7, with a weight for known microphones.
    """
    if order_offset is None and solver.TRAITS.moves_all:
        return None
    pressures, _ = equalised(problem.pressures[np.asarray(modes) - 1], state.channels)
    weights = 1.0 if order_offset is not None else eq7.known_weights(problem, state.settings.known_weight)
    return np.sum(weights * np.abs(pressures) ** 2, axis=1)


@dataclass(frozen=True)
class PartialSum:
    """The map of the modes that have been added so far."""

    modes: tuple[int, ...]  # in the order in which they were added, counted from 1
    cost: Reals  # (ny, nx) float64; Eq. 7 is relative to the power of these modes
    minima: Minima


def partial_sums(
    problem: Problem, solver: HasLandscape, state: SolverState, n: int, modes: Sequence[int], order_offset: int | None,
    search: Search | None = None, counts: Sequence[int] | None = None,
) -> Iterator[PartialSum]:  # fmt: skip
    """Yield the map of the first of `modes`, then of the first two, and so on up to all P of them.

    Each step only computes the map of one mode. Parameters are as in `cost_maps`, with which each sum agrees. `counts`,
    ascending, are the numbers of modes whose sums are yielded, by default 1 to P.
    """
    search = eq7.search_domain(problem) if search is None else search
    modes, counts = tuple(modes), range(1, len(modes) + 1) if counts is None else counts
    powers = mode_powers(problem, solver, state, modes, order_offset)
    weights = np.ones(len(modes)) if powers is None else powers / powers.sum()
    total, power = np.zeros(1), 0.0
    for i, mode in enumerate(modes):
        total = total + weights[i] * cost_maps(problem, solver, state, n, (mode,), order_offset, search)[0]
        power += weights[i]
        if i + 1 in counts:
            cost = total if powers is None else total / power
            yield PartialSum(modes[: i + 1], cost, minima_of(cost, search))


def map_minima(
    problem: Problem, solver: HasLandscape, state: SolverState, n: int, modes: Sequence[int], order_offset: int | None,
    cost: Reals, search: Search,
) -> Minima:  # fmt: skip
    """Return the marks on a map of `cost_maps` that is summed over `modes`; they hardly depend on its lattice.

    `cost` (ny, nx) float64 is the map on the lattice `search`. For few modes the map is computed again on a fine
    lattice, whose minima are returned.
    """
    lattice = lattice_of(problem, modes)
    if max(lattice.shape[:2]) > max(search.shape[:2]):
        search, cost = lattice, cost_maps(problem, solver, state, n, modes, order_offset, lattice).sum(axis=0)
    return minima_of(cost, search)


def lattice_of(problem: Problem, modes: Sequence[int]) -> Search:
    """Return a lattice that resolves the minima of a sum of modes: a fine one for few modes, else the domain's own."""
    domain = eq7.search_domain(problem)
    return refined(domain) if len(modes) <= FEW_MODES else domain


def minima_of(cost: Reals, search: Search) -> Minima:
    """Return the marks on a map (ny, nx) or volume (nz, ny, nx) over the lattice `search`."""
    from .basins import basins_of  # imported here: it loads the compiler, which the first picture does not need

    values, found = on_scale(cost), basins_of(cost).minima
    lowest = np.array(np.unravel_index(values.argmin(), values.shape))[None]
    found = found[(found != lowest).any(axis=1)]
    fits = values[tuple(found.T)] <= values.min() + DEPTH
    inside = (lowest[0] > 0) & (lowest[0] < np.array(values.shape) - 1)
    high, count = float(np.max(cost)), len(found) + int(np.all(inside))
    end = high * 10.0**-DECADES if 0 <= np.min(cost) < high * 10.0**-DECADES else None
    marked, others = map_positions(np.concatenate([lowest, found[fits]]), search), map_positions(found[~fits], search)
    return Minima(frozen_array(marked, float), frozen_array(others, float), count, end)


def mode_shape(
    problem: Problem,
    positions: Reals,
    mode: int,
    order_offset: int,
    channels: ChannelCorrection | None = None,
    n: int | None = None,
    search: Search | None = None,
) -> tuple[np.ndarray, float]:
    """Return the pressure (ny, nx) of one mode on a lattice, and the measured pressure of microphone `n`.

    The map is reconstructed from all microphones except `n`, counted from 0. It is the real part of W alpha (Eq. 6) at
    the phase with the most power, normalised to a peak of 1. If the positions are right, it agrees with the field in
    the room between the microphones. The second value has the same scale; it is NaN if `n` is None. `mode` counts from
    1; `search` is the lattice, by default that of the problem. Raises InputError in three dimensions, without a search
    domain, or with fewer than two microphones besides `n`.
    """
    search = problem.search if search is None else search
    others = np.flatnonzero(np.arange(len(positions)) != n)
    if problem.dimension != 2 or search is None or len(others) < 2:
        fault = "the shape of a mode needs a two-dimensional field, a search domain and two other microphones"
        raise InputError(fault, "give <search> and <radius>, or more microphones", key="search")
    positions, k = np.asarray(positions, float), complex(problem.wavenumbers[mode - 1])
    # the number of functions, 2L + 1, must be below that of the microphones (Eq. 8)
    L = min(int(max_order(k, search.radius, order_offset)), (len(others) - 2) // 2)
    centre = positions[others].mean(axis=0)
    p, scale = equalised(problem.pressures[mode - 1], channels)
    alpha = eq7.coefficients(scale[others, None] * fourier_bessel(positions[others], k, L, centre), p[others])
    points = search.layer()
    field = fourier_bessel(points.reshape(-1, 2), k, L, centre) @ alpha
    turn = np.exp(-0.5j * np.angle(np.sum(field**2)))
    field = np.real(field * turn)
    peak = field[np.abs(field).argmax()]
    level = np.nan if n is None else float(np.real(p[n] / scale[n] * turn) / peak)
    return (field / peak).reshape(points.shape[:2]), level


def refined(search: Search, count: int = FINE) -> Search:
    """Return a finer lattice over the same area, including edge cells, with `count` points along the longer edge.

    In space it has two layers, of which a map uses the lower one.
    """
    step = search.step * max(search.shape[:2]) / count
    corner = np.subtract(search.origin[:2], search.step / 2)
    numbers = [max(round(search.step * n / step), 2) for n in search.shape[:2]]
    origin = (*(float(x) for x in corner + step / 2), *search.origin[2:])
    size = (*((n - 1) * step for n in numbers), *(step for _ in search.origin[2:]))
    return replace(search, origin=origin, size=size, step=step)


def map_positions(indices: ArrayLike, search: Search) -> np.ndarray:
    """Return the positions (K, D), metres, of points of a lattice with the indices (K, D): [layer,] row and column."""
    places = np.asarray(indices)[:, ::-1]
    return np.asarray(search.origin)[: places.shape[1]] + search.step * places


def interpolate(cost: np.ndarray, search: Search, point: ArrayLike) -> float:
    """Return the value of a map (ny, nx) at a point (2,) or (3,), metres, by bilinear interpolation.

    Outside the lattice it is the value at the nearest point of the edge.
    """
    place = (np.asarray(point, float)[:2] - search.origin[:2]) / search.step
    return float(map_coordinates(cost, place[::-1, None], order=1, mode="nearest")[0])


# The paper's Fig. 1 as numbers.


@dataclass(frozen=True)
class LandscapePanels:
    """Landscapes of one microphone.

    Attributes
    ----------
    microphone : int
        Number of the microphone, from 0.
    modes : (P,) int64
        Modes that have a map, counted from 1.
    frequencies : (P,) float64
        Their frequencies, Hz.
    maps : (P + 1, ny, nx) float64
        One map for each mode, then that of the sum, dimensionless. Row 0 has the lowest y.
    minima : (P + 1, 2) float64
        Position of the lowest point of each map, metres.
    search : Search
        Lattice of the maps.
    mode_count : int
        Number of modes in the sum, which may be more than have a map.
    marks : tuple of Minima
        The lowest costs and the other local minima of each map.
    """

    microphone: int
    modes: np.ndarray
    frequencies: np.ndarray
    maps: np.ndarray
    minima: np.ndarray
    search: Search
    mode_count: int
    marks: tuple[Minima, ...]

    plot: ClassVar[Callable[..., Any]]  # draws a figure; `fdcal.METHODS` binds it


def landscape_panels(problem: Problem, positions, n: int, modes: Sequence[int], order_offset: int) -> LandscapePanels:
    """Return the cost of Eq. 7 over the search lattice with microphone `n` moved and the others at `positions`.

    `modes` count from 1; `order_offset` is added to the order of Eq. 3. Raises InputError for a field of three
    dimensions or without a search domain, or if the microphones cannot carry one of the modes.
    """
    eq7.require_plane_field(problem)
    if problem.search is not None:
        eq7.require_modes(problem, order_offset, max(modes))
    maps, search = descent_maps(problem, positions, n, modes, order_offset), eq7.search_domain(problem)
    fine, marks, total = refined(search), [], np.zeros(1)
    for mode in modes:  # the minima of a single mode need a fine lattice (FEW_MODES)
        cost = descent_maps(problem, positions, n, (mode,), order_offset, search=fine)[0]
        marks.append(minima_of(cost, fine))
        total = total + cost
    marks.append(minima_of(total, fine))
    return panels_of(maps, maps.sum(axis=0), modes, problem.frequencies, n, search, len(modes), marks)


def panels_of(
    maps, total, modes: Sequence[int], frequencies, n: int, search: Search, count: int,
    marks: Sequence[Minima] | None = None,
) -> LandscapePanels:  # fmt: skip
    """Return the panels of given maps, with that of the sum as the last.

    `maps` (P, ny, nx) are those of `modes`, counted from 1; `total` (ny, nx) is the sum over `count` modes. `marks` are
    those of the maps and of the sum; by default they are found on the lattice of the maps.
    """
    drawn = np.concatenate([np.asarray(maps, float), np.asarray(total, float)[None]])
    lowest = np.column_stack(np.divmod(drawn.reshape(len(drawn), -1).argmin(axis=1), drawn.shape[2]))
    return LandscapePanels(
        microphone=n,
        modes=frozen_array(modes, np.int64),
        frequencies=frozen_array(np.asarray(frequencies)[np.asarray(modes) - 1], float),
        maps=frozen_array(drawn, float),
        minima=frozen_array(map_positions(lowest, search), float),
        search=search,
        mode_count=count,
        marks=tuple(minima_of(cost, search) for cost in drawn) if marks is None else tuple(marks),
    )
