"""The likelihood of one microphone over the search lattice, mode by mode, fast enough for interactive display.

The cost of `fdcal.cost.leave_one_out.likelihood_landscape`, for real wavenumbers and a diffuse field: with microphone
n at x

    cost(x) = log det (C_-n / v) + p_-n^H C_-n^-1 p_-n + log V + |p_n - f|^2 / (v V)

    f       prediction of the pressure at x by the others
    V       1 + h, the variance of the prediction's error, over v
    in two dimensions, with A = W^T W + mu I = G G^T over the other microphones, mu = v / s and the order ample,
            f = w A^-1 W^T p_-n, h = |G^-1 w|^2, w the dictionary's row at x: O(L^2) per point
    in three, and for a very wide array, with C_-n = G G^T and t = G^-1 c: f = t^T G^-1 p_-n, v V = s + v - |t|^2

A lattice is far finer than the field. f has no wavenumber above k and h none above 2 k, so that both are computed at
the Chebyshev nodes of a few dozen degrees and interpolated onto the lattice, exact to rounding errors. The logarithm
and the quotient of V are taken after that.

s, v      power of the field and of the noise
W         `fdcal.cost.circular_waves.circular_dictionary` about the middle of the search domain: real, one table
          per mode for all maps
nodes     Chebyshev nodes of the horizontal layer that the map shows
"""

from __future__ import annotations

import functools

import numpy as np
from scipy.linalg import solve_triangular

from ..acoustics.fourier_bessel import max_order
from ..model.problem import Problem
from ..model.settings import Search
from ..model.validation import InputError
from .circular_waves import circular_dictionary
from .likelihood import DiffuseField, diffuse_field, kernel
from .map_nodes import area, from_nodes, node_counts, node_points

EXTRA_ORDERS = 12  # beyond ceil(k R): the rest of the kernel is below 1e-13
MOST_FUNCTIONS = 4  # times the number of microphones: with more functions the kernel is cheaper


def likelihood_maps(problem: Problem, positions, n: int, modes: slice, noise, search: Search | None = None):
    """Return the cost of every mode with microphone `n` moved over the horizontal layer at its own height.

    Parameters
    ----------
    positions : (N, D) float64, metres
    noise : (modes,) float64, v, in the unit of abs(pressures)**2; from 1e-6 of the power the maps are exact
    search : lattice within the area of the problem's search domain; that domain's own unless given

    Returns
    -------
    (modes, ny, nx) float64

    Raises
    ------
    InputError
        The problem has no search domain.
    numpy.linalg.LinAlgError
        A position is not finite.
    """
    x = np.ascontiguousarray(positions, float)
    domain = _domain(problem)
    search = domain if search is None else search
    p = problem.pressures[modes]
    field = diffuse_field(p, problem.wavenumbers[modes], noise, problem.dimension)
    maps = np.empty((len(p), *search.shape[1::-1]))
    for m, (constant, counts, h, f) in enumerate(_predictions(problem, x, n, modes, p, field)):
        x_map, y_map = (from_nodes(domain, search, axis, count) for axis, count in enumerate(counts))
        parts = np.stack([h, f.real, f.imag]).reshape(3, *counts[::-1])
        h, re, im = y_map @ (parts @ x_map.T)
        V = 1.0 + np.maximum(h, 0.0)
        error = (p[m, n].real - re) ** 2 + (p[m, n].imag - im) ** 2
        maps[m] = constant + np.log(V) + error / (field.noise[m] * V)
    return maps


def _domain(problem: Problem) -> Search:
    if problem.search is None:
        raise InputError("the measurement has no search domain", "give <search> and <radius>", key="search")
    return problem.search


