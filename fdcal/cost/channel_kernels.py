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

from ..acoustics.sinc import sinc
from .circular_waves import circular_waves
from .low_rank_covariance import expansion_centre
from .mode_sums import blocks
from .spherical_covariance import series_covariance

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
    x, k = np.asarray(positions, float), np.asarray(wavenumbers, complex)
    centre, orders, amplification = expansion_centre(x, k, dimension, near, about)
    if dimension == 3:
        return series_covariance(x, centre, k, orders, amplification, slope)
    N, M = len(x), len(k)
    K, D = np.empty((M, N, N), complex), np.empty((2, M, N, N), complex) if slope else None
    for m in blocks(M, N * N):
        W, dW = circular_waves(x, centre, k[m], orders[m], amplification[m], slope)
        WH = np.conj(W)
        np.matmul(W.swapaxes(1, 2), WH, out=K[m])
        if D is not None and dW is not None:
            for derivative, along in zip(D, dW, strict=True):
                np.matmul(along.swapaxes(1, 2), WH, out=derivative[m])
    return K, D
