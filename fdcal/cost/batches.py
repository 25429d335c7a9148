"""Many modes at once: blocks that fit the processor's cache, and batched factorisations.

Which modes share an array, and in which order sums are taken, depends on the numbers of modes and microphones alone,
so that results do not depend on the number of cores.
"""

import itertools
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import numpy as np
from scipy.linalg import get_lapack_funcs

from ..acoustics.compiled import parallel_map
from ..model.validation import Complexes, Numbers, Reals

BLOCK = 1.3e5  # numbers in the largest array of a block: about the size of the second-level cache
PARTS = 4  # of the blocks, each computed on one thread: sums do not depend on how many threads there are
FEW = 10  # rows of matrices whose inverses are faster all at once, without the half of the work that symmetry saves
WORTH_THREADS = 3e6  # numbers in all modes from which threads are faster than one core

Found = TypeVar("Found")

np.empty(2_000_000)  # freed at once: from then on the C library keeps freed blocks of this size, and reuses them


def blocks(modes: int, numbers: int) -> list[slice]:
    """Return slices of about one length that cover all modes; `numbers` are those in the largest array of one mode."""
    count = -(-modes // max(1, int(BLOCK // numbers)))
    edges = [round(i * modes / count) for i in range(count + 1)]
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


def over_blocks(rule: Callable[[slice], Found], modes: int, numbers: int) -> Iterator[list[Found]]:
    """Yield what `rule` gives for each of `blocks`, in PARTS lists; large problems use all cores."""
    every = blocks(modes, numbers)
    edges = np.linspace(0, len(every), PARTS + 1).astype(int)
    parts = [every[a:b] for a, b in itertools.pairwise(edges) if b > a]
    return parallel_map(lambda part: [rule(m) for m in part], parts, modes * numbers > WORTH_THREADS)


def triangular_inverses(G: np.ndarray) -> np.ndarray:
    """Return the inverses of lower triangular matrices (M, r, r), which are overwritten."""
    (invert,) = get_lapack_funcs(("trtri",), (G,))
    for one in G:
        invert(one.T, lower=0, overwrite_c=1)  # the transpose of a row-major matrix is column-major: no copy
    return G


def hermitian_inverses(C: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return C^-1 (M, N, N) and log det C (M,) of positive definite matrices, or LinAlgError; C may be overwritten."""
    if C.shape[1] <= FEW:
        try:
            G = np.linalg.cholesky(C)
            return np.linalg.inv(C), 2 * np.log(np.real(np.diagonal(G, axis1=1, axis2=2))).sum(axis=1)
        except np.linalg.LinAlgError:
            pass  # below the mode is found
    factor, invert = get_lapack_funcs(("potrf", "potri"), (C,))
    diagonals = np.empty(C.shape[:2])
    for m, A in enumerate(C):  # the transpose of a row-major matrix is column-major: no copies
        G, fault = factor(A.T, lower=0, overwrite_a=1, clean=1)
        if fault:
            raise np.linalg.LinAlgError(f"covariance of mode {m} is not positive definite")
        diagonals[m] = G.diagonal().real
        invert(G, lower=0, overwrite_c=1)
    upper = np.conj(np.swapaxes(C, 1, 2))  # A.T holds the upper triangle, so A the lower
    np.copyto(C, upper, where=np.tri(C.shape[1], k=-1, dtype=bool).T)
    return C, 2 * np.log(diagonals).sum(axis=1)


def as_columns(p: Numbers, dtype: np.dtype[Any]) -> np.ndarray:
    """Return vectors (M, N) as factors of matrices: complex (M, N, 1), for real matrices their parts (M, N, 2)."""
    p = np.ascontiguousarray(p, complex)
    return p[..., None] if np.issubdtype(dtype, np.complexfloating) else p.view(float).reshape(*p.shape, 2)


def joined_columns(parts: np.ndarray) -> np.ndarray:
    """Return the complex vectors (M, r) of what `as_columns` was multiplied to."""
    return parts[..., 0] if np.iscomplexobj(parts) else np.ascontiguousarray(parts).view(complex)[..., 0]


def applied(A: Numbers, v: Complexes) -> np.ndarray:
    """Return A v of every mode, (M, N) complex128; A (M, N, N) real or complex, v (M, N) complex."""
    return joined_columns(np.matmul(A, as_columns(v, A.dtype)))


def weighted_curvature(
    g: np.ndarray, K: Callable[[slice, slice], np.ndarray], diagonal: Reals | None = None
) -> np.ndarray:
    """Return sum_m Re [conj(g_ma,i) K_m,ij g_mb,j], blocks a <= b, the others zero : (P, P, N, N) float64.

    g : (P, 2, M, N) float64, real and imaginary parts; K : returns rows (M, rows, N) of the Hermitian matrices of some
    modes, given both as slices; diagonal : (M,) float64 or None, added to the diagonals of K
    """
    P, _, M, N = g.shape
    H, left, right = np.zeros((P, P, N, N)), g.transpose(0, 2, 3, 1), g.transpose(0, 2, 1, 3)
    pairs = [(a, b) for a in range(P) for b in range(a, P)]
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


def whole_curvature(H: np.ndarray) -> np.ndarray:
    """Return (N, P, N, P) float64 from the blocks a <= b of (P, P, N, N), which is overwritten."""
    for a in range(len(H)):
        for b in range(a):
            H[a, b] = H[b, a].T
    return np.ascontiguousarray(H.transpose(2, 0, 3, 1))
