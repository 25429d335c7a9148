"""Cost, gradient and Gauss-Newton matrix of modes whose covariance is s W W^H + v I.

With mu = v / s,

    A = W^H W + mu I = G G^H,    Q = W G^-H,    P = I - Q Q^H = v C^-1,    alpha = A^-1 W^H p,    r = P p = p - W alpha

    cost          p^H P p / v + log det (A / mu)        (the determinant in a likelihood only)
    gradient      -2 Re [conj(g_a) r] / v + 2 Re diag(D_a W A^-1 W^H),    g_a = D_a W alpha, slope of the fitted field
    curvature     2 Re [conj(g_a,i) P_ij g_b,j] / v     (Gauss-Newton; for a projection Kaufman's approximation)

It does not matter what the columns of W are: `fdcal.cost.low_rank_covariance` has circular waves and
`fdcal.cost.angular_prior` plane waves. A column of zeros changes nothing, so that modes of different orders share one
array. Matrices are kept transposed, (modes, columns, microphones).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .mode_sums import ModeTerms, as_columns, joined_columns, triangular_inverses, weighted_curvature


def low_rank_terms(W, dW, p, mu, scale, log_det: float, derivatives: int) -> ModeTerms:
    """Return the terms of some modes.

    Parameters
    ----------
    W : (M, r, N), all real or all complex
    dW : (D, M, r, N) likewise, 1/m; not used without derivatives
    p : (M, N) complex128, in any unit
    mu : (M,) float64, v / s
    scale : (M,) float64, factor of the squared residual
    log_det : 1 for the likelihood, 0 for the projection
    derivatives : 0 for the cost alone, 1 for its gradient, too, 2 for all

    Raises
    ------
    numpy.linalg.LinAlgError
        A is not positive definite.
    """
    N = W.shape[2]
    seen = factorised(W, p, mu)
    costs = scale * seen.misfit + log_det * seen.log_det
    if derivatives == 0:
        return ModeTerms(costs)
    g = fitted_slopes(dW, seen.coefficients, N)
    gradients = -2 * scale[:, None] * (g[:, 0] * np.real(seen.residual) + g[:, 1] * np.imag(seen.residual))
    if log_det:
        gradients += 2 * log_det * seen.widening(dW)
    gradients = gradients.transpose(1, 2, 0)
    if derivatives == 1:
        return ModeTerms(costs, gradients)
    return ModeTerms(costs, gradients, seen.curvature(g, scale))


@dataclass(frozen=True)
class Factors:
    """What follows from the factorisation of A.

    Attributes
    ----------
    X, F : (M, r, r) and (M, r, N), G^-1 and Q^H
    coefficients : (M, r, C), alpha as columns, see `fdcal.cost.mode_sums.as_columns`
    residual : (M, N) complex128, P p
    misfit : (M,) float64, p^H P p
    log_det : (M,) float64, log det (A / mu)
    """

    X: np.ndarray
    F: np.ndarray
    coefficients: np.ndarray
    residual: np.ndarray
    misfit: np.ndarray
    log_det: np.ndarray

    def widening(self, dW) -> np.ndarray:
        """Return half the gradient of `log_det`, Re diag(D_a W A^-1 W^H), of `dW` (D, M, r, N) : (D, M, N)."""
        XH = np.conj(self.X.swapaxes(1, 2)) if np.iscomplexobj(self.X) else self.X.swapaxes(1, 2)
        T = np.conj(XH @ self.F)
        return np.array([_real_products(slope, T) for slope in dW])

    def curvature(self, g, scale) -> np.ndarray:
        """Return 2 Re sum_m scale_m conj(g_a,i) P_ij g_b,j of `g` (D, 2, M, N) : (D, D, N, N), blocks a <= b."""
        F = self.F
        FH = np.conj(F).swapaxes(1, 2) * (-2 * scale[:, None, None])
        return weighted_curvature(g, lambda m, rows: FH[m, rows] @ F[m], 2 * scale)


def factorised(W, p, mu) -> Factors:
    """Return the factorisation of A = W^H W + mu I and what is fitted to `p`; parameters as of `low_rank_terms`.

    Raises
    ------
    numpy.linalg.LinAlgError
        A is not positive definite.
    """
    WH, columns = np.conj(W) if np.iscomplexobj(W) else W, np.arange(W.shape[1])
    A = WH @ W.swapaxes(1, 2)
    A[:, columns, columns] += mu[:, None]
    G = np.linalg.cholesky(A)
    diagonal = np.real(G[:, columns, columns])
    X = triangular_inverses(G)
    XH = np.conj(X.swapaxes(1, 2)) if np.iscomplexobj(X) else X.swapaxes(1, 2)
    parts = XH @ (X @ (WH @ as_columns(p, W.dtype)))
    alpha, residual = joined_columns(parts), p - joined_columns(W.swapaxes(1, 2) @ parts)
    misfit = np.sum(np.abs(residual) ** 2, axis=1) + mu * np.sum(np.abs(alpha) ** 2, axis=1)  # errors of alpha cancel
    return Factors(X, X @ WH, parts, residual, misfit, np.sum(np.log(diagonal**2 / mu[:, None]), axis=1))


def _real_products(A, B) -> np.ndarray:
    """Re sum_q A_qn conj(B_qn) of every mode : (M, N)."""
    if np.iscomplexobj(A):
        products = np.einsum("mqn,mqn->mn", A.view(float), np.ascontiguousarray(B).view(float))
        return products.reshape(*products.shape[:1], -1, 2).sum(axis=2)
    return np.einsum("mqn,mqn->mn", A, B)


def fitted_slopes(dW, parts, N: int) -> np.ndarray:
    """Return g_a = D_a W alpha of every mode, real and imaginary parts : (D, 2, M, N).

    dW : (D, M, r, N), 1/m;  parts : `Factors.coefficients`;  N : number of microphones
    """
    g = np.empty((len(dW), 2, len(parts), N))
    for a, slope in enumerate(dW):
        along = parts.swapaxes(1, 2) @ slope
        both = (along[:, 0].real, along[:, 0].imag) if np.iscomplexobj(along) else (along[:, 0], along[:, 1])
        g[a, 0], g[a, 1] = both
    return g
