"""The covariance in space: complex wavenumbers and near sources.

    C_ij = s K_ij + v delta_ij
    K_ij = sum_l (2l + 1) h_l^2 j_l(k a_i) conj(j_l(k a_j)) P_l(cos gamma_ij)
         = sin(z) / z + sum_l (2l + 1) (h_l^2 - 1) j_l(k a_i) conj(j_l(k a_j)) P_l(cos gamma_ij)

a, gamma   distance from the centre of the expansion; angle between two microphones as seen from the centre
h_l        gain of order l, `fdcal.cost.low_rank_covariance`: 1 unless a source may be near
z          z^2 = (k x_i - conj(k) x_j)^2, x from the centre; with real k it is k times the distance

It is s W W^H + v I of the spherical dictionary (`fdcal.acoustics.spherical_harmonics`), with the sum over m in closed
form (addition theorem) and, without gains, the one over l, too: the mean of exp(j k n x_i) times the conjugate of
exp(j k n x_j) over all directions n is that of exp(j n (k x_i - conj(k) x_j)). Microphones in a plane need no special
case.
"""

from __future__ import annotations

import numpy as np

from ..acoustics.bessel import spherical_bessel_functions
from ..acoustics.sinc import complex_sinc
from .full_rank_terms import full_rank_terms
from .mode_sums import ModeTerms, blocks

NEAREST = 1e-9  # metres: no microphone is closer to the centre, where directions are undefined


def series_terms(x, centre, p, k, orders, gains, power, noise, scale, log_det: float, derivatives: int) -> ModeTerms:
    """Return the terms of some modes; parameters as of `fdcal.cost.low_rank_covariance.expansion_terms`."""
    K, D = series_covariance(x, centre, k, orders, gains, derivatives > 0)
    K *= power[:, None, None]
    diagonal = np.arange(len(x))
    K[:, diagonal, diagonal] += noise[:, None]

    def slopes(inverse, u) -> tuple[np.ndarray, np.ndarray]:
        assert D is not None
        g = np.einsum("amij,mj->ami", D, u) * power[:, None]
        return g, np.einsum("amij,mji->ami", D, inverse).real * power[:, None]

    return full_rank_terms(K, p, noise, scale, log_det, derivatives, slopes)


def series_covariance(x, centre, k, orders, gains, slopes: bool) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the covariance of a field of unit power and its derivatives.

    Parameters
    ----------
    x : (N, 3) or, in a plane, (N, 2) float64, metres
    centre : as one of `x`, metres
    k : (M,) float64 or complex128, rad/m
    orders : (M,) int, L of every mode: gains of higher orders are not used
    gains : (M, L + 1) float64, factor of every order, for the highest L
    slopes : bool, whether the derivatives are wanted

    Returns
    -------
    K : (M, N, N) complex128, Hermitian
    D : (axes, M, N, N) complex128, 1/m, derivative by the coordinates of the first microphone; None unless wanted
    """
    x, k, (N, axes), M = x - centre, np.asarray(k, complex), x.shape, len(k)
    K, D = np.empty((M, N, N), complex), np.empty((axes, M, N, N), complex) if slopes else None
    excess = (2 * np.arange(gains.shape[1]) + 1) * (gains**2 - 1)
    excess[np.arange(gains.shape[1]) > np.asarray(orders)[:, None]] = 0.0
    for m in blocks(M, 2 * N * N):
        K[m] = _isotropic(x, k[m], None if D is None else D[:, m])
        if excess[m].any():
            K[m] += _excess(x, k[m], excess[m], None if D is None else D[:, m])
    return K, D


def _isotropic(x, k, D) -> np.ndarray:
    """Return the covariance without gains, and put its derivatives into `D`; `x` is from the centre."""
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


def _excess(x, k, excess, D) -> np.ndarray:
    """Return what the gains add to the covariance, and add its derivatives to `D`; `x` is from the centre.

    excess : (M, L + 1) float64, (2 l + 1) (h_l^2 - 1)
    """
    a = np.maximum(np.linalg.norm(x, axis=1), NEAREST)
    e = x / a[:, None]
    cosine, z, wanted = e @ e.T, np.multiply.outer(k, a), np.flatnonzero(np.any(excess, axis=0))
    f, (P, dP) = spherical_bessel_functions(z, int(wanted[-1]) + 1), _legendre(cosine, int(wanted[-1]))
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


def _add(total, factor, product) -> None:
    """Add the product of a real (N, N) factor and a complex (M, N, N) one; NumPy would make the real one complex."""
    total.view(float)[...] += np.repeat(factor, 2, axis=1) * product.view(float)


def _hermitian(values, i, j, N: int) -> np.ndarray:
    """(M, N, N) from the elements (M, P) of the lower triangle."""
    A = np.empty((len(values), N, N), values.dtype)
    A[:, j, i] = np.conj(values)
    A[:, i, j] = values
    return A


def _legendre(c, top: int) -> tuple[np.ndarray, np.ndarray]:
    """P_l and its derivative of every argument, l = 0..top : two (top + 1, ...) float64."""
    P, dP = np.ones((top + 1, *c.shape)), np.zeros((top + 1, *c.shape))
    if top:
        P[1], dP[1] = c, 1.0
    for l in range(1, top):  # noqa: E741
        P[l + 1] = ((2 * l + 1) * c * P[l] - l * P[l - 1]) / (l + 1)
        dP[l + 1] = dP[l - 1] + (2 * l + 1) * P[l]
    return P, dP
