"""Cost, gradient and Gauss-Newton matrix of one mode whose covariance is s W W^H + v I, compiled.

With mu = v / s,

    A = W^H W + mu I = G G^H,    Q = W G^-H,    P = I - Q Q^H = v C^-1,    alpha = A^-1 W^H p,    r = P p = p - W alpha

    cost          p^H P p / v + log det (A / mu)        (the determinant in a likelihood only)
    gradient      -2 Re [conj(g_a) r] / v + 2 Re diag(D_a W A^-1 W^H),    g_a = D_a W alpha, slope of the fitted field
    curvature     2 Re [conj(g_a,i) P_ij g_b,j] / v     (Gauss-Newton; for a projection Kaufman's approximation)

It does not matter what the columns of W are: `fdcal.cost.low_rank_covariance` has circular waves and
`fdcal.cost.angular_prior` plane waves.
"""

from __future__ import annotations

import numpy as np

from ..acoustics.compiled import add_curvature, adjoint, compiled, lower_inverse


@compiled
def add_mode(W, dW, p, mu, scale, log_det, derivatives, cost, gradient, H):
    """Add one mode to `cost` (1,), `gradient` (N, D) and `H` (D, D, N, N), blocks a <= b.

    W is (N, r) and dW (D, N, r) its derivatives, 1/m, both real or both complex; p (N,) complex128; mu = v / s; scale
    multiplies the squared residual, log_det is 0 or 1; `derivatives` as of
    `fdcal.cost.low_rank_covariance.expansion_terms`.
    """
    N, r = W.shape
    P = np.empty((N, 2), W.dtype)  # BLAS needs one type for both factors
    for i in range(N):
        P[i, 0], P[i, 1] = p[i].real, p[i].imag
    WH = adjoint(W)
    A = WH @ W
    for i in range(r):
        A[i, i] += mu
    G = np.linalg.cholesky(A)
    if log_det != 0:
        for i in range(r):
            cost[0] += log_det * np.log(G[i, i].real ** 2 / mu)
    X = lower_inverse(G)
    XH = adjoint(X)
    parts = XH @ (X @ (WH @ P))
    fit = W @ parts
    alpha, residual = parts[:, 0] + 1j * parts[:, 1], p - (fit[:, 0] + 1j * fit[:, 1])
    cost[0] += scale * _misfit(residual, alpha, mu)
    if derivatives == 0:
        return
    Q = W @ XH
    T = Q @ X
    D = len(dW)
    g = np.empty((2, D, N))
    for a in range(D):
        for i in range(N):
            slope, widening = 0j, 0.0
            for q in range(r):
                slope += dW[a, i, q] * alpha[q]
                widening += (dW[a, i, q] * np.conj(T[i, q])).real
            g[0, a, i], g[1, a, i] = slope.real, slope.imag
            gradient[i, a] += 2 * log_det * widening - 2 * scale * (np.conj(slope) * residual[i]).real
    if derivatives < 2:
        return
    add_curvature(H, g, Q @ adjoint(Q), -2 * scale)
    for a in range(D):
        for b in range(a, D):
            for i in range(N):
                H[a, b, i, i] += 2 * scale * (g[0, a, i] * g[0, b, i] + g[1, a, i] * g[1, b, i])


@compiled
def _misfit(residual, alpha, mu):
    """Return p^H P p = |p - W alpha|^2 + mu |alpha|^2: in this form small errors of alpha cancel to first order."""
    total = 0.0
    for value in residual:
        total += abs(value) ** 2
    for value in alpha:
        total += mu * abs(value) ** 2
    return total
