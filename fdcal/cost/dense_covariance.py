"""The covariance through its kernel, sin(z) / z: cost, gradient and Gauss-Newton matrix of all positions, compiled.

The formulas of `fdcal.cost.likelihood` with dense matrices. In three dimensions the expansion has more functions than
there are microphones, so this takes fewer operations.
"""

from __future__ import annotations

import numpy as np

from ..acoustics.compiled import add_curvature, compiled, lower_inverse, sum_over_modes, writable
from ..acoustics.sinc import sinc_rows


def dense_terms(positions, pressures, wavenumbers, power, noise, log_det: bool, derivatives=2):
    """Return cost, gradient and curvature with real wavenumbers.

    Parameters
    ----------
    positions : (N, 3) or, in a plane of the field, (N, 2) float64, metres
    pressures : (M, N) complex128
    wavenumbers : (M,) float64, rad/m
    power, noise, log_det, derivatives : as of `fdcal.cost.low_rank_covariance.expansion_terms`

    Returns
    -------
    As `fdcal.cost.low_rank_covariance.expansion_terms`.

    Raises
    ------
    numpy.linalg.LinAlgError
        A position is not finite, or C is singular.
    """
    x = writable(positions, float)
    pairs = np.tril_indices(len(x), -1)
    apart = np.linalg.norm(x[pairs[0]] - x[pairs[1]], axis=1)
    if not np.all(np.isfinite(apart)):
        raise np.linalg.LinAlgError("positions are not finite")
    scale = np.ones_like(noise) if log_det else noise
    modes = writable(pressures, complex), writable(wavenumbers, float), power, noise, scale
    return sum_over_modes(_modes, (x, apart), modes, (float(log_det), derivatives), derivatives)


@compiled
def _modes(x, apart, p, k, power, noise, scale, log_det, derivatives, cost, gradient, H):
    """Add every mode; `apart` (N (N - 1) / 2,), metres, has the distances of the pairs i > j, row by row."""
    N, D = x.shape
    C, g = np.empty((N, N)), np.empty((2, D, N))
    kappa, slope = np.empty(len(apart)), np.empty(len(apart))
    for m in range(len(p)):
        sinc_rows(k[m] * apart, kappa, slope)
        q = 0
        for i in range(N):
            C[i, i] = power[m] + noise[m]
            for j in range(i):
                C[i, j] = C[j, i] = power[m] * kappa[q]
                q += 1
        G = np.linalg.cholesky(C)
        X = lower_inverse(G)
        y_re, y_im = X @ p[m].real.copy(), X @ p[m].imag.copy()
        for i in range(N):
            cost[0] += scale[m] * (y_re[i] ** 2 + y_im[i] ** 2) + log_det * np.log(G[i, i] ** 2 / noise[m])
        if derivatives == 0:
            continue
        inverse = X.T @ X
        u_re, u_im = X.T @ y_re, X.T @ y_im
        g[:] = 0.0
        q = 0
        for i in range(N):
            for j in range(i):
                s = power[m] * k[m] ** 2 * slope[q]
                q += 1
                w = 2 * s * (log_det * inverse[i, j] - scale[m] * (u_re[i] * u_re[j] + u_im[i] * u_im[j]))
                for a in range(D):
                    d = x[i, a] - x[j, a]
                    gradient[i, a] += w * d
                    gradient[j, a] -= w * d
                    g[0, a, i] += s * d * u_re[j]
                    g[1, a, i] += s * d * u_im[j]
                    g[0, a, j] -= s * d * u_re[i]
                    g[1, a, j] -= s * d * u_im[i]
        if derivatives == 2:
            add_curvature(H, g, inverse, 2 * scale[m])
