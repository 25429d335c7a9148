"""The likelihood with one microphone left out: what the others predict for it, and its cost anywhere else.

    C     covariance of the pressures of one mode, `fdcal.cost.likelihood`
    K, u  C^-1, and C^-1 p
    c_j   s kappa(k |x_j - x|), covariance of microphone j with a point x

Without refitting, the pressure of microphone n differs from its prediction by the others by u_n / K_nn, and the
variance of that difference is 1 / K_nn. Leaving microphone n out takes (K c)_n^2 / K_nn off c^T K c and
(K c)_n u_n / K_nn off c^T u: its own place drops out, and one product K c serves every microphone. The cost of
microphone n at x is

    log det (C_-n / v) + p_-n^H C_-n^-1 p_-n + log (V / v) + |p_n - q|^2 / V,

q the second of these, V = s + v less the first.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import get_blas_funcs, get_lapack_funcs

from ..acoustics.threads import parallel_map
from .likelihood import DiffuseField, covariances, kernel

(dtrmm,) = get_blas_funcs(("trmm",), dtype=np.float64)
(dtrtri,) = get_lapack_funcs(("trtri",), dtype=np.float64)

BLOCK = 2_000_000  # pairs of a microphone and a candidate, of each mode in progress, in memory at once


def likelihood_landscape(positions, n: int, candidates, pressures, field: DiffuseField) -> np.ndarray:
    """Return the cost of every mode with microphone `n` at each candidate.

    Parameters as of `likelihood_landscapes`.

    Returns
    -------
    (M, C) float64
    """
    return likelihood_landscapes(positions, [n], candidates, pressures, field)[:, 0]


def likelihood_landscapes(
    positions, chosen, candidates, pressures, field: DiffuseField, block: int = BLOCK
) -> np.ndarray:
    """Return the cost of every mode with each chosen microphone at each candidate, the others held each time.

    Parameters
    ----------
    positions : (N, D) float64, metres
    chosen : (S,) int, microphones to move, one at a time
    candidates : (C, D) float64, metres
    pressures : (M, N) complex128
    block : pairs of a microphone and a candidate in memory at once, of each mode in progress

    Returns
    -------
    (M, S, C) float64
    """
    C = covariances(positions, field)
    chosen, N = np.asarray(chosen), len(positions)
    leaving = parallel_map(lambda m: _leaving_out(C[m], pressures[m], chosen, field.noise[m]), range(len(pressures)))
    costs = []
    for part in np.array_split(candidates, -(-N * len(candidates) // block)):
        distance = np.linalg.norm(positions[:, None] - part[None], axis=-1)

        def of_mode(m: int, distance=distance) -> np.ndarray:
            s, (X, rows, u, d, base) = field.power[m], leaving[m]
            c = s * kernel(field.wavenumbers[m] * distance, field.dimension)
            along = rows @ c
            missed = pressures[m, chosen, None] - (u.real @ c + 1j * (u.imag @ c)) + along * (u[chosen] / d)[:, None]
            Xc = dtrmm(1.0, X, c.T, side=1, lower=1, trans_a=1, overwrite_b=1)  # transposed; overwrites c
            V = s + field.noise[m] - np.einsum("cn,cn->c", Xc, Xc) + along**2 / d[:, None]
            return base[:, None] + np.log(V) + np.abs(missed) ** 2 / V

        costs.append(parallel_map(of_mode, range(len(pressures))))
    return np.concatenate(costs, axis=2)


def _leaving_out(C, p, chosen, noise) -> tuple[np.ndarray, ...]:
    """Of one mode: X with C^-1 = X^T X, rows `chosen` of C^-1, C^-1 p, their diagonal, and the cost of the others."""
    G = np.linalg.cholesky(C)
    X = dtrtri(G, lower=1)[0]
    y, rows = X @ p, X[:, chosen].T @ X
    u, d = X.T @ y, rows[np.arange(len(chosen)), chosen]
    base = 2 * np.log(np.diagonal(G)).sum() + np.log(d) - len(C) * np.log(noise)
    return X, rows, u, d, base + np.sum(np.abs(y) ** 2) - np.abs(u[chosen]) ** 2 / d


def leave_one_out_chi_square(positions, pressures, field: DiffuseField) -> np.ndarray:
    """Return how well the others predict each microphone: |error|^2 over its variance, mean over the modes.

    Parameters
    ----------
    positions : (N, D) float64, metres
    pressures : (M, N) complex128

    Returns
    -------
    (N,) float64, about 1 where the model holds
    """
    u, d = precision_terms(positions, pressures, field)
    return np.mean(np.abs(u) ** 2 / d, axis=0)


def precision_terms(positions, pressures, field: DiffuseField) -> tuple[np.ndarray, np.ndarray]:
    """Return C^-1 p and the diagonal of C^-1 (the precision matrix) of every mode, with the real kernel.

    Parameters
    ----------
    positions : (N, D) float64, metres
    pressures : (M, N) complex128

    Returns
    -------
    u : (M, N) complex128, 1 over the unit of the pressures
    d : (M, N) float64, 1 over the unit of abs(pressures)**2
    """
    N = len(positions)
    pairs = np.tril_indices(N, -1)
    distance = np.linalg.norm(positions[pairs[0]] - positions[pairs[1]], axis=1)
    u, d, C = np.empty(pressures.shape, complex), np.empty(pressures.shape), np.zeros((N, N))
    for m, (k, s, v) in enumerate(zip(np.real(field.wavenumbers), field.power, field.noise, strict=True)):
        C[pairs] = s * kernel(k * distance, field.dimension)
        np.fill_diagonal(C, s + v)
        X = dtrtri(np.linalg.cholesky(C), lower=1)[0]  # C^-1 = X^T X
        u[m], d[m] = X.T @ (X @ pressures[m]), np.sum(X**2, axis=0)
    return u, d
