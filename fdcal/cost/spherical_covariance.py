"""The covariance in space as a series: complex wavenumbers and near sources, compiled.

    C_ij = s sum_l (2l + 1) h_l^2 j_l(k a_i) conj(j_l(k a_j)) P_l(cos gamma_ij) + v delta_ij

a, gamma   distance from the centre of the expansion; angle between two microphones as seen from the centre
h_l        gain of order l, `fdcal.cost.low_rank_covariance`; with gain 1 and real k the series is sin(k d) / (k d)

It is s W W^H + v I of the spherical dictionary (`fdcal.acoustics.spherical_harmonics`), with the sum over m in closed
form (addition theorem): N^2 L terms and not N^2 L^2. Microphones in a plane need no special case. Cost, gradient and
curvature are those of `fdcal.cost.newton_kernels`, with D_a[i,j] = dC_ij / dx_ia of the first microphone alone:

    gradient   2 Re sum_j D_a[i,j] (C^-1)_ji - 2 Re conj(u_i) g_a,i,    g_a = D_a u,  u = C^-1 p
    curvature  2 Re conj(g_a,i) (C^-1)_ij g_b,j
"""

from __future__ import annotations

import numpy as np

from ..acoustics.compiled import add_curvature, compiled, lower_inverse, writable
from .bessel_kernels import fill_spherical_bessel


@compiled
def series_modes(x, centre, p, k, orders, gains, power, noise, scale, log_det, derivatives, cost, gradient, H):
    """Add every mode to `cost` (1,), `gradient` (N, D) and `H` (D, D, N, N), blocks a <= b.

    Parameters as of `fdcal.cost.low_rank_covariance.expansion_terms`, `gains` (M, L + 1) float64.
    """
    N, D = x.shape
    e, a = directions(x, centre)
    C, R, A = np.empty((N, N), np.complex128), np.empty((N, N), np.complex128), np.empty((N, N), np.complex128)
    for m in range(len(k)):
        series(e, a, k[m], orders[m], gains[m], derivatives > 0, C, R, A)
        for i in range(N):
            for j in range(N):
                C[i, j] *= power[m]
            C[i, i] += noise[m]
        G = np.linalg.cholesky(C)
        X = lower_inverse(G)
        y = X @ p[m]
        for i in range(N):
            cost[0] += scale[m] * abs(y[i]) ** 2 + log_det * np.log(G[i, i].real ** 2 / noise[m])
        if derivatives == 0:
            continue
        XH = np.conj(X.T)
        inverse, u = XH @ X, XH @ y
        g = np.zeros((2, D, N))
        for i in range(N):
            for b in range(D):
                slope, widening = 0j, 0.0
                for j in range(N):
                    c = cosine(e, i, j)
                    d = power[m] * (R[i, j] * e[i, b] + A[i, j] * (e[j, b] - c * e[i, b]) / a[i])
                    slope += d * u[j]
                    widening += (d * inverse[j, i]).real
                g[0, b, i], g[1, b, i] = slope.real, slope.imag
                gradient[i, b] += 2 * log_det * widening - 2 * scale[m] * (np.conj(u[i]) * slope).real
        if derivatives == 2:
            add_curvature(H, g, inverse, 2 * scale[m])


@compiled
def directions(x, centre):
    """Return unit vectors (N, D) from the centre to the microphones and their distances (N,), metres."""
    N, D = x.shape
    e, a = np.empty((N, D)), np.empty(N)
    for i in range(N):
        total = 0.0
        for b in range(D):
            e[i, b] = x[i, b] - centre[b]
            total += e[i, b] ** 2
        a[i] = max(np.sqrt(total), 1e-9)
        for b in range(D):
            e[i, b] /= a[i]
    return e, a


@compiled
def cosine(e, i, j):
    """Return cos gamma of microphones i and j from the unit vectors e (N, D)."""
    total = 0.0
    for b in range(e.shape[1]):
        total += e[i, b] * e[j, b]
    return total


@compiled
def series(e, a, k, L, gain, slopes, C, R, A):
    """Fill C (N, N) of one mode for s = 1, v = 0; if `slopes`, R = dC / da_i and A = dC / d cos gamma."""
    N = len(a)
    J, dJ = np.empty((N, L + 1), np.complex128), np.empty((N, L + 1), np.complex128)
    weight = np.empty(L + 1)
    for l in range(L + 1):  # noqa: E741
        weight[l] = (2 * l + 1) * gain[l] ** 2
    for i in range(N):
        fill_spherical_bessel(k * a[i], k, J[i], dJ[i])
    for i in range(N):
        for j in range(i + 1):
            c = cosine(e, i, j)
            below, here, d_below, d_here = 0.0, 1.0, 0.0, 0.0  # P_l and its derivative
            value, radial_i, radial_j, angular = 0j, 0j, 0j, 0j
            for l in range(L + 1):  # noqa: E741
                w = weight[l] * here
                other = np.conj(J[j, l])
                value += w * J[i, l] * other
                if slopes:
                    radial_i += w * dJ[i, l] * other
                    radial_j += w * dJ[j, l] * np.conj(J[i, l])
                    angular += weight[l] * d_here * J[i, l] * other
                    d_below, d_here = d_here, d_below + (2 * l + 1) * here
                below, here = here, ((2 * l + 1) * c * here - l * below) / (l + 1)
            C[i, j], C[j, i] = value, np.conj(value)
            R[i, j], R[j, i] = radial_i, radial_j
            A[i, j], A[j, i] = angular, np.conj(angular)


def spherical_gram(points, k, order: int, centre, gain=None) -> np.ndarray:
    """Return W W^H of one mode in three dimensions.

    Parameters
    ----------
    points : (N, 3) or, in a plane, (N, 2) float64, metres
    k : float or complex, rad/m
    order : L
    centre : as one of `points`, metres
    gain : (L + 1,) float64 or None, factor of each order

    Returns
    -------
    (N, N) complex128
    """
    x, centre = writable(points, float), writable(centre, float)
    C = np.empty((len(x), len(x)), complex)
    gain = np.ones(order + 1) if gain is None else gain
    series(*directions(x, centre), complex(k), order, gain, False, C, C.copy(), C.copy())
    return C
