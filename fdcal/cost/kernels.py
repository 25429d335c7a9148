"""The covariance of a sound field between microphones, its derivatives, and the plane waves of which it consists.

    K_m[i, j]    = covariance of the field of mode m at microphones i and j, normalised to unit power
    D_ma[i, j]   = derivative of K_m[i, j] with respect to coordinate a of microphone i

A diffuse field of a real wavenumber k has K_ij = kappa(k |x_i - x_j|): J_0(k r) in the plane, sin(k r) / (k r) in space
(`diffuse_kernel`). With a complex k, for damped waves, it also depends on the centre of the waves. With positions x
relative to this centre,

    K_ij = kappa(z),   z^2 = (k x_i - conj(k) x_j)^2        (`damped_matrices`; in the plane as a sum of waves)

A field whose power S_q depends on the direction u_q is a sum of plane waves (`plane_wave_covariance`). With w_q the
weights of a quadrature over the circle or the sphere,

    K = W W^H,   W[n, q] = sqrt(w_q S_q) exp(-j k x_n . u_q)

Matrices of waves are stored transposed, (modes, waves, microphones), so that microphones are contiguous in memory.

Undamped plane waves are handled in pairs of opposite directions, which takes about a third of the operations that
complex waves take. With c = cos(k x . u_q), s = sin(k x . u_q), the powers S_q and S'_q of the two directions, and
their weight w_q, the covariance is a sum over half the directions:

    K_ij = sum_q a_q (c_i c_j + s_i s_j) + j b_q (c_i s_j - s_i c_j),    a = w (S + S'),    b = w (S - S')

Many modes are computed together, in blocks that fit the processor's cache, with batched factorisations. The blocks and
the order of summation only depend on the numbers of modes, microphones and waves, so that the results are the same for
any number of cores.
"""

import functools
import itertools
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
from scipy.linalg import get_lapack_funcs
from scipy.special import j0, j1

from ..acoustics.compiled import check_deadline, parallel_map
from ..acoustics.dictionary import complex_sinc, cosine_and_sine, sinc
from ..model.validation import Complexes, Integers, Numbers, Reals, frozen_array

BLOCK = 1.3e5  # numbers in the largest array of a block, which then fits in the second-level cache
PARTS = 4  # lists of blocks, each for one thread; this number is fixed so that sums do not depend on the threads
FEW = 10  # rows of a matrix up to which NumPy's batched inverse is faster than LAPACK's routines for Hermitian matrices
WORTH_THREADS = 3e6  # numbers in the largest arrays of all modes above which several threads are faster than one

Result = TypeVar("Result")

# This array is freed at once. From then on the C library keeps freed blocks of this size and reuses them, instead of
# returning them to the system.
np.empty(2_000_000)


