"""How fdcal compiles, and linear algebra that the costs of all positions share (`expansion`, `dense`, `series`).

numba keeps machine code beside the source, or in the user's cache folder where it may not write there. An installation
that is read-only keeps it under FDCAL_CACHE, if that is told; where there is no place at all every run compiles anew.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import numpy as np

# The modes are summed in so many parts on any machine: the same sums, to the last bit, with any number of cores.
PARTS = 4
WORTH = 2e5  # M N^2 from which threads pay

if "FDCAL_CACHE" in os.environ and not numba.config.CACHE_DIR and not os.access(Path(__file__).parent, os.W_OK):
    numba.config.CACHE_DIR = str(Path(os.environ["FDCAL_CACHE"]) / "compiled")


def compiled(function: Callable, **options) -> Callable:
    """Decorator: compiled at the first call with arguments of each type, without the interpreter's lock, kept on disk.

    A read-only array is of another type than one that may be written to.
    """
    options = {"nogil": True, "error_model": "numpy", **options}
    try:
        return numba.njit(function, cache=True, **options)
    except RuntimeError:  # no folder that numba may write to
        return numba.njit(function, **options)


def compiled_parallel(function: Callable) -> Callable:
    """As `compiled`, its `numba.prange` shared out between threads."""
    return compiled(function, parallel=True)


def writable(values, dtype=None) -> np.ndarray:
    """A copy, row by row: what may not be written to is another type to the compiler, which would compile twice."""
    return np.array(values, dtype, order="C")


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(min(PARTS, os.cpu_count() or 1), "fdcal-modes")


def shut_down_threads() -> None:
    """End the threads of `parallel_map` after what they are at; who needs them again gets new ones."""
    pool = _pool()
    _pool.cache_clear()
    pool.shutdown()


def parallel_map(function: Callable, items: Iterable, worth: bool = True) -> list:
    """`function` of every one of the items, in their order, on all cores where that is `worth` it.

    Not for a function that calls this itself: its parts would wait for the cores that wait for them.
    """
    items = list(items)
    try:
        results = _pool().map(function, items) if worth else map(function, items)
    except RuntimeError:  # the interpreter is ending, and the pool takes no more
        results = map(function, items)
    return list(results)


def sum_over_modes(kernel, before: tuple, modes: tuple, after: tuple, derivatives: int):
    """Cost (float), gradient (N, D) and curvature (N, D, N, D) that a compiled kernel sums over the modes.

    It is called as `kernel(*before, *modes, *after, cost (1,), gradient (N, D), H (D, D, N, N))`, and adds to the last
    three; `before` begins with the positions (N, D), each of `modes` has a row a mode. Parts of the modes run at once.
    With fewer than 2 `derivatives` the curvature is empty.
    """
    N, D = before[0].shape
    M, columns = len(modes[0]), N if derivatives == 2 else 0

    def part(first: int):
        sums = np.zeros(1), np.zeros((N, D)), np.zeros((D, D, columns, columns))
        kernel(*before, *(writable(values[first::PARTS]) for values in modes), *after, *sums)
        return sums

    done = parallel_map(part, range(min(PARTS, M)), M * N * N > WORTH)
    cost, gradient, H = (sum(values[1:], values[0]) for values in zip(*done, strict=True))
    return float(cost[0]), gradient, symmetric_hessian(H)


def symmetric_hessian(H: np.ndarray) -> np.ndarray:
    """Blocks (D, D, N, N), of which only those with a <= b are filled, as the matrix (N, D, N, D)."""
    for a in range(len(H)):
        for b in range(a):
            H[a, b] = H[b, a].T
    return np.ascontiguousarray(H.transpose(2, 0, 3, 1))


@compiled
def lower_inverse(G):
    """Inverse of a lower triangular matrix, row by row."""
    X = np.zeros(G.shape, G.dtype)
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


@compiled
def adjoint(A):
    """Conjugate transpose, row by row."""
    out = np.empty((A.shape[1], A.shape[0]), A.dtype)
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            out[j, i] = np.conj(A[i, j])
    return out
