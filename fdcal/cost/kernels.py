"""The waves of a sound field over an array, the covariance that they make between microphones, and its slope.

circular   J_0, sqrt(2) J_l cos(l theta), sqrt(2) J_l sin(l theta): the columns of Eq. 4 after a unitary map, which
           leaves W W^H unchanged, and real for a real wavenumber
plane      sqrt(w_q S_q) exp(-j k x . u_q), directions u_q of a quadrature of the circle or the sphere, power S_q

With an ample order, or enough directions of equal power, W W^H is the covariance of a diffuse field of unit power,
J_0(k r) or sin(k r) / (k r). Matrices are kept transposed, (modes, waves, microphones): the microphones are next to
each other in memory. For every mode at once

    K_m[i, j]    = covariance of the field at microphones i and j
    D_ma[i, j]   = derivative of K_m[i, j] with respect to coordinate a of microphone i

`diffuse_kernel`     plane waves of a real wavenumber from everywhere: J_0(k r) in the plane, sin(k r) / (k r) in space
`series_kernel`      the same waves with a complex wavenumber, as the series W W^H about the centre of the array; with
                     `near`, columns of high order are amplified as a source close to the array does. Needed where the
                     noise is below what a real wavenumber, or a field without near sources, leaves unexplained.
`plane_wave_kernel`  waves whose power depends on their direction

For a complex k the covariance depends on the centre, and J_0(k r) is none. In space the sum over m of the series has a
closed form (addition theorem) and, without gains h_l, the one over l, too:

    K_ij = sum_l (2l + 1) h_l^2 j_l(k a_i) conj(j_l(k a_j)) P_l(cos gamma_ij)
         = sin(z) / z + sum_l (2l + 1) (h_l^2 - 1) j_l(k a_i) conj(j_l(k a_j)) P_l(cos gamma_ij)

a, gamma   distance from the centre of the expansion; angle between two microphones as seen from the centre
z          z^2 = (k x_i - conj(k) x_j)^2, x from the centre; with real k it is k times the distance

Undamped plane waves come in opposite pairs. With c = cos(k x . u_q), s = sin(k x . u_q), powers S_q and S'_q of
opposite directions and their weight w_q,

    K_ij = sum_q a_q (c_i c_j + s_i s_j) + j b_q (c_i s_j - s_i c_j),    a = w (S + S'),    b = w (S - S'),

over half the directions takes about a third of the operations of complex waves.

Many modes are computed at once, in blocks that fit the processor's cache and by batched factorisations. Which modes
share an array, and in which order sums are taken, depends on the numbers of modes and microphones alone, so that
results do not depend on the number of cores.
"""

import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import get_lapack_funcs
from scipy.special import hankel1, j0, j1, spherical_jn, spherical_yn

from ..acoustics.compiled import parallel_map
from ..acoustics.dictionary import bessel, complex_sinc, cosine_and_sine, max_order, sinc
from ..model.validation import Complexes, Integers, Numbers, Reals, frozen_array

BLOCK = 1.3e5  # numbers in the largest array of a block: about the size of the second-level cache
PARTS = 4  # of the blocks, each computed on one thread: sums do not depend on how many threads there are
FEW = 10  # rows of matrices whose inverses are faster all at once, without the half of the work that symmetry saves
WORTH_THREADS = 3e6  # numbers in all modes from which threads are faster than one core

Found = TypeVar("Found")

np.empty(2_000_000)  # freed at once: from then on the C library keeps freed blocks of this size, and reuses them


