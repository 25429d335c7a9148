"""The waves that make up a sound field over an array: circular waves about a centre, and plane waves.

circular   J_0, sqrt(2) J_l cos(l theta), sqrt(2) J_l sin(l theta): the columns of Eq. 4 after a unitary map, which
           leaves W W^H unchanged, and real for a real wavenumber
plane      sqrt(w_q S_q) exp(-j k x . u_q), directions u_q of a quadrature of the circle or the sphere, power S_q

With an ample order, or enough directions of equal power, W W^H is the covariance of a diffuse field of unit power,
J_0(k r) or sin(k r) / (k r). Matrices are kept transposed, (modes, waves, microphones): the microphones are next to
each other in memory.
"""

from __future__ import annotations

import functools

import numpy as np
from scipy.special import hankel1, spherical_jn, spherical_yn

from ..acoustics.dictionary import max_order
from ..acoustics.special_functions import bessel, cosine_and_sine
from ..model.validation import frozen_array

EXTRA_ORDERS = 8  # beyond ceil(k R) about the centre of mass: the rest of W W^H is below 1e-9
NEAR_FIELD_ORDERS = 16  # the same with near sources: the rest of the power of one at 1.75 R is below 1e-10
DIRECTION_ORDERS = 6  # beyond ceil(k R), that plane waves must resolve
SOURCE_DISTANCE = 1.5  # times R: nearest source that the near-field gains allow for
# degrees of Lebedev's rules without a negative weight
DEGREES = (3, 5, 7, 9, 11, 15, 17, 19, 21, 23, 29, 31, 35, 41, 47, 53, 59, 65, 71, 77, 83, 89, 95, 101, 107, 113, 119,
           125, 131)  # fmt: skip


