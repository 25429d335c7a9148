"""Sums over modes of cost, gradient and Gauss-Newton matrix, in blocks that fit the processor's cache.

What of a mode is computed in one array with other modes, and in which order blocks are added, depends on the numbers
of modes and microphones alone, so that results do not depend on the number of cores.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import get_lapack_funcs

from ..acoustics.threads import parallel_map

BLOCK = 1.3e5  # numbers in the largest array of a block
PARTS = 4  # of the blocks, summed one after the other; as many threads at most
WORTH_THREADS = 3e6  # numbers in all modes from which threads are faster


@dataclass(frozen=True)
class ModeTerms:
    """Terms of some modes.

    Attributes
    ----------
    costs : (M,) float64
    gradients : (M, N, D) float64, 1/m, or None if only the cost was wanted
    curvature : (D, D, N, N) float64, 1/m^2, sum over the modes, blocks a <= b; or None
    """

    costs: np.ndarray
    gradients: np.ndarray | None = None
    curvature: np.ndarray | None = None


np.empty(2_000_000)  # freed at once: from then on the C library keeps freed blocks of this size, and reuses them


def over_blocks(rule: Callable[[slice], ModeTerms], modes: int, numbers: int) -> ModeTerms:
    """Return the terms of all modes, computed block by block.

    Parameters
    ----------
    rule : callable
        Returns the terms of the modes of a slice.
    modes : int, number of modes
    numbers : int, in the largest array of one mode
    """
    all_blocks = blocks(modes, numbers)
    parts = [all_blocks[a:b] for a, b in itertools.pairwise(np.linspace(0, len(all_blocks), PARTS + 1).astype(int))]
    several = worth_threads(modes, numbers)
    return _joined(parallel_map(lambda part: _joined(map(rule, part)), filter(None, parts), several))


def _joined(found: Iterable[ModeTerms]) -> ModeTerms:
    """Terms of all modes from those of some; of the matrices, which are large, no more than two are kept."""
    costs, gradients, curvature = [], [], None
    for one in found:
        costs.append(one.costs)
        if one.gradients is not None:
            gradients.append(one.gradients)
        if one.curvature is not None:
            curvature = one.curvature if curvature is None else np.add(curvature, one.curvature, out=curvature)
    return ModeTerms(np.concatenate(costs), np.concatenate(gradients) if gradients else None, curvature)


def blocks(modes: int, numbers: int) -> list[slice]:
    """Return slices of about the same length that cover all modes; parameters as of `over_blocks`."""
    count = -(-modes // max(1, int(BLOCK // numbers)))
    edges = [round(i * modes / count) for i in range(count + 1)]
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


def worth_threads(modes: int, numbers: int) -> bool:
    """Return whether several threads are faster than one; parameters as of `over_blocks`."""
    return modes * numbers > WORTH_THREADS


def summed(terms: ModeTerms, shape: tuple[int, int]) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the cost, its gradient (N, D), 1/m, and its Gauss-Newton matrix (N, D, N, D), 1/m^2.

    What was not computed is zero, and the matrix empty.
    """
    (N, D), H = shape, terms.curvature
    gradient = np.zeros((N, D)) if terms.gradients is None else terms.gradients.sum(axis=0)
    if H is None:
        return float(terms.costs.sum()), gradient, np.zeros((0, D, 0, D))
    for a in range(D):
        for b in range(a):
            H[a, b] = H[b, a].T
    return float(terms.costs.sum()), gradient, np.ascontiguousarray(H.transpose(2, 0, 3, 1))


def triangular_inverses(G: np.ndarray) -> np.ndarray:
    """Return the inverses of lower triangular matrices (M, r, r), which are overwritten."""
    (invert,) = get_lapack_funcs(("trtri",), (G,))
    for one in G:
        invert(one.T, lower=0, overwrite_c=1)  # the transpose of a row-major matrix is column-major: no copy
    return G


def hermitian_inverses(C: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return C^-1 (M, N, N) and log det C (M,) of positive definite matrices; C is overwritten.

    Raises numpy.linalg.LinAlgError where one is not positive definite.
    """
    factor, invert = get_lapack_funcs(("potrf", "potri"), (C,))
    diagonals = np.empty(C.shape[:2])
    for m, A in enumerate(C):  # the transpose of a row-major matrix is column-major: no copies
        G, fault = factor(A.T, lower=0, overwrite_a=1, clean=1)
        if fault:
            raise np.linalg.LinAlgError(f"covariance of mode {m} is not positive definite")
        diagonals[m] = np.real(np.diagonal(G))
        invert(G, lower=0, overwrite_c=1)
    upper = np.conj(np.swapaxes(C, 1, 2))  # A.T holds the upper triangle, so A the lower
    np.copyto(C, upper, where=np.tri(C.shape[1], k=-1, dtype=bool).T)
    return C, 2 * np.log(diagonals).sum(axis=1)


def as_columns(p, dtype) -> np.ndarray:
    """Return vectors as factors of matrices: complex (M, N, 1), or for real matrices their parts (M, N, 2).

    Parameters
    ----------
    p : (M, N) complex128
    dtype : type of the matrices
    """
    p = np.ascontiguousarray(p, complex)
    return p[..., None] if np.issubdtype(dtype, np.complexfloating) else p.view(float).reshape(*p.shape, 2)


def joined_columns(parts) -> np.ndarray:
    """Return the complex vectors (M, r) of what `as_columns` was multiplied to."""
    return parts[..., 0] if np.iscomplexobj(parts) else np.ascontiguousarray(parts).view(complex)[..., 0]


def weighted_curvature(g: np.ndarray, K: Callable[[slice, slice], np.ndarray], diagonal=None) -> np.ndarray:
    """Return sum_m Re [conj(g_ma,i) K_m,ij g_mb,j], blocks a <= b, the others zero : (D, D, N, N) float64.

    Parameters
    ----------
    g : (D, 2, M, N) float64, real and imaginary parts
    K : callable
        Returns rows (M, rows, N), float64 or complex128, of the matrices of some modes, given both as slices.
    diagonal : (M,) float64 or None, added to the diagonals of K
    """
    D, _, M, N = g.shape
    H, left, right = np.zeros((D, D, N, N)), g.transpose(0, 2, 3, 1), g.transpose(0, 2, 1, 3)
    pairs = [(a, b) for a in range(D) for b in range(a, D)]
    for rows in blocks(N, 4 * N):
        sums = np.zeros((len(pairs), rows.stop - rows.start, N))
        for m in blocks(M, N * (rows.stop - rows.start)):
            matrices = K(m, rows)
            parts = (np.real(matrices).copy(), np.imag(matrices).copy()) if np.iscomplexobj(matrices) else (matrices,)
            for total, (a, b) in zip(sums, pairs, strict=True):
                other = right[b, m]
                for part in parts:
                    total += np.einsum("mij,mij->ij", left[a, m, rows] @ other, part)
                    other = np.stack([-other[:, 1], other[:, 0]], axis=1)  # times j, for the imaginary part
        for total, (a, b) in zip(sums, pairs, strict=True):
            H[a, b, rows] = total
    if diagonal is not None:
        for a, b in pairs:
            np.einsum("ii->i", H[a, b])[:] += np.sum(diagonal[:, None] * (g[a] * g[b]).sum(axis=0), axis=0)
    return H
