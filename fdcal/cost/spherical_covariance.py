"""The covariance in space as a series: complex wavenumbers and near sources.

    C_ij = s sum_l (2l + 1) h_l^2 j_l(k a_i) conj(j_l(k a_j)) P_l(cos gamma_ij) + v delta_ij

a, gamma   distance from the centre of the expansion; angle between two microphones as seen from the centre
h_l        gain of order l, `fdcal.cost.low_rank_covariance`; with gain 1 and real k the series is sin(k d) / (k d)

It is s W W^H + v I of the spherical dictionary (`fdcal.acoustics.spherical_harmonics`), with the sum over m in closed
form (addition theorem): N^2 L terms and not N^2 L^2. Microphones in a plane need no special case.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..acoustics.bessel import spherical_bessel_functions
from .full_rank_terms import full_rank_terms
from .mode_sums import ModeTerms

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
    orders : (M,) int, L of every mode
    gains : (M, L + 1) float64, factor of every order, for the highest L
    slopes : bool, whether the derivatives are wanted

    Returns
    -------
    K : (M, N, N) complex128, Hermitian
    D : (axes, M, N, N) complex128, 1/m, derivative by the coordinates of the first microphone; None unless wanted
    """
    seen, (N, axes), M = _Geometry.of(x, centre, int(np.max(orders, initial=0))), x.shape, len(k)
    K, D = np.empty((M, N, N), complex), np.empty((axes, M, N, N) if slopes else (0, M, N, N), complex)
    for m in range(M):
        L = int(orders[m])
        weight = ((2 * np.arange(L + 1) + 1) * gains[m, : L + 1] ** 2)[:, None]
        K[m] = _fill(seen, complex(k[m]), weight, D[:, m])
    return K, (D if slopes else None)


@dataclass(frozen=True)
class _Geometry:
    """Where the microphones are as seen from the centre, and Legendre polynomials between them.

    a (N,), metres, distances; e (N, axes) unit vectors; i, j (P,) the pairs i >= j; cosine (P,) of their angle;
    P, dP (L + 1, P) polynomials and derivatives
    """

    a: np.ndarray
    e: np.ndarray
    i: np.ndarray
    j: np.ndarray
    cosine: np.ndarray
    P: np.ndarray
    dP: np.ndarray

    @staticmethod
    def of(x, centre, top: int) -> _Geometry:
        offsets = x - centre
        a = np.maximum(np.linalg.norm(offsets, axis=1), NEAREST)
        e = offsets / a[:, None]
        i, j = np.tril_indices(len(x))
        cosine = np.sum(e[i] * e[j], axis=1)
        return _Geometry(a, e, i, j, cosine, *_legendre(cosine, top))


def _fill(seen: _Geometry, k: complex, weight, D) -> np.ndarray:
    """Return the covariance of one mode and fill `D` (axes, N, N), unless it has no axes."""
    (L, i, j), z = (len(weight) - 1, seen.i, seen.j), k * seen.a
    f = spherical_bessel_functions(z, L + 1)
    at_i, at_j = f[:-1, i], np.conj(f[:-1, j])
    weighted, product = weight * seen.P[: L + 1], at_i * at_j
    K = _hermitian(np.sum(weighted * product, axis=0), i, j, len(z))
    if len(D):
        df = k * (np.arange(L + 1)[:, None] / z * f[:-1] - f[1:])
        R, A = np.empty_like(K), _hermitian(np.sum(weight * seen.dP[: L + 1] * product, axis=0), i, j, len(z))
        R[j, i] = np.sum(weighted * df[:, j] * np.conj(at_i), axis=0)
        R[i, j] = np.sum(weighted * df[:, i] * at_j, axis=0)
        A /= seen.a[:, None]
        R -= A * _hermitian(seen.cosine, i, j, len(z))
        for axis, along in enumerate(seen.e.T):
            D[axis] = R * along[:, None] + A * along
    return K


def _hermitian(values, i, j, N: int) -> np.ndarray:
    A = np.empty((N, N), values.dtype)
    A[j, i] = np.conj(values)
    A[i, j] = values
    return A


def _legendre(c, top: int) -> tuple[np.ndarray, np.ndarray]:
    """P_l and its derivative of every argument, l = 0..top : two (top + 1, P) float64."""
    P, dP = np.ones((top + 1, len(c))), np.zeros((top + 1, len(c)))
    if top:
        P[1], dP[1] = c, 1.0
    for l in range(1, top):  # noqa: E741
        P[l + 1] = ((2 * l + 1) * c * P[l] - l * P[l - 1]) / (l + 1)
        dP[l + 1] = dP[l - 1] + (2 * l + 1) * P[l]
    return P, dP
