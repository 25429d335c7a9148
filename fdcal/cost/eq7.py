"""The paper's cost, Eq. 7; the computation of W for many modes; and a reference cost that compares any positions.

    W          dictionary of one mode at the estimated positions (Eq. 4)
    alpha      W^+ p, coefficients of the field (Eq. 5)
    cost       |W alpha - p|^2 (Eq. 6), summed over the modes in use (Eq. 7)
    landscape  cost as a function of the position of one microphone, with all others at their estimated positions

Leave microphone n out, and let W_-n = Q S (a QR decomposition), Z = S^-1, alpha = Z Z^H W_-n^H p_-n and
r0 = |p_-n - W_-n alpha|^2. With w(x) the row of W at x, the cost with microphone n at x is

    cost(x) = r0 + |p_n - f(x)|^2 / (1 + h(x)),    f = w(x) alpha,    h = |w(x) Z|^2.

This equals Eq. 7 if W_-n has full column rank. Otherwise W_-n is reduced to its column space, once for all candidates.
The centre of the expansion is the same for all candidates. Every search and every map uses this formula: solver
"descent" evaluates it in compiled loops (`fdcal.cost.lattice`), and maps interpolate f and h (`fdcal.cost.maps`).

`FieldExpansion` computes rows of W for many modes and points together, about a centre that may differ in every call.
The functions of order l are

    2-D             J_l(k r) exp(j l theta)            = c_l g_l(k r) (x + j y)^l
    3-D             j_l(k r) Y_lm(theta, phi)          = c_l g_l(k r) r^l Y_lm(theta, phi), l + m even in a plane

The function g_l(z) = J_l(z) l! (2 / z)^l, or j_l(z) (2 l + 1)!! / z^l, is entire and even, so that a Chebyshev series
in r^2 represents it to rounding errors. The constants c_l are omitted, since Eq. 7 only depends on the column space
of W.

The microphones can carry a mode if its expansion has fewer functions than there are microphones: in a plane
2L + 1 < N (Eq. 8). With as many functions or more, the residual of a mode is zero at nearly all positions, and Eq. 7
does not constrain them.

The reference cost is Eq. 7, summed over all modes that the microphones can carry and divided by the power of the
pressures of these modes, in decibels.
The solvers minimise different costs, which cannot be compared with each other; the reference cost is the same function
for all solvers, because the order of each mode is fixed and every microphone has the weight 1. It is 0 dB if the
positions explain nothing, and falls as the positions improve, down to the noise or the truncation error of the
expansion. Rotations, translations and mirror images do not change it.

If the solver estimates the channels, the pressures are divided by their gains, and each channel has the weight
1 / noise. Without this correction one inverted or dead channel would dominate the cost.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import ArrayLike
from scipy.special import factorial, factorial2

from ..acoustics.dictionary import bessel, harmonics, max_order
from ..model.problem import ChannelCorrection, Problem, SolverState, equalised
from ..model.settings import Search
from ..model.validation import Complexes, InputError, Integers

RANK_TOLERANCE = 1e-12  # singular values below this fraction of the largest one are treated as zero


def coefficients(W: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return alpha = W^+ p (Eq. 5) : (2L + 1,) complex128, from W (N, 2L + 1) and p (N,)."""
    return fit(W[None], p[None])[1][0]