def blocks(modes: int, numbers: int) -> list[slice]:
    """Return slices of about one length that cover all modes; `numbers` are those in the largest array of one mode."""
    count = -(-modes // max(1, int(BLOCK // numbers)))
    edges = [round(i * modes / count) for i in range(count + 1)]
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


def over_blocks(rule: Callable[[slice], Found], modes: int, numbers: int) -> Iterator[list[Found]]:
    """Yield what `rule` gives for each of `blocks`, in PARTS lists; large problems use all cores."""
    every = blocks(modes, numbers)
    edges = np.linspace(0, len(every), PARTS + 1).astype(int)
    parts = [every[a:b] for a, b in itertools.pairwise(edges) if b > a]
    return parallel_map(lambda part: [rule(m) for m in part], parts, modes * numbers > WORTH_THREADS)


def triangular_inverses(G: np.ndarray) -> np.ndarray:
    """Return the inverses of lower triangular matrices (M, r, r), which are overwritten."""
    (invert,) = get_lapack_funcs(("trtri",), (G,))
    for one in G:
        invert(one.T, lower=0, overwrite_c=1)  # the transpose of a row-major matrix is column-major: no copy
    return G


def hermitian_inverses(C: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return C^-1 (M, N, N) and log det C (M,) of positive definite matrices, or LinAlgError; C may be overwritten."""
    if C.shape[1] <= FEW:
        try:
            G = np.linalg.cholesky(C)
            return np.linalg.inv(C), 2 * np.log(np.real(np.diagonal(G, axis1=1, axis2=2))).sum(axis=1)
        except np.linalg.LinAlgError:
            pass  # below the mode is found
    factor, invert = get_lapack_funcs(("potrf", "potri"), (C,))
    diagonals = np.empty(C.shape[:2])
    for m, A in enumerate(C):  # the transpose of a row-major matrix is column-major: no copies
        G, fault = factor(A.T, lower=0, overwrite_a=1, clean=1)
        if fault:
            raise np.linalg.LinAlgError(f"covariance of mode {m} is not positive definite")
        diagonals[m] = G.diagonal().real
        invert(G, lower=0, overwrite_c=1)
    upper = np.conj(np.swapaxes(C, 1, 2))  # A.T holds the upper triangle, so A the lower
    np.copyto(C, upper, where=np.tri(C.shape[1], k=-1, dtype=bool).T)
    return C, 2 * np.log(diagonals).sum(axis=1)


def as_columns(p: Numbers, dtype: np.dtype[Any]) -> np.ndarray:
    """Return vectors (M, N) as factors of matrices: complex (M, N, 1), for real matrices their parts (M, N, 2)."""
    p = np.ascontiguousarray(p, complex)
    return p[..., None] if np.issubdtype(dtype, np.complexfloating) else p.view(float).reshape(*p.shape, 2)


def joined_columns(parts: np.ndarray) -> np.ndarray:
    """Return the complex vectors (M, r) of what `as_columns` was multiplied to."""
    return parts[..., 0] if np.iscomplexobj(parts) else np.ascontiguousarray(parts).view(complex)[..., 0]


def applied(A: Numbers, v: Complexes) -> np.ndarray:
    """Return A v of every mode, (M, N) complex128; A (M, N, N) real or complex, v (M, N) complex."""
    return joined_columns(np.matmul(A, as_columns(v, A.dtype)))


def weighted_curvature(
    g: np.ndarray, K: Callable[[slice, slice], np.ndarray], diagonal: Reals | None = None
) -> np.ndarray:
    """Return sum_m Re [conj(g_ma,i) K_m,ij g_mb,j], blocks a <= b, the others zero : (P, P, N, N) float64.

    g : (P, 2, M, N) float64, real and imaginary parts; K : returns rows (M, rows, N) of the Hermitian matrices of some
    modes, given both as slices; diagonal : (M,) float64 or None, added to the diagonals of K
    """
    P, _, M, N = g.shape
    H, left, right = np.zeros((P, P, N, N)), g.transpose(0, 2, 3, 1), g.transpose(0, 2, 1, 3)
    pairs = [(a, b) for a in range(P) for b in range(a, P)]
    for rows in blocks(N, 4 * N):
        sums = np.zeros((len(pairs), rows.stop - rows.start, N))
        for m in blocks(M, N * (rows.stop - rows.start)):
            matrices = K(m, rows)
            parts = (np.real(matrices).copy(), np.imag(matrices).copy()) if np.iscomplexobj(matrices) else (matrices,)
            for total, (a, b) in zip(sums, pairs, strict=True):
                other = right[b, m]
                for part in parts:
                    total += np.einsum("mij,mij->ij", left[a, m, rows] @ other, part)
                    other = np.stack([-other[:, 1], other[:, 0]], axis=1)  # times j, for the imaginary part
        for total, (a, b) in zip(sums, pairs, strict=True):
            H[a, b, rows] = total
    if diagonal is not None:
        for a, b in pairs:
            np.einsum("ii->i", H[a, b])[:] += np.sum(diagonal[:, None] * (g[a] * g[b]).sum(axis=0), axis=0)
    return H


def whole_curvature(H: np.ndarray) -> np.ndarray:
    """Return (N, P, N, P) float64 from the blocks a <= b of (P, P, N, N), which is overwritten."""
    for a in range(len(H)):
        for b in range(a):
            H[a, b] = H[b, a].T
    return np.ascontiguousarray(H.transpose(2, 0, 3, 1))


EXTRA_ORDERS = 8  # beyond ceil(k R) about the centre of mass: the rest of W W^H is below 1e-9
NEAR_FIELD_ORDERS = 16  # the same with near sources: the rest of the power of one at 1.75 R is below 1e-10
DIRECTION_ORDERS = 6  # beyond ceil(k R), that plane waves must resolve
SOURCE_DISTANCE = 1.5  # times R: nearest source that the near-field gains allow for
# degrees of Lebedev's rules without a negative weight
DEGREES = (3, 5, 7, 9, 11, 15, 17, 19, 21, 23, 29, 31, 35, 41, 47, 53, 59, 65, 71, 77, 83, 89, 95, 101, 107, 113, 119,
           125, 131)  # fmt: skip


def expansion_about(
    x: Reals, k: Numbers, dimension: int, near: bool, about: Reals | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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


def circular_waves(
    x: Reals, centre: Reals, k: Numbers, orders: Sequence[int] | Integers, gains: Reals, slopes: bool
) -> tuple[np.ndarray, np.ndarray | None]:
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


def _circular_slopes(cosines: np.ndarray, sines: np.ndarray, half: np.ndarray) -> np.ndarray:
    """dW from J_l cos(l theta) and J_l sin(l theta), l = 0..L+1; `half` (M, L + 1) is k / 2 times the factor."""
    C, S = cosines.swapaxes(0, 1), sines.swapaxes(0, 1)
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


def circular_dictionary(points: ArrayLike, k: complex, order: int, centre: ArrayLike) -> np.ndarray:
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


def directions_needed(positions: Reals, wavenumbers: Numbers, dimension: int) -> int:
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


def plane_waves(
    x: Reals, k: Numbers, powers: Reals, slope: bool, dimension: int = 2
) -> tuple[np.ndarray, np.ndarray | None]:
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


SMALL = 1e-6  # argument below which J_1(z) / z is 1/2
NEAREST = 1e-9  # metres: no microphone is closer to the centre, where directions are undefined


def diffuse_correlation(z: np.ndarray, dimension: int) -> np.ndarray:
    """Return kappa(z), the correlation of a diffuse field at distance z / k, of any shape: J_0(z) or sin(z) / z."""
    return j0(z) if dimension == 2 else sinc(z)[0]


def diffuse_kernel(distance: Reals, wavenumbers: Reals, dimension: int, slope: bool = True):
    """Covariance (M, P) of a diffuse field over `distance` (P,), metres, and (d kappa / d r) / r, 1/m^2, or None."""
    z = np.multiply.outer(wavenumbers, distance)
    k2 = wavenumbers[:, None] ** 2
    if dimension == 2:
        if not slope:
            return j0(z), None
        safe = np.maximum(z, SMALL)
        return j0(z), -k2 * (j1(safe) / safe)
    kappa, over = sinc(z)
    return kappa, (k2 * over if slope else None)


def diffuse_matrices(x: Reals, wavenumbers: Reals, dimension: int, slope: bool):
    """Diffuse kernel K (M, N, N) float64 at x (N, D), metres, and S (M, N, N), D_a = S (x_i - x_j)_a, or None."""
    N, M = len(x), len(wavenumbers)
    first, second, pair = _pairs(N)
    distance = np.linalg.norm(x[first] - x[second], axis=1)
    if not np.all(np.isfinite(distance)):
        raise np.linalg.LinAlgError("positions are not finite")
    kappa, over = diffuse_kernel(np.append(distance, 0.0), wavenumbers, dimension, slope)
    K = np.take(kappa, pair, axis=1).reshape(M, N, N)
    if over is None:
        return K, None
    over[:, -1] = 0.0  # of the diagonal
    return K, np.take(over, pair, axis=1).reshape(M, N, N)


@lru_cache(maxsize=8)
def _pairs(N: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First and second microphone of each pair (P,), and the pair of every element of a matrix (N N,); diagonal: P."""
    first, second = np.tril_indices(N, -1)
    pair = np.full((N, N), len(first))
    pair[first, second] = pair[second, first] = np.arange(len(first))
    first, second, pair = (frozen_array(one, np.int64) for one in (first, second, pair.ravel()))
    return first, second, pair


def series_kernel(
    x: Reals, about: Reals | None, wavenumbers: Numbers, dimension: int, near: bool = False, slope: bool = True
):
    """Covariance K (M, N, N) complex128 at x (N, D), metres, for complex `wavenumbers` (M,), rad/m, and D or None.

    about : (N, D) float64, metres, or None for `x`; the series is about their centre, `near` relative to their extent
    """
    x, k = np.asarray(x, float), np.asarray(wavenumbers, complex)
    (N, axes), M = x.shape, len(k)
    centre, orders, gains = expansion_about(x, k, dimension, near, about)
    K, D = np.empty((M, N, N), complex), np.empty((axes, M, N, N), complex) if slope else None
    if dimension == 3:
        l = np.arange(int(gains.shape[1]))  # noqa: E741
        excess = np.where(l <= orders[:, None], (2 * l + 1) * (gains**2 - 1), 0.0)
        for m in blocks(M, 2 * N * N):
            K[m] = _isotropic(x - centre, k[m], None if D is None else D[:, m])
            if excess[m].any():
                K[m] += _excess(x - centre, k[m], excess[m], None if D is None else D[:, m])
        return K, D
    for m in blocks(M, N * N):
        _products(*circular_waves(x, centre, k[m], orders[m], gains[m], slope), K[m], None if D is None else D[:, m])
    return K, D


def plane_wave_kernel(
    x: Reals,
    about: Reals,
    wavenumbers: Numbers,
    powers: Reals,
    slope: bool = True,
    dimension: int = 2,
    modes: slice = slice(None),
):
    """Covariance K (M, N, N) complex128 of a field whose power by direction is `powers` (M, Q), and D or None.

    x, about : (N, D) float64, metres, the centre is the mean of `about`; wavenumbers : (M,) rad/m, real or complex;
    modes : those of which the covariance is wanted
    """
    x, k, powers = np.asarray(x, float) - np.mean(about, axis=0), np.asarray(wavenumbers), powers[modes]
    every = cosines_and_sines(x, k, powers.shape[1], dimension)[modes] if np.isrealobj(k) and not slope else None
    k, (N, axes), (M, Q) = k[modes], x.shape, powers.shape
    K, D = np.empty((M, N, N), complex), np.empty((axes, M, N, N), complex) if slope else None
    for m in blocks(M, (1 if np.isrealobj(k) else 2) * N * max(N, Q)):
        if every is None:
            _products(*plane_waves(x, k[m], powers[m], slope, dimension), K[m], None if D is None else D[:, m])
        else:
            pair_covariance(every[m], *pair_powers(powers[m], dimension), K[m])
    return K, D


# of vectors u (M, N) and Hermitian matrices P (M, N, N)
Slopes = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def plane_wave_covariance(
    x: Reals, about: Reals, wavenumbers: Numbers, powers: Reals, dimension: int, modes: slice
) -> tuple[np.ndarray, Slopes]:
    """Return the covariance of `plane_wave_kernel`, and a function that makes of its slope D what the likelihood needs.

    That function takes vectors u (M, N) complex128 and Hermitian matrices P (M, N, N), and returns sum_j D_a,ij u_j
    (D, M, N) complex128 and Re sum_j D_a,ij conj(P_ij) (D, M, N). With the waves themselves,

        D_a = dW_a W^H,   dW_a,iq = -j k u_a,q W_iq,   sum_j D_a,ij conj(P_ij) = sum_q dW_a,iq conj((P W)_iq)

    so that D, an (N, N) product for each axis, is not needed.
    """
    x, k, powers = np.asarray(x, float) - np.mean(about, axis=0), np.asarray(wavenumbers), powers[modes]
    towards = wave_directions(dimension, powers.shape[1])[0][: x.shape[1]]
    if np.isrealobj(k):
        waves, (a, b) = cosines_and_sines(x, k, powers.shape[1], dimension)[modes], pair_powers(powers, dimension)
        K = np.empty((len(waves), len(x), len(x)), complex)
        pair_covariance(waves, a, b, K)
        return K, lambda u, P: _pair_slopes(waves, a, b, k[modes], towards[:, : a.shape[1]], u, P)
    W = plane_waves(x, k[modes], powers, False, dimension)[0]
    return W.swapaxes(1, 2) @ np.conj(W), lambda u, P: _wave_slopes(W, k[modes], towards, u, P)


def _wave_slopes(W: Complexes, k: Numbers, towards: Reals, u: Complexes, P: Complexes) -> tuple[np.ndarray, np.ndarray]:
    """The slopes of `plane_wave_covariance` by waves W (M, Q, N) and directions `towards` (D, Q)."""
    factor = -1j * k[:, None, None]
    alpha = np.conj(W) @ u[..., None]
    g = W.swapaxes(1, 2) @ (alpha * towards.T) * factor
    across = np.conj(W) @ P  # conj(P W), P = P^H
    traced = (W * across).swapaxes(1, 2) @ towards.T.astype(complex) * factor
    return np.moveaxis(g, 2, 0), np.moveaxis(np.real(traced), 2, 0)


def _pair_slopes(
    waves: Reals, a: Reals, b: Reals, k: Numbers, towards: Reals, u: Complexes, P: Complexes
) -> tuple[np.ndarray, np.ndarray]:
    """The same by waves (M, N, Q) in opposite pairs and directions `towards` (D, Q / 2)."""
    half = a.shape[1]
    along = np.matmul(waves.swapaxes(1, 2), as_columns(u, waves.dtype))  # W^T u
    c, s = along[:, :half].view(complex)[..., 0], along[:, half:].view(complex)[..., 0]
    parts = np.concatenate([a * s - 1j * b * c, -a * c - 1j * b * s], axis=1)
    both = np.concatenate([towards, towards], axis=1).T
    factors = np.ascontiguousarray(parts[..., None] * both).view(float)  # (M, Q, 2 D)
    g = np.matmul(waves, factors).view(complex) * k[:, None, None]
    real, imag = np.matmul(np.real(P).copy(), waves), np.matmul(np.imag(P).copy(), waves)
    turned = waves[..., :half] * real[..., half:] - waves[..., half:] * real[..., :half]
    turned *= a[:, None]
    imag *= waves
    mixed = imag[..., :half] + imag[..., half:]
    mixed *= b[:, None]
    turned -= mixed
    traced = np.matmul(turned, towards.T) * k[:, None, None]
    return np.moveaxis(g, 2, 0), np.moveaxis(traced, 2, 0)


def _products(W: Complexes, dW: Complexes | None, K: Complexes, D: Complexes | None) -> None:
    """K = W W^H and D = dW W^H of some modes."""
    WH = np.conj(W)
    np.matmul(W.swapaxes(1, 2), WH, out=K)
    for derivative, along in zip(() if D is None else D, () if dW is None else dW, strict=True):
        np.matmul(along.swapaxes(1, 2), WH, out=derivative)


def cosines_and_sines(x: Reals, k: Numbers, Q: int, dimension: int) -> np.ndarray:
    """cos and sin of k x . u of half the Q directions, side by side : (M, N, Q) float64, not to be written to.

    A solver that tries a step, learns the powers there and goes on from there needs the same waves three times: those
    of the last positions are kept. x : (N, D) float64, metres, from the centre; k : (M,) float64, rad/m
    """
    return _waves_of(np.ascontiguousarray(x).tobytes(), np.ascontiguousarray(k).tobytes(), x.shape[1], Q, dimension)


@lru_cache(maxsize=1)
def _waves_of(places: bytes, wavenumbers: bytes, axes: int, Q: int, dimension: int) -> np.ndarray:
    x, k, half = np.frombuffer(places).reshape(-1, axes), np.frombuffer(wavenumbers), Q // 2
    along = x @ wave_directions(dimension, Q)[0][:axes, :half]
    waves = np.empty((len(k), len(x), Q))
    for m in blocks(len(k), 2 * len(x) * Q):
        waves[m, :, :half], waves[m, :, half:] = cosine_and_sine(np.multiply.outer(k[m], along))
    waves.setflags(write=False)
    return waves


def pair_powers(powers: Reals, dimension: int) -> tuple[np.ndarray, np.ndarray]:
    """Weighted sum a and difference b (M, Q / 2) of the `powers` (M, Q) of opposite directions."""
    half = powers.shape[1] // 2
    weighted = wave_directions(dimension, powers.shape[1])[1] * powers
    return weighted[:, :half] + weighted[:, half:], weighted[:, :half] - weighted[:, half:]


def pair_covariance(waves: Reals, a: Reals, b: Reals, out: Complexes) -> None:
    """K of pairs of undamped waves, (M, N, N) complex128, into `out`; `waves` of `cosines_and_sines`."""
    half = a.shape[1]
    weighted = waves * np.sqrt(np.concatenate([a, a], axis=1))[:, None]
    out.real = np.matmul(weighted, weighted.swapaxes(1, 2))
    crossed = np.matmul(waves[..., :half] * b[:, None], waves[..., half:].swapaxes(1, 2))
    out.imag = crossed - crossed.swapaxes(1, 2)


def _isotropic(x: Reals, k: Complexes, D: Complexes | None) -> np.ndarray:
    """Return the covariance in space without gains, and put its derivatives into `D`; `x` is from the centre."""
    N, (i, j) = len(x), np.tril_indices(len(x))
    apart, along = x[i] - x[j], x[i] + x[j]
    distance2, along2, mixed = (np.sum(u * v, axis=1) for u, v in ((apart, apart), (along, along), (apart, along)))
    square, k2 = np.empty((len(k), len(i)), complex), (k * k)[:, None]
    square.real = np.real(k)[:, None] ** 2 * distance2 - np.imag(k)[:, None] ** 2 * along2
    square.imag = np.imag(k2) * mixed
    kappa, over = complex_sinc(square)
    if D is not None:  # half the gradient of z^2 with respect to x_i is k (k x_i - conj(k) x_j)
        slope = _hermitian(over, i, j, N)
        for derivative, column in zip(D, x.T, strict=True):
            own, other = np.multiply.outer(k * k, column), np.multiply.outer(np.abs(k) ** 2, column)
            np.multiply(slope, own[:, :, None] - other[:, None, :], out=derivative)
    return _hermitian(kappa, i, j, N)


def _excess(x: Reals, k: Complexes, excess: Reals, D: Complexes | None) -> np.ndarray:
    """Return what gains add to the covariance, and add its derivatives to `D`; `x` is from the centre.

    excess : (M, L + 1) float64, (2 l + 1) (h_l^2 - 1)
    """
    a = np.maximum(np.linalg.norm(x, axis=1), NEAREST)
    e = x / a[:, None]
    cosine, z, wanted = e @ e.T, np.multiply.outer(k, a), np.flatnonzero(np.any(excess, axis=0))
    f, (P, dP) = bessel(z, int(wanted[-1]) + 1, spherical=True), _legendre(cosine, int(wanted[-1]))
    K, R, A, product = (np.zeros((len(k), *cosine.shape), complex) for _ in range(4))
    for l in wanted:  # noqa: E741
        other, own = np.conj(f[l])[:, None, :], excess[:, l, None]
        np.multiply((own * f[l])[:, :, None], other, out=product)
        _add(K, P[l], product)
        if D is not None:
            _add(A, dP[l], product)
            np.multiply((own * k[:, None] * (l / z * f[l] - f[l + 1]))[:, :, None], other, out=product)
            _add(R, P[l], product)
    if D is not None:
        A /= a[:, None]
        R -= A * cosine
        for derivative, along in zip(D, e.T, strict=True):
            derivative += R * along[:, None] + A * along
    return K


def _add(total: Complexes, factor: Reals, product: Complexes) -> None:
    """Add the product of a real (N, N) factor and a complex (M, N, N) one; NumPy would make the real one complex."""
    total.view(float)[...] += np.repeat(factor, 2, axis=1) * product.view(float)


def _hermitian(values: Numbers, i: Integers, j: Integers, N: int) -> np.ndarray:
    """(M, N, N) from the elements (M, P) of the lower triangle."""
    A = np.empty((len(values), N, N), values.dtype)
    A[:, j, i] = np.conj(values)
    A[:, i, j] = values
    return A


def _legendre(c: Reals, top: int) -> tuple[np.ndarray, np.ndarray]:
    """P_l and its derivative of every argument, l = 0..top : two (top + 1, ...) float64."""
    P, dP = np.ones((top + 1, *c.shape)), np.zeros((top + 1, *c.shape))
    if top:
        P[1], dP[1] = c, 1.0
    for l in range(1, top):  # noqa: E741
        P[l + 1] = ((2 * l + 1) * c * P[l] - l * P[l - 1]) / (l + 1)
        dP[l + 1] = dP[l - 1] + (2 * l + 1) * P[l]
    return P, dP