def blocks(modes: int, numbers: int) -> list[slice]:
    """Return slices of about equal length that cover all modes; the largest array of a mode has `numbers` elements."""
    count = -(-modes // max(1, int(BLOCK // numbers)))
    return [slice(a, b) for a, b in itertools.pairwise([round(i * modes / count) for i in range(count + 1)])]


def over_blocks(rule: Callable[[slice], Result], modes: int, numbers: int) -> Iterator[list[Result]]:
    """Yield PARTS lists, or fewer, with the results of `rule` for all `blocks`; large problems use several threads."""

    def of_part(part: list[slice]) -> list[Result]:
        results = []
        for m in part:
            check_deadline()
            results.append(rule(m))
        return results

    all_blocks = blocks(modes, numbers)
    edges = np.linspace(0, len(all_blocks), PARTS + 1).astype(int)
    parts = [all_blocks[a:b] for a, b in itertools.pairwise(edges) if b > a]
    return parallel_map(of_part, parts, modes * numbers > WORTH_THREADS)


def hermitian_inverses(C: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return C^-1 (M, N, N) and log det C (M,) of Hermitian matrices C (M, N, N), which are overwritten.

    Raises LinAlgError if one of them is not positive definite.
    """
    if C.shape[1] <= FEW:
        G = np.linalg.cholesky(C)
        return np.linalg.inv(C), 2 * np.log(np.real(np.diagonal(G, axis1=1, axis2=2))).sum(axis=1)
    factor, invert = get_lapack_funcs(("potrf", "potri"), (C,))
    diagonals = np.empty(C.shape[:2])
    for m, A in enumerate(C):  # LAPACK needs column-major matrices: A.T is one, without a copy
        G, fault = factor(A.T, lower=0, overwrite_a=1, clean=1)
        if fault:
            raise np.linalg.LinAlgError(f"covariance of mode {m} is not positive definite")
        diagonals[m] = G.diagonal().real
        invert(G, lower=0, overwrite_c=1)
    upper = np.conj(np.swapaxes(C, 1, 2))  # LAPACK wrote the upper triangle of A.T, which is the lower one of A
    np.copyto(C, upper, where=np.tri(C.shape[1], k=-1, dtype=bool).T)
    return C, 2 * np.log(diagonals).sum(axis=1)


def as_columns(p: Numbers, dtype: np.dtype[Any]) -> np.ndarray:
    """Return vectors p (M, N) as columns for products with matrices of `dtype`.

    They are complex (M, N, 1) for complex matrices, and real and imaginary parts (M, N, 2) for real ones.
    """
    p = np.ascontiguousarray(p, complex)
    return p[..., None] if np.issubdtype(dtype, np.complexfloating) else p.view(float).reshape(*p.shape, 2)


def applied(A: Numbers, v: Complexes) -> np.ndarray:
    """Return A v of every mode : (M, N) complex128; A is (M, N, N), real or complex, and v (M, N) complex."""
    parts = np.matmul(A, as_columns(v, A.dtype))
    return parts[..., 0] if np.iscomplexobj(parts) else np.ascontiguousarray(parts).view(complex)[..., 0]


def weighted_curvature(g: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Return sum_m Re [conj(g_ma,i) K_m,ij g_mb,j] for a <= b, and 0 for a > b : (P, P, N, N) float64.

    g : (P, 2, M, N) float64, real and imaginary parts; K : (M, N, N), Hermitian
    """
    P, _, M, N = g.shape
    H, left, right = np.zeros((P, P, N, N)), g.transpose(0, 2, 3, 1), g.transpose(0, 2, 1, 3)
    pairs = [(a, b) for a in range(P) for b in range(a, P)]
    for rows in blocks(N, 4 * N):
        sums = np.zeros((len(pairs), rows.stop - rows.start, N))
        for m in blocks(M, N * (rows.stop - rows.start)):
            matrices = K[m, rows]
            parts = (np.real(matrices).copy(), np.imag(matrices).copy()) if np.iscomplexobj(matrices) else (matrices,)
            for total, (a, b) in zip(sums, pairs, strict=True):
                other = right[b, m]
                for part in parts:
                    total += np.einsum("mij,mij->ij", left[a, m, rows] @ other, part)
                    other = np.stack([-other[:, 1], other[:, 0]], axis=1)  # times j, for the imaginary part
        for total, (a, b) in zip(sums, pairs, strict=True):
            H[a, b, rows] = total
    return H


DIRECTION_ORDERS = 6  # orders above ceil(k R) that the plane waves resolve
# degrees of the Lebedev rules without negative weights
DEGREES = (3, 5, 7, 9, 11, 15, 17, 19, 21, 23, 29, 31, 35, 41, 47, 53, 59, 65, 71, 77, 83, 89, 95, 101, 107, 113, 119,
           125, 131)  # fmt: skip


def directions_needed(positions: Reals, wavenumbers: Numbers, dimension: int, orders: int = DIRECTION_ORDERS) -> int:
    """Return the number of directions that resolve a field over the array up to the order ceil(k R) + `orders`.

    positions : (N, D), metres, whose largest distance from the centroid is R; wavenumbers : (M,), rad/m, of which the
    largest real part is k; dimension : dimension of the field, in space with the last of DEGREES as the limit
    """
    reach = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
    order = int(np.ceil(np.real(wavenumbers).max() * reach)) + orders
    if dimension == 2:
        return 2 * order
    return len(_sphere(next((degree for degree in DEGREES if degree >= 2 * order), DEGREES[-1]))[1])


@functools.cache
def wave_directions(dimension: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return unit vectors (D, Q) and their weights (Q,), whose sum is 1; Q is a `count` from `directions_needed`.

    For arrays with k R below the order that they resolve, kappa(k |x - y|) = sum_q w_q exp(-j k (x - y) . u_q). In the
    plane the directions are equally spaced; in space they are those of a Lebedev rule (Lebedev and Laikov, Doklady
    Mathematics 59, 1999). Direction Q / 2 + q is opposite to direction q, so that only half the exponentials are
    computed.
    """
    if dimension == 2:
        t = 2 * np.pi * np.arange(count) / count
        return frozen_array(np.stack([np.cos(t), np.sin(t)]), float), frozen_array(np.full(count, 1 / count), float)
    return next(rule for rule in map(_sphere, DEGREES) if len(rule[1]) == count)


@functools.cache
def _sphere(degree: int) -> tuple[np.ndarray, np.ndarray]:
    from scipy.integrate import lebedev_rule  # imported here: it loads scipy.optimize; a first picture does not need it

    points, weights = lebedev_rule(degree)
    points = points.round(15) + 0.0  # rounding errors and -0 become 0, so that the next line ignores them
    first = np.array([u[np.flatnonzero(u)[0]] > 0 for u in points.T])  # True for one direction of each opposite pair
    half, weights = points[:, first], weights[first] / weights.sum()
    return frozen_array(np.hstack([half, -half]), float), frozen_array(np.tile(weights, 2), float)


def plane_waves(x: Reals, k: Numbers, powers: Reals, dimension: int = 2) -> np.ndarray:
    """Return W of the module's docstring, transposed : (M, Q, N) complex128.

    x : (N, D) float64, metres, relative to the centre, where every damped wave has the amplitude 1; k : (M,), rad/m;
    powers : (M, Q) float64, the power S by direction
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
    return W


SMALL = 1e-6  # argument below which J_1(z) / z is 1/2


def diffuse_correlation(z: np.ndarray, dimension: int) -> np.ndarray:
    """Return the correlation kappa of a diffuse field at the distance z / k : float64 of the shape of `z`.

    dimension : dimension of the field; kappa is J_0(z) in 2 and sin(z) / z in 3 dimensions
    """
    return j0(z) if dimension == 2 else sinc(z)[0]


def diffuse_kernel(distance: Reals, wavenumbers: Reals, dimension: int, slope: bool = True):
    """Return kappa (M, P) at `distance` (P,), metres, and (d kappa / d r) / r, 1/m^2, or None without `slope`.

    wavenumbers : (M,) float64, k, rad/m; dimension : dimension of the field; kappa is J_0(k r) in 2 and
    sin(k r) / (k r) in 3 dimensions
    """
    z = np.multiply.outer(wavenumbers, distance)
    if dimension == 3:
        kappa, over = sinc(z)
    else:
        safe = np.maximum(z, SMALL)
        kappa, over = j0(z), -j1(safe) / safe if slope else 0.0
    return kappa, (wavenumbers[:, None] ** 2 * over if slope else None)


def diffuse_matrices(x: Reals, wavenumbers: Reals, dimension: int, slope: bool):
    """Return K (M, N, N) of a diffuse field at x (N, D), metres, and S (M, N, N), 1/m^2, or None without `slope`.

    S is the derivative of K divided by the distance, so that D_a = S (x_i - x_j)_a.
    """
    N, M = len(x), len(wavenumbers)
    first, second, pair = _pairs(N)
    distance = np.append(np.linalg.norm(x[first] - x[second], axis=1), 0.0)
    kappa, over = diffuse_kernel(distance, wavenumbers, dimension, slope)
    K = np.take(kappa, pair, axis=1).reshape(M, N, N)
    if over is None:
        return K, None
    over[:, -1] = 0.0  # on the diagonal
    return K, np.take(over, pair, axis=1).reshape(M, N, N)


@lru_cache(maxsize=8)
def _pairs(N: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the two microphones of each pair, (P,) and (P,), and the pair of each matrix element (N^2,).

    Elements on the diagonal have the number P. All are int64.
    """
    first, second = np.tril_indices(N, -1)
    pair = np.full((N, N), len(first))
    pair[first, second] = pair[second, first] = np.arange(len(first))
    first, second, pair = (frozen_array(one, np.int64) for one in (first, second, pair.ravel()))
    return first, second, pair


# a function of vectors u (M, N) and Hermitian matrices P (M, N, N); see `plane_wave_covariance`
Slopes = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def plane_wave_covariance(
    x: Reals, wavenumbers: Numbers, powers: Reals, dimension: int, modes: slice
) -> tuple[np.ndarray, Slopes]:
    """Return K (M, N, N) complex128 of some modes, and a function that applies its derivative D.

    x : (N, D) float64, metres, relative to the centre; wavenumbers : of all modes, rad/m, real or complex;
    powers : the power S of all modes by direction, (.., Q); modes : the M modes whose covariance is returned

    The function takes vectors u (M, N) complex128 and Hermitian matrices P (M, N, N). It returns sum_j D_a,ij u_j
    (D, M, N) complex128 and Re sum_j D_a,ij conj(P_ij) (D, M, N) float64. It computes them from the waves,

        D_a = dW_a W^H,   dW_a,iq = -j k u_a,q W_iq,   sum_j D_a,ij conj(P_ij) = sum_q dW_a,iq conj((P W)_iq)

    so that D itself, which would take an (N, N) matrix product for each axis, is never formed.
    """
    k, powers = np.asarray(wavenumbers), powers[modes]
    towards = wave_directions(dimension, powers.shape[1])[0][: x.shape[1]]
    if np.isrealobj(k):
        waves, (a, b) = cosines_and_sines(x, k, powers.shape[1], dimension)[modes], pair_powers(powers, dimension)
        K = np.empty((len(waves), len(x), len(x)), complex)
        pair_covariance(waves, a, b, K)
        return K, lambda u, P: _pair_slopes(waves, a, b, k[modes], towards[:, : a.shape[1]], u, P)
    W = plane_waves(x, k[modes], powers, dimension)
    return W.swapaxes(1, 2) @ np.conj(W), lambda u, P: _wave_slopes(W, k[modes], towards, u, P)


def _wave_slopes(W: Complexes, k: Numbers, towards: Reals, u: Complexes, P: Complexes) -> tuple[np.ndarray, np.ndarray]:
    """Return the two results of `Slopes`, from waves W (M, Q, N) and their directions `towards` (D, Q)."""
    factor = -1j * k[:, None, None]
    g = W.swapaxes(1, 2) @ (np.conj(W) @ u[..., None] * towards.T) * factor
    across = np.conj(W) @ P  # conj(P W), P = P^H
    traced = (W * across).swapaxes(1, 2) @ towards.T.astype(complex) * factor
    return np.moveaxis(g, 2, 0), np.moveaxis(np.real(traced), 2, 0)


def _pair_slopes(
    waves: Reals, a: Reals, b: Reals, k: Numbers, towards: Reals, u: Complexes, P: Complexes
) -> tuple[np.ndarray, np.ndarray]:
    """Return the two results of `Slopes` from undamped `waves` (M, N, Q) in opposite pairs.

    towards : (D, Q / 2), one direction of each pair; a, b : (M, Q / 2), result of `pair_powers`; k : (M,), rad/m
    """
    half = a.shape[1]
    along = np.matmul(waves.swapaxes(1, 2), as_columns(u, waves.dtype))  # W^T u
    c, s = along[:, :half].view(complex)[..., 0], along[:, half:].view(complex)[..., 0]
    parts = np.concatenate([a * s - 1j * b * c, -a * c - 1j * b * s], axis=1)
    both = np.concatenate([towards, towards], axis=1).T
    factors = np.ascontiguousarray(parts[..., None] * both).view(float)  # (M, Q, 2 D)
    g = np.matmul(waves, factors).view(complex) * k[:, None, None]
    real, imag = np.matmul(np.real(P).copy(), waves), np.matmul(np.imag(P).copy(), waves)
    traced = waves[..., :half] * real[..., half:] - waves[..., half:] * real[..., :half]
    traced *= a[:, None]
    imag *= waves
    mixed = imag[..., :half] + imag[..., half:]
    mixed *= b[:, None]
    traced -= mixed
    return np.moveaxis(g, 2, 0), np.moveaxis(np.matmul(traced, towards.T) * k[:, None, None], 2, 0)


def cosines_and_sines(x: Reals, k: Numbers, Q: int, dimension: int) -> np.ndarray:
    """Return cos and sin of k x . u for half the Q directions, side by side : (M, N, Q) float64, read-only.

    x : (N, D) float64, metres, relative to the centre; k : (M,) float64, rad/m. The result for the last positions is
    cached, because a solver needs it three times: to try these positions, to learn the powers, and in the next step.
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
    """Return a and b (M, Q / 2): the weighted sum and difference of the `powers` (M, Q) of opposite directions."""
    half = powers.shape[1] // 2
    weighted = wave_directions(dimension, powers.shape[1])[1] * powers
    return weighted[:, :half] + weighted[:, half:], weighted[:, :half] - weighted[:, half:]


def pair_covariance(waves: Reals, a: Reals, b: Reals, out: Complexes) -> None:
    """Write K of undamped waves in pairs into `out` (M, N, N) complex128.

    `waves` (M, N, Q) come from `cosines_and_sines`, a and b (M, Q / 2) from `pair_powers`.
    """
    half = a.shape[1]
    weighted = waves * np.sqrt(np.concatenate([a, a], axis=1))[:, None]
    out.real = np.matmul(weighted, weighted.swapaxes(1, 2))
    crossed = np.matmul(waves[..., :half] * b[:, None], waves[..., half:].swapaxes(1, 2))
    out.imag = crossed - crossed.swapaxes(1, 2)


def damped_matrices(x: Reals, wavenumbers: Complexes, slope: bool) -> tuple[np.ndarray, np.ndarray | None]:
    """Return K (M, N, N) complex128 of a damped isotropic field in space, and D (D, M, N, N), 1/m, if `slope` is true.

    x : (N, D) float64, metres, relative to the centre; wavenumbers : (M,) complex128, rad/m
    """
    (N, axes), M, (i, j) = x.shape, len(wavenumbers), np.tril_indices(len(x))
    apart, along = x[i] - x[j], x[i] + x[j]
    distance2, along2, mixed = (np.sum(u * v, axis=1) for u, v in ((apart, apart), (along, along), (apart, along)))
    K, D = np.empty((M, N, N), complex), np.empty((axes, M, N, N), complex) if slope else None
    for m in blocks(M, 2 * N * N):
        k = wavenumbers[m]
        square, k2 = np.empty((len(k), len(i)), complex), (k * k)[:, None]
        square.real = np.real(k)[:, None] ** 2 * distance2 - np.imag(k)[:, None] ** 2 * along2
        square.imag = np.imag(k2) * mixed
        kappa, over = complex_sinc(square)
        K[m] = _hermitian(kappa, i, j, N)
        if D is not None:  # half the gradient of z^2 with respect to x_i is k (k x_i - conj(k) x_j)
            sloped = _hermitian(over, i, j, N)
            for derivative, column in zip(D, x.T, strict=True):
                own, other = np.multiply.outer(k * k, column), np.multiply.outer(np.abs(k) ** 2, column)
                np.multiply(sloped, own[:, :, None] - other[:, None, :], out=derivative[m])
    return K, D


def _hermitian(values: Numbers, i: Integers, j: Integers, N: int) -> np.ndarray:
    """Return Hermitian matrices (M, N, N) with the elements `values` (M, P) of the lower triangle."""
    A = np.empty((len(values), N, N), values.dtype)
    A[:, j, i] = np.conj(values)
    A[:, i, j] = values
    return A
