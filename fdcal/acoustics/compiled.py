"""Compilation and threads, and linear algebra that the likelihoods of all covariance models share.

numba stores machine code beside the source, or in the user's cache folder if the source is read-only. A read-only
installation stores it under FDCAL_CACHE if that is set. If no folder can be written to, every run compiles again.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import numpy as np
from numba.core import config

# The modes are summed in this many parts on any machine, so that the sums do not depend on the number of cores.
PARTS = 4
WORTH_THREADS = 2e5  # M N^2 from which threads are faster

if (
    "FDCAL_CACHE" in os.environ
    and not getattr(config, "CACHE_DIR", "")
    and not os.access(Path(__file__).parent, os.W_OK)
):
    config.CACHE_DIR = str(Path(os.environ["FDCAL_CACHE"]) / "compiled")  # pyright: ignore[reportAttributeAccessIssue]


def compiled(function: Callable, **options) -> Callable:
    """Decorate a function to be compiled at its first call with arguments of each type, and cached on disk.

    It runs without the interpreter's lock. A read-only array is of another type than a writable one.

    Parameters
    ----------
    function : callable
        Of numbers and arrays, in the subset of Python that numba compiles.
    options
        Of `numba.njit`.
    """
    options = {"nogil": True, "error_model": "numpy", **options}
    try:
        return numba.njit(function, cache=True, **options)
    except RuntimeError:  # no folder that numba may write to
        return numba.njit(function, **options)


def compiled_parallel(function: Callable) -> Callable:
    """Decorate as `compiled` does, with the iterations of `numba.prange` distributed over threads."""
    return compiled(function, parallel=True)


def writable(values, dtype=None) -> np.ndarray:
    """Return a writable copy in C order: a read-only array is another type, for which numba would compile again."""
    return np.array(values, dtype, order="C")


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(min(PARTS, os.cpu_count() or 1), "fdcal-modes")


def shut_down_threads() -> None:
    """End the threads of `parallel_map` after their current work; a later call starts new ones."""
    pool = _pool()
    _pool.cache_clear()
    pool.shutdown()


def parallel_map(function: Callable, items: Iterable, worth: bool = True) -> list:
    """Return the values of a function for all items, in their order, computed on all cores.

    Parameters
    ----------
    function : callable
        It must not call `parallel_map` itself, which would deadlock.
    items : iterable
    worth : bool
        False for so little work that one core is faster.
    """
    items = list(items)
    try:
        results = _pool().map(function, items) if worth else map(function, items)
    except RuntimeError:  # the interpreter is exiting, and the pool takes no more work
        results = map(function, items)
    return list(results)


def sum_over_modes(kernel, before: tuple, modes: tuple, after: tuple, derivatives: int):
    """Sum cost, gradient and Hessian of a compiled kernel over the modes, parts of which run concurrently.

    Parameters
    ----------
    kernel : callable
        Called as `kernel(*before, *modes, *after, cost (1,), gradient (N, D), H (D, D, N, N))`; adds to the last three.
    before : tuple
        Its first entry are the positions (N, D), metres.
    modes : tuple of arrays
        Each has one row a mode.
    after : tuple
    derivatives : int
        The Hessian is computed if it is 2.

    Returns
    -------
    cost : float
    gradient : (N, D) float64
    hessian : (N, D, N, D) float64
        Empty unless `derivatives` is 2.
    """
    N, D = before[0].shape
    M, columns = len(modes[0]), N if derivatives == 2 else 0

    def part(first: int):
        sums = np.zeros(1), np.zeros((N, D)), np.zeros((D, D, columns, columns))
        kernel(*before, *(writable(values[first::PARTS]) for values in modes), *after, *sums)
        return sums

    parts = parallel_map(part, range(min(PARTS, M)), M * N * N > WORTH_THREADS)
    cost, gradient, H = (functools.reduce(np.add, values) for values in zip(*parts, strict=True))
    return float(cost[0]), gradient, symmetric_hessian(H)


def symmetric_hessian(H: np.ndarray) -> np.ndarray:
    """Return blocks (D, D, N, N), of which only those with a <= b are filled, as the Hessian (N, D, N, D)."""
    for a in range(len(H)):
        for b in range(a):
            H[a, b] = H[b, a].T
    return np.ascontiguousarray(H.transpose(2, 0, 3, 1))


@compiled
def lower_inverse(G):
    """Return the inverse of a lower triangular matrix, row by row."""
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
    """Return the conjugate transpose in C order."""
    out = np.empty((A.shape[1], A.shape[0]), A.dtype)
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            out[j, i] = np.conj(A[i, j])
    return out
