"""Cost, gradient and Gauss-Newton matrix of modes from their covariance C itself and its derivatives.

u = C^-1 p,    D_a[i, j] = derivative of C_ij with respect to coordinate a of microphone i,    g_a = D_a u

cost          p^H u + log det (C / v)       (the determinant in a likelihood only)
gradient      2 Re sum_j D_a[i, j] (C^-1)_ji - 2 Re [conj(u_i) g_a,i]
curvature     2 Re [conj(g_a,i) (C^-1)_ij g_b,j]
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .mode_sums import ModeTerms, as_columns, joined_columns, triangular_inverses, weighted_curvature

Slopes = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def full_rank_terms(C, p, noise, scale, log_det: float, derivatives: int, slopes: Slopes) -> ModeTerms:
    """Return the terms of some modes.

    Parameters
    ----------
    C : (M, N, N) float64 or complex128, Hermitian, in the unit of abs(p)**2
    p : (M, N) complex128
    noise : (M,) float64, v
    scale : (M,) float64, factor of p^H u
    log_det : 1 for the likelihood, 0 for the projection
    derivatives : 0 for the cost alone, 1 for its gradient, too, 2 for all
    slopes : callable
        Of C^-1 (M, N, N) and u (M, N) returns g (D, M, N) complex128 and Re sum_j D_a[i, j] (C^-1)_ji (D, M, N).

    Raises
    ------
    numpy.linalg.LinAlgError
        C is singular.
    """
    diagonal = np.arange(p.shape[1])
    G = np.linalg.cholesky(C)
    pivots = np.real(G[:, diagonal, diagonal]) ** 2
    X = triangular_inverses(G)
    y = X @ as_columns(p, C.dtype)
    costs = scale * np.sum(np.abs(y) ** 2, axis=(1, 2)) + log_det * np.sum(np.log(pivots / noise[:, None]), axis=1)
    if derivatives == 0:
        return ModeTerms(costs)
    XH = np.conj(X.swapaxes(1, 2)) if np.iscomplexobj(X) else X.swapaxes(1, 2)
    inverse, u = XH @ X, joined_columns(XH @ y)
    g, widening = slopes(inverse, u)
    gradients = 2 * log_det * widening - 2 * scale[:, None] * np.real(np.conj(u) * g)
    parts = np.stack([np.real(g), np.imag(g)], axis=1)
    if derivatives == 1:
        return ModeTerms(costs, gradients.transpose(1, 2, 0))
    inverse *= 2 * scale[:, None, None]
    curvature = weighted_curvature(parts, lambda m, rows: inverse[m, rows])
    return ModeTerms(costs, gradients.transpose(1, 2, 0), curvature)
