"""Compiled linear algebra that the costs of all positions share (`fdcal.expansion`, `fdcal.dense`, `fdcal.series`)."""

from __future__ import annotations

import numba
import numpy as np

compiled = numba.njit(nogil=True, cache=True, error_model="numpy")


def symmetric(H: np.ndarray) -> np.ndarray:
    """Blocks (D, D, N, N), of which only those with a <= b are filled, as the matrix (N, D, N, D)."""
    for a in range(len(H)):
        for b in range(a):
            H[a, b] = H[b, a].T
    return np.ascontiguousarray(H.transpose(2, 0, 3, 1))


@compiled
def lower_inverse(G):
    """Inverse of a lower triangular matrix, row by row."""
    X = np.zeros_like(G)
    for i in range(len(G)):
        for q in range(i):
            factor = G[i, q]
            for j in range(q + 1):
                X[i, j] -= factor * X[q, j]
        for j in range(i):
            X[i, j] /= G[i, i]
        X[i, i] = 1 / G[i, i]
    return X


@compiled
def add_curvature(H, g, K, factor):
    """Add factor Re [conj(g_a,i) K_ij g_b,j] to H (D, D, N, N), blocks a <= b; g (2, D, N) real and imaginary parts."""
    real, imaginary = K.real, K.imag
    whole = np.any(imaginary != 0)
    D, N = len(H), len(K)
    for a in range(D):
        for b in range(a, D):
            for i in range(N):
                u, v = factor * g[0, a, i], factor * g[1, a, i]
                row, k_re, br, bi = H[a, b, i], real[i], g[0, b], g[1, b]
                for j in range(N):
                    row[j] += k_re[j] * (u * br[j] + v * bi[j])
                if whole:
                    k_im = imaginary[i]
                    for j in range(N):
                        row[j] -= k_im[j] * (u * bi[j] - v * br[j])