@dataclass(frozen=True)
class LeaveOneOutFit:
    """The fit of one mode to all microphones except one, with the symbols of the module's docstring."""

    Z: Complexes  # (K, K) complex128; Z Z^H is the inverse of W_-n^H W_-n; K is the number of functions
    alpha: Complexes  # (K,) complex128, coefficients in the unit of the pressures
    r0: float  # squared residual of the other microphones
    p_n: complex  # pressure of the microphone that is left out

    def terms(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return h (C,) float64 and f (C,) complex128 at candidates whose rows of W are `rows` (C, K)."""
        product = rows @ np.column_stack([self.Z, self.alpha])
        parts = product.view(float)[:, :-2]
        return np.einsum("ij,ij->i", parts, parts), product[:, -1]

    def cost(self, h: np.ndarray, re: np.ndarray, im: np.ndarray) -> np.ndarray:
        """Return the cost for given h and f = re + j im, of any shape : float64 of that shape."""
        return self.r0 + ((self.p_n.real - re) ** 2 + (self.p_n.imag - im) ** 2) / (1 + h)

    def cost_of(self, rows: np.ndarray) -> np.ndarray:
        """Return the cost (C,) with the left-out microphone at candidates whose rows of W are `rows` (C, K)."""
        h, f = self.terms(rows)
        return self.cost(h, np.real(f), np.imag(f))


def leave_one_out_fits(
    dictionaries: Sequence[Complexes], pressures: np.ndarray, n: int, weights: np.ndarray | None = None
) -> list[LeaveOneOutFit]:
    """Return the fit of every mode to all microphones except `n`, from M dictionaries (N, K) and pressures (M, N).

    `weights` (N,) multiply the squared residuals of the other microphones; that of microphone `n` has the weight 1.
    """
    others = np.arange(int(pressures.shape[1])) != n
    scale = np.ones(np.count_nonzero(others)) if weights is None else np.sqrt(weights[others])
    fits: dict[int, LeaveOneOutFit] = {}
    widths = np.array([W.shape[1] for W in dictionaries])
    for width in np.unique(widths):  # modes of equal order form one batch
        modes = np.flatnonzero(widths == width)
        W = np.stack([dictionaries[m][others] for m in modes.tolist()]) * scale[:, None]
        for m, Z, alpha, r0 in zip(modes.tolist(), *fit(W, pressures[modes][:, others] * scale), strict=True):
            fits[m] = LeaveOneOutFit(Z, alpha, float(r0), complex(pressures[m, n]))
    return [fits[m] for m in range(len(dictionaries))]


def fit(W: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Z (B, K, K), alpha (B, K) and r0 (B,) of a batch of modes: W (B, N, K), p (B, N).

    In the QR decomposition [W p] = Q R, the matrix R contains S, S alpha and, as its last diagonal element, the root of
    r0. If the rank of W is below K, the singular value decomposition is used instead, and the columns of Z beyond the
    rank are zero.
    """
    N, K = W.shape[1:]
    R = np.asarray(np.linalg.qr(np.concatenate([W, p[..., None]], axis=2), mode="r"))
    diagonal = np.abs(np.diagonal(R[:, :K, :K], axis1=1, axis2=2))
    deficient = (diagonal.min(axis=1) <= RANK_TOLERANCE * diagonal.max(axis=1)) | (N < K)
    S = np.where(deficient[:, None, None], np.eye(K), R[:, :K, :K] if N >= K else 0.0)
    Z = np.linalg.inv(S)
    alpha = (Z @ R[:, :K, K:])[..., 0] if N >= K else np.zeros((len(W), K), complex)
    r0 = np.abs(R[:, K, K]) ** 2 if N > K else np.zeros(len(W))
    for b in np.flatnonzero(deficient):
        U, s, Vh = np.linalg.svd(W[b], full_matrices=False)
        rank = s > RANK_TOLERANCE * s[0]
        Z[b] = 0.0
        Z[b, :, : len(s)] = Vh.conj().T * np.where(rank, 1 / np.where(rank, s, 1.0), 0.0)
        alpha[b] = Z[b, :, : len(s)] @ (U.conj().T @ p[b])
        r0[b] = np.sum(np.abs(p[b] - W[b] @ alpha[b]) ** 2)
    return Z, alpha, r0


def known_weights(problem: Problem, known_weight: float) -> np.ndarray:
    """Return weights (N,) of the squared residuals: `known_weight` for known microphones, 1 for the others."""
    weights = np.ones(problem.pressures.shape[1])
    weights[problem.known] = known_weight
    return weights


TABLE_RADIUS = 2.0  # radius of the tables, in search radii; at points beyond it the functions are evaluated directly
TERMS = 48  # number of Chebyshev coefficients before negligible ones are dropped
NEGLIGIBLE = 1e-16  # size below which Chebyshev coefficients are dropped; the functions are 1 at the centre


@dataclass(frozen=True)
class CarriedModes:
    """The modes of a problem that its microphones can carry at a fixed order, and their orders."""

    modes: Integers  # (K,) int64, counted from 0, ascending
    orders: Integers  # (K,) int64, L of each
    order_offset: int  # added to ceil(k R)


def search_domain(problem: Problem) -> Search:
    """Return the search domain of a problem; raises InputError if it has none."""
    if problem.search is None:
        raise InputError("the measurement has no search domain", "give <search> and <radius>", key="search")
    return problem.search


def functions(problem: Problem, order: Any):
    """Return the number of functions of an expansion of `order` L, an integer or an array of them.

    It is 2L + 1 in a plane, (L + 1)^2 in space, and (L + 1)(L + 2) / 2 for an array in a plane in space.
    """
    if problem.dimension == 2:
        return 2 * order + 1
    return (order + 1) ** 2 if problem.array_dimension == 3 else (order + 1) * (order + 2) // 2


def carried_modes(problem: Problem, order_offset: int) -> CarriedModes:
    """Return the modes that the microphones can carry at the order L = ceil(k R) + `order_offset`."""
    orders = np.asarray(max_order(problem.wavenumbers, search_domain(problem).radius, order_offset))
    carried = np.flatnonzero(functions(problem, orders) < problem.pressures.shape[1])
    return CarriedModes(carried, orders[carried], order_offset)


def usable_modes(problem: Problem, order_offset: int) -> int:
    """Return how many modes lie below the first that the array cannot carry; without a search domain, all modes."""
    if problem.search is None:
        return len(problem.pressures)
    carried = carried_modes(problem, order_offset).modes
    return int(np.count_nonzero(carried == np.arange(len(carried))))


def require_modes(problem: Problem, order_offset: int, count: int) -> None:
    """Raise InputError unless `count` modes were measured and the microphones can carry all of them."""
    measured, usable = len(problem.pressures), usable_modes(problem, order_offset)
    if count > measured:
        fault = f"solver.modes = {count}, but {measured} frequencies were measured"
        raise InputError(fault, f"use at most {measured}", key="modes")
    if count <= usable:
        return
    R, remedies = search_domain(problem).radius, []
    if usable:
        remedies = [f"use at most {usable} frequencies (solver.modes is {count})"]
    remedies += [f"a search.radius below {R:g} m"]
    remedies += [f"a solver.order_offset below {order_offset}"] if order_offset else []
    remedy = f"{'' if usable else 'use '}{', '.join(remedies)}, or more microphones"
    raise InputError(_not_carried(problem, usable + 1, order_offset), remedy, key="modes")


def _not_carried(problem: Problem, mode: int, order_offset: int) -> str:
    """Return a sentence that says why the microphones cannot carry the mode with number `mode`, counted from 1."""
    R = search_domain(problem).radius
    L = int(max_order(problem.wavenumbers[mode - 1], R, order_offset))
    formulas = {(2, 2): "2L + 1", (3, 3): "(L + 1)^2", (3, 2): "(L + 1)(L + 2) / 2"}  # by field and array dimension
    return (
        f"frequency {mode} at {problem.frequencies[mode - 1]:.4g} Hz has order L = ceil(k R) +"
        f" solver.order_offset = {L} with search.radius = {R:g} m and solver.order_offset = {order_offset}, that is"
        f" {formulas[problem.dimension, problem.array_dimension]} = {functions(problem, L)} functions for"
        f" {problem.pressures.shape[1]} microphones"
    )


def require_carried(problem: Problem, modes: Sequence[int], order_offset: int) -> None:
    """Raise InputError if the microphones cannot carry one of `modes`, counted from 1, at its order."""
    carried = carried_modes(problem, order_offset).modes + 1
    if lacking := sorted(set(modes) - set(carried.tolist())):
        fault = _not_carried(problem, lacking[0], order_offset)
        raise InputError(fault, "use a lower order or lower frequencies", key="order_offset")


def require_plane_field(problem: Problem) -> None:
    """Raise InputError for a field of three dimensions, for which `LatticeDictionary` has no functions."""
    if problem.dimension != 2:
        fault = "landscapes of this command need a two-dimensional field, and this one has dimension = 3"
        raise InputError(fault, "see its maps on the page: fdcal view", key="dimension")


class FieldExpansion:
    """Rows of W for the modes that the microphones can carry; the attribute `carried` holds these modes."""

    def __init__(self, problem: Problem, order_offset: int):
        self.carried = carried_modes(problem, order_offset)
        self._dimension, self._radius = problem.dimension, TABLE_RADIUS * search_domain(problem).radius
        self._k = problem.wavenumbers[self.carried.modes]
        self._tables: dict[int, np.ndarray] = {}  # by order: (terms, modes of this order, L + 1)

    def groups(self, chosen: Sequence[int] | Integers) -> list[np.ndarray]:
        """Return the modes of `chosen`, which are indices into `carried`, in groups of equal order."""
        chosen = np.asarray(chosen, np.int64)
        orders = self.carried.orders[chosen]
        return [chosen[orders == order] for order in np.unique(orders)]

    def rows(self, points: np.ndarray, centre: np.ndarray, group: np.ndarray) -> np.ndarray:
        """Return the rows of W (B, C, K) complex128 at points (C, D), metres, for a `group` of B modes of one order L.

        Each column is that of the dictionary times a constant factor.
        """
        order = int(self.carried.orders[group[0]])
        offsets = (points - centre) / self._radius
        radial = self._radial(np.einsum("cd,cd->c", offsets, offsets), order, group)
        offsets = TABLE_RADIUS * offsets
        if self._dimension == 2:  # l (K,) is the degree of each column; angular is (C, K)
            across, l = offsets[:, 0] + 1j * offsets[:, 1], np.abs(np.arange(-order, order + 1))  # noqa: E741
            powers = np.cumprod(np.column_stack([np.ones(len(across)), *[across] * order]), axis=1)
            angular = np.concatenate([powers[:, :0:-1].conj(), powers], axis=1)
        else:
            l, distance, Y = harmonics(offsets, order)  # noqa: E741
            angular = distance[:, None] ** l * Y
        return radial[:, :, l] * angular

    def _radial(self, squared: np.ndarray, order: int, group: np.ndarray) -> np.ndarray:
        """Return g_l (B, C, L + 1) at C points, from their `squared` distances (C,) in units of the tables' radius."""
        if squared.max(initial=0.0) > 1.0:
            return np.moveaxis(self._functions(np.sqrt(squared), self._k[group] * self._radius, order), 0, 1)
        alike = np.flatnonzero(self.carried.orders == order)
        if order not in self._tables:  # compute the Chebyshev coefficients of g_l : (terms, B, L + 1)
            t = np.cos(np.pi * (np.arange(TERMS) + 0.5) / TERMS)
            values = self._functions(np.sqrt((1 + t) / 2), self._k[alike] * self._radius, order)
            weights = chebvander(t, TERMS - 1).T * (2 / TERMS)
            weights[0] /= 2
            series = np.tensordot(weights, values, axes=1)
            kept = int(np.flatnonzero(np.abs(series).reshape(TERMS, -1).max(axis=1) > NEGLIGIBLE)[-1]) + 1
            self._tables[order] = np.ascontiguousarray(series[:kept])
        table = self._tables[order][:, np.searchsorted(alike, group)]
        powers = chebvander(2 * squared - 1, len(table) - 1)
        values = (powers @ table.reshape(len(table), -1).view(float)).view(complex)
        return np.moveaxis(values.reshape(len(squared), len(group), order + 1), 0, 1)

    def _functions(self, r: np.ndarray, k: np.ndarray, order: int) -> np.ndarray:
        """Return g_l(k r) : (C, B, L + 1)."""
        l = np.arange(order + 1)  # noqa: E741
        z = np.multiply.outer(np.maximum(r, 1e-3), k)  # at smaller r, g_l is constant to rounding errors
        J = np.moveaxis(bessel(z, order, spherical=self._dimension == 3), 0, -1)
        z = z[..., None]
        return J * (factorial(l) * (2 / z) ** l if self._dimension == 2 else factorial2(2 * l + 1) / z**l)


expansion_of = functools.lru_cache(maxsize=8)(FieldExpansion)  # so that all searches and maps use the same tables


# added to ceil(k R); with the paper's 0 the truncation error exceeds the effect of moving a microphone by 1 cm
ORDER_OFFSET = 2
MIN_MODES = 3  # if the microphones can carry fewer modes than this, the order is lowered
LOWEST = 1e-16  # relative cost below which all costs have the same value in decibels


def decibels(relative_cost: float) -> float:
    """Return a relative cost in decibels, at least -160 dB; NaN for NaN."""
    return float(10 * np.log10(np.maximum(relative_cost, LOWEST)))


def reference_cost_of(problem: Problem) -> ReferenceCost | None:
    """Return the reference cost of a problem; None without a search domain, or if the microphones carry no mode."""
    try:
        return ReferenceCost(problem)
    except InputError:
        return None


class ReferenceCost:
    """Eq. 7 over all modes that the microphones can carry, relative to the power of their pressures.

    `order_offset` is added to ceil(k R) in the order of every mode. If the array can then carry fewer than MIN_MODES
    modes, a lower offset is used; the attribute `order_offset` holds the value in use. The attribute `count` is the
    number of modes. Raises InputError without a search domain, or if the microphones can carry no mode.

    Examples
    --------
    >>> import fdcal
    >>> measurement = fdcal.load("tiny")
    >>> round(ReferenceCost(measurement.problem())(measurement.positions))
    -59
    """

    def __init__(self, problem: Problem, order_offset: int = ORDER_OFFSET):
        for offset in range(order_offset, -1, -1):
            self._expansion = expansion_of(problem, offset)
            if len(self._expansion.carried.modes) >= min(MIN_MODES, len(problem.pressures)):
                break
        carried = self._expansion.carried
        self.order_offset, self.count = carried.order_offset, len(carried.modes)
        if not self.count:
            fault = f"{problem.pressures.shape[1]} microphones are too few for the cost of any frequency"
            raise InputError(fault, "use a smaller <radius>, or more microphones", key="radius")
        self._groups = self._expansion.groups(np.arange(self.count))
        self._pressures = problem.pressures[carried.modes]

    def __call__(self, positions: ArrayLike, channels: ChannelCorrection | None = None) -> float:
        """Return the cost of positions (N, D), metres, in dB; NaN if a coordinate is not finite.

        channels : gains and noise of the channels, by which the pressures are corrected; None for no correction
        """
        positions = np.asarray(positions, float)
        if not np.isfinite(positions).all():
            return float("nan")
        pressures, scale = equalised(self._pressures, channels)
        residual = 0.0
        for group in self._groups:
            W = scale[:, None] * self._expansion.rows(positions, positions.mean(axis=0), group)
            residual += float(np.sum(fit(W, pressures[group])[2]))
        return decibels(residual / float(np.sum(np.abs(pressures) ** 2)))

    def of(self, state: SolverState) -> float:
        """Return the cost of a state of any solver (`RunState`), dB, with the channels that it has estimated."""
        return self(state.positions, state.channels)