def _predictions(problem: Problem, x, n: int, modes: slice, p, field: DiffuseField):
    """Yield of every mode the constant of the cost, the numbers of nodes along x and y, and h and f at the nodes."""
    others, search = np.arange(len(x)) != n, _domain(problem)
    reach = _reach(search, x[others])
    if not np.isfinite(reach):
        raise np.linalg.LinAlgError("positions are not finite")
    furthest = float(field.wavenumbers.max(initial=0.0)) * reach  # k r in radians
    few = problem.dimension == 2 and 2 * (furthest + EXTRA_ORDERS) + 1 <= MOST_FUNCTIONS * len(x)
    orders = max_order(field.wavenumbers, reach if few else 0.0, EXTRA_ORDERS)
    tables, near = _tables(problem), _Distances(search, x[others], x[n])
    for m, mode in enumerate(range(len(problem.pressures))[modes]):
        k, s, v = field.wavenumbers[m], field.power[m], field.noise[m]
        counts = node_counts(search, float(k))
        if few:
            rows = _kept_rows(tables, search, mode, float(k), int(orders[m]))
            W = circular_dictionary(x[others], float(k), int(orders[m]), _middle(search))
            constant, h, f = _expansion_fit(W, rows, p[m, others], s, v)
        else:
            constant, h, f = _kernel_fit(near.between, near.to_nodes(counts), p[m, others], k, s, v, problem.dimension)
        yield constant, counts, h, f


def _expansion_fit(W, rows, p, s: float, v: float):
    """Return the constant, h and f at the candidates whose rows of the dictionary are `rows` (C, K)."""
    mu = v / s
    G = np.linalg.cholesky(W.T @ W + mu * np.eye(W.shape[1]))
    inverse = solve_triangular(G, np.eye(len(G)), lower=True, check_finite=False)
    a = inverse @ (W.T @ p)
    alpha = inverse.T @ a
    r0 = np.vdot(p, p - W @ alpha).real
    constant = 2 * np.log(np.diagonal(G)).sum() - len(G) * np.log(mu) + r0 / v
    t = rows @ inverse.T
    return constant, np.einsum("ij,ij->i", t, t), rows @ alpha


def _kernel_fit(between, to_candidates, p, k: float, s: float, v: float, dimension: int):
    """Return the same from distances, metres: `between` the others, and (N - 1, C) from them to the candidates."""
    G = np.linalg.cholesky(s * kernel(k * between, dimension) + v * np.eye(len(p)))
    inverse = solve_triangular(G, np.eye(len(G)), lower=True, check_finite=False)
    y = inverse @ p
    t = (s * inverse) @ kernel(k * to_candidates, dimension)
    constant = 2 * np.log(np.diagonal(G)).sum() - len(p) * np.log(v) + np.vdot(y, y).real
    return constant, (s - np.einsum("ij,ij->j", t, t)) / v, y @ t


class _Distances:
    """Distances between the other microphones, and from them to the nodes at the moved one's height, metres."""

    def __init__(self, search: Search, others, moved):
        self._search, self._others, self._height, self._known = search, others, moved[2:], {}
        self.between = _distances(others, others)

    def to_nodes(self, counts) -> np.ndarray:
        """Return (N - 1, C) float64 for `counts` nodes along x and y."""
        if counts not in self._known:
            x = node_points(self._search, counts)
            x = np.concatenate([x, np.tile(self._height, (len(x), 1))], axis=1)
            self._known[counts] = _distances(self._others, x)
        return self._known[counts]


def _distances(a, b) -> np.ndarray:
    return np.sqrt(sum(np.subtract.outer(a[:, axis], b[:, axis]) ** 2 for axis in range(a.shape[1])))


def _middle(search: Search) -> np.ndarray:
    """Return the centre of the expansion, (2,) metres, off every node and every microphone of a regular array."""
    low, high = area(search)
    return (low + high) / 2 + 1e-3 * search.step * np.array([0.61, 0.37])


def _reach(search: Search, others) -> float:
    """Return the distance from the middle to the furthest corner or microphone, metres."""
    low, high = area(search)
    away = np.linalg.norm(others[:, :2] - _middle(search), axis=1)
    return float(np.maximum(away.max(initial=0.0), np.linalg.norm(high - low) / 2 + search.step))


@functools.lru_cache(maxsize=2)
def _tables(problem: Problem) -> dict[int, np.ndarray]:
    """Return the cache of one problem: rows of the dictionary at the nodes, by mode. Filled by `_kept_rows`."""
    return {}


def _kept_rows(tables, search: Search, mode: int, k: float, order: int) -> np.ndarray:
    """Return the rows (C, 2L + 1) of the dictionary at the nodes; computed again only for a higher order."""
    rows = tables.get(mode)
    if rows is None or rows.shape[1] < 2 * order + 1:
        rows = circular_dictionary(node_points(search, node_counts(search, k)), k, order, _middle(search))
        tables[mode] = rows
    return rows[:, : 2 * order + 1]
