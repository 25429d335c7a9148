"""Smooth deformations of an array: polynomials of the positions.

The error of an affine start is smooth, since the field is. The array is first moved along these deformations, before
every microphone moves by itself; this makes the start good enough (see `fdcal.solvers.joint.solver`).
"""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np


def polynomial_deformations(positions: np.ndarray, known: np.ndarray, degree: int) -> np.ndarray:
    """Return an orthonormal basis of the deformations that leave the known microphones in place.

    Every coordinate moves by a polynomial of the positions. The degree is lower if the array has too few microphones
    to distinguish the monomials.

    Parameters
    ----------
    positions : (N, D) float64, metres
    known : (K,) int, indices of the known microphones
    degree : int, of the polynomials, at most

    Returns
    -------
    (N D, F) float64
    """
    N, D = positions.shape
    z = positions - positions.mean(axis=0)
    z = z / np.sqrt(np.mean(z**2))
    columns = [np.ones(N)]
    for d in range(1, degree + 1):
        more = [np.prod(z[:, list(c)], axis=1) for c in combinations_with_replacement(range(D), d)]
        if d > 1 and len(columns) + len(more) > N / 2:
            break
        columns += more
    whole = np.kron(np.linalg.qr(np.column_stack(columns))[0], np.eye(D))
    if not len(known):
        return whole
    held = (D * np.asarray(known)[:, None] + np.arange(D)).ravel()
    _, values, vectors = np.linalg.svd(whole[held])
    basis = whole @ vectors[np.count_nonzero(values > 1e-9 * values[0]) :].T
    basis[held] = 0.0  # to the last bit: rounding would move a microphone at the origin
    return basis