def expansion_about(x, k, dimension: int, near: bool, about=None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the centre (D,), the order L (M,) of every mode and the gain of every order (M, L + 1).

    x : (N, D) float64, metres; k : (M,) rad/m; about : (N, D) positions that give centre and extent, `x` unless given.
    A source close to the array excites high orders more than a diffuse field does, by |H_l(k rho)|, rho its distance.
    With `near` the waves have that gain where it is above 1, for rho = SOURCE_DISTANCE R.
    """
    about = x if about is None else about
    centre = about.mean(axis=0)
    reach = float(np.linalg.norm(about - centre, axis=1).max())
    centre = centre + 1e-3 * reach * np.array([0.61, 0.37, 0.7])[: len(centre)]  # no microphone stands on the centre
    farthest = float(np.linalg.norm(x - centre, axis=1).max())
    if not np.isfinite(farthest):
        raise np.linalg.LinAlgError("positions are not finite")
    orders = np.asarray(max_order(k, farthest, NEAR_FIELD_ORDERS if near else EXTRA_ORDERS))
    gains = np.ones((len(k), int(orders.max()) + 1))
    if near and reach > 0:
        z = np.real(k) * SOURCE_DISTANCE * reach
        gains = _loudness(tuple(z.tolist()), gains.shape[1], dimension)
    return centre, orders, gains


@functools.lru_cache(maxsize=4)
def _loudness(z: tuple[float, ...], count: int, dimension: int) -> np.ndarray:
    """Return |h_l(z)| for l = 0..count - 1, at least 1 : (M, count) float64, read-only; trials of a step share it."""
    l, column = np.arange(count), np.array(z)[:, None]  # noqa: E741
    loud = np.abs(hankel1(l, column)) if dimension == 2 else np.hypot(spherical_jn(l, column), spherical_yn(l, column))
    return frozen_array(np.clip(loud, 1.0, 1e100), float)


def circular_waves(x, centre, k, orders, gains, slopes: bool) -> tuple[np.ndarray, np.ndarray | None]:
    """Return W (M, 2L + 1, N), of the type of `k`, and its derivatives along x and y (2, M, 2L + 1, N), 1/m, or None.

    x : (N, 2) and centre (2,) float64, metres; k : (M,) rad/m; orders : (M,) int, columns of higher orders are zero;
    gains : (M, L + 1) float64, factor of every order
    """
    L, offsets = int(np.max(orders, initial=0)), x - centre
    r = np.hypot(offsets[:, 0], offsets[:, 1])
    J = bessel(np.multiply.outer(k, r), L + 1)
    towards = np.where(r > 0, (offsets[:, 0] + 1j * offsets[:, 1]) / np.maximum(r, np.finfo(float).tiny), 1.0)
    phases = np.empty((L + 2, len(r)), complex)  # exp(j l theta); theta = 0 at the centre
    phases[0], phases[1:] = 1.0, towards
    phases = np.cumprod(phases, axis=0)[:, None]
    C, S = J * phases.real.copy(), J * phases.imag.copy()
    factor = np.where(np.arange(L + 1) <= np.asarray(orders)[:, None], gains[:, : L + 1], 0.0)
    factor[:, 1:] *= np.sqrt(2.0)
    W = np.empty((len(k), 2 * L + 1, len(x)), J.dtype)
    np.multiply(C[: L + 1].swapaxes(0, 1), factor[:, :, None], out=W[:, : L + 1])
    np.multiply(S[1 : L + 1].swapaxes(0, 1), factor[:, 1:, None], out=W[:, L + 1 :])
    return W, (_circular_slopes(C, S, factor * np.asarray(k)[:, None] / 2) if slopes else None)


def _circular_slopes(C, S, half) -> np.ndarray:
    """dW from J_l cos(l theta) and J_l sin(l theta), l = 0..L+1; `half` (M, L + 1) is k / 2 times the factor."""
    C, S = C.swapaxes(0, 1), S.swapaxes(0, 1)
    L, half = half.shape[1] - 1, half[:, :, None]
    dW = np.empty((2, len(C), 2 * L + 1, C.shape[2]), C.dtype)
    for a, zero in enumerate((C, S)):
        np.multiply(zero[:, 1], -2 * half[:, 0], out=dW[a, :, 0])
        cosine, sine = dW[a, :, 1 : L + 1], dW[a, :, L + 1 :]
        if a == 0:
            np.subtract(C[:, :L], C[:, 2:], out=cosine)
            np.subtract(S[:, :L], S[:, 2:], out=sine)
        else:
            np.negative(np.add(S[:, :L], S[:, 2:], out=cosine), out=cosine)
            np.add(C[:, :L], C[:, 2:], out=sine)
        cosine *= half[:, 1:]
        sine *= half[:, 1:]
    return dW


def circular_dictionary(points, k, order: int, centre) -> np.ndarray:
    """Return W (N, 2L + 1) of one mode at `points` (N, 2), real for a real k; W W^H is that of Eq. 4.

    Cosine and sine of an order stand side by side, so that the first columns are the dictionary of a lower order.
    """
    W, _ = circular_waves(
        np.asarray(points, float), np.asarray(centre), np.array([k]), [order], np.ones((1, order + 1)), False
    )
    out = np.empty(W.shape[:0:-1], W.dtype)
    out[:, 0], out[:, 1::2], out[:, 2::2] = W[0, 0], W[0, 1 : order + 1].T, W[0, order + 1 :].T
    return out


def direction_count(dimension: int, order: int) -> int:
    """Return how many directions resolve fields of that order in two or three dimensions."""
    if dimension == 2:
        return 2 * order
    return len(_sphere(next((degree for degree in DEGREES if degree >= 2 * order), DEGREES[-1]))[1])


def directions_needed(positions, wavenumbers, dimension: int) -> int:
    """Return how many directions resolve a field over the array; positions (N, D), metres, wavenumbers (M,), rad/m."""
    reach = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
    return direction_count(dimension, int(np.ceil(np.real(wavenumbers).max() * reach)) + DIRECTION_ORDERS)


@functools.cache
def wave_directions(dimension: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return unit vectors (D, Q) and weights (Q,) of sum 1, for a number that `direction_count` returns.

    kappa(k |x - y|) = sum_q w_q exp(-j k (x - y) . u_q) for arrays of k R below the order: equally spaced directions in
    the plane, Lebedev's rule in space (Lebedev and Laikov, Doklady Mathematics 59, 1999). Direction Q / 2 + q is
    opposite to direction q, so that a wave costs half an exponential.
    """
    if dimension == 2:
        t = 2 * np.pi * np.arange(count) / count
        return frozen_array(np.stack([np.cos(t), np.sin(t)]), float), frozen_array(np.full(count, 1 / count), float)
    return next(rule for rule in map(_sphere, DEGREES) if len(rule[1]) == count)


@functools.cache
def _sphere(degree: int) -> tuple[np.ndarray, np.ndarray]:
    from scipy.integrate import lebedev_rule  # loads scipy.optimize, which a first picture does not need

    points, weights = lebedev_rule(degree)
    points = points.round(15) + 0.0  # no coordinate of -0 or of rounding size, which would decide below
    first = np.array([u[np.flatnonzero(u)[0]] > 0 for u in points.T])  # one of each opposite pair
    half, weights = points[:, first], weights[first] / weights.sum()
    return frozen_array(np.hstack([half, -half]), float), frozen_array(np.tile(weights, 2), float)


def plane_waves(x, k, powers, slope: bool, dimension: int = 2) -> tuple[np.ndarray, np.ndarray | None]:
    """Return W (M, Q, N) complex128 and, if wanted, its derivatives (D, M, Q, N), 1/m.

    x : (N, D) float64, metres, from the centre, where a damped wave has the amplitude 1; k : (M,) rad/m;
    powers : (M, Q) float64, S, power by direction
    """
    u, w = wave_directions(dimension, powers.shape[1])
    half, W = len(w) // 2, np.empty((len(k), len(w), len(x)), complex)
    along = u[: x.shape[1], :half].T @ x.T
    W[:, :half].real, W[:, :half].imag = cosine_and_sine(np.multiply.outer(-np.real(k), along))
    np.conj(W[:, :half], out=W[:, half:])
    if np.iscomplexobj(k):
        growth = np.exp(np.multiply.outer(np.imag(k), along))
        W[:, :half] *= growth
        W[:, half:] /= growth
    W *= np.sqrt(w * powers)[..., None]
    if not slope:
        return W, None
    factor = -1j * k[:, None, None]
    dW = np.empty((x.shape[1], *W.shape), complex)
    for out, along in zip(dW, u, strict=False):  # a plane array has no third coordinate
        np.multiply(W, factor * along[:, None], out=out)
    return W, dW
