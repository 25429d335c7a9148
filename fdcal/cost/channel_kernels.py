"""Spatial covariance of a sound field of unit power between microphones, and its slope, for every mode at once.

    K_m[i, j]    = covariance of the field at microphones i and j
    D_ma[i, j]   = derivative of K_m[i, j] with respect to coordinate a of microphone i

`diffuse_kernel`  plane waves of a real wavenumber from everywhere: J_0(k r) in the plane, sin(k r) / (k r) in space.
`series_kernel`   the same waves with a complex wavenumber, as the series W W^H about the centre of the array; with
                  `near`, columns of high order are amplified as a source close to the array does
                  (`fdcal.cost.low_rank_covariance`). Needed where the noise is below what a real wavenumber, or a
                  field without near sources, leaves unexplained.

Waves whose power depends on their direction: `fdcal.cost.angular_prior.plane_wave_kernel`.
"""

from __future__ import annotations

import numpy as np
from scipy.special import j0, j1

from ..acoustics.compiled import adjoint, compiled, writable
from .low_rank_covariance import expansion_centre, fill_circular
from .spherical_covariance import cosine, directions, series

SMALL = 1e-6  # argument below which J_1(z) / z is 1/2


def diffuse_kernel(distance, wavenumbers, dimension: int, slope: bool = True):
    """Covariance of a diffuse field over `distance` (P,), metres, for real `wavenumbers` (M,), rad/m.

    Returns
    -------
    kappa : (M, P) float64
    slope : (M, P) float64, 1/m^2, (d kappa / d r) / r; None unless wanted
    """
    z = np.multiply.outer(wavenumbers, distance)
    k2 = wavenumbers[:, None] ** 2
    if dimension == 2:
        if not slope:
            return j0(z), None
        safe = np.maximum(z, SMALL)
        return j0(z), -k2 * (j1(safe) / safe)
    from ..acoustics.sinc import sinc

    kappa, over = sinc(z)
    return kappa, (k2 * over if slope else None)


def series_kernel(positions, about, wavenumbers, dimension: int, near: bool, slope: bool = True):
    """Covariance at `positions` (N, D), metres, for complex `wavenumbers` (M,), rad/m.

    about : (N, D) float64, metres; the series is about their centre, `near` is relative to their extent

    Returns
    -------
    K : (M, N, N) complex128, Hermitian
    D : (D, M, N, N) complex128, 1/m; None unless wanted
    """
    x, k = writable(positions, float), writable(wavenumbers, complex)
    centre, orders, amplification = expansion_centre(x, k, dimension, near, about)
    (N, axes), M = x.shape, len(k)
    K = np.empty((M, N, N), complex)
    D = np.empty((axes, M, N, N) if slope else (axes, M, 0, 0), complex)
    rule = _plane_series if dimension == 2 else _space_series
    rule(x, centre, k, orders, amplification, slope, K, D)
    return K, (D if slope else None)


@compiled
def _plane_series(x, centre, k, orders, amplification, slope, K, D):
    for m in range(len(k)):
        width = 2 * orders[m] + 1
        W, dW = np.empty((len(x), width), np.complex128), np.empty((2, len(x), width), np.complex128)
        fill_circular(x, centre, k[m], orders[m], amplification[m], slope, W, dW)
        WH = adjoint(W)
        K[m] = W @ WH
        if slope:
            for a in range(2):
                D[a, m] = dW[a] @ WH


@compiled
def _space_series(x, centre, k, orders, amplification, slope, K, D):
    e, reach = directions(x, centre)
    N = len(x)
    R, A = np.empty((N, N), np.complex128), np.empty((N, N), np.complex128)
    for m in range(len(k)):
        series(e, reach, k[m], orders[m], amplification[m], slope, K[m], R, A)
        if slope:
            for i in range(N):
                for j in range(N):
                    c = cosine(e, i, j)
                    for a in range(x.shape[1]):
                        D[a, m, i, j] = R[i, j] * e[i, a] + A[i, j] * (e[j, a] - c * e[i, a]) / reach[i]
