"""Work that is done on all cores at once."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor

MOST_THREADS = 4


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(min(MOST_THREADS, os.cpu_count() or 1), "fdcal-modes")


def shut_down_threads() -> None:
    """End the threads of `parallel_map` after their current work; a later call starts new ones."""
    pool = _pool()
    _pool.cache_clear()
    pool.shutdown()


def parallel_map(function: Callable, items: Iterable, worth: bool = True) -> Iterator:
    """Return an iterator over the values of a function for all items, in their order, computed on all cores.

    `function`: it must not call `parallel_map` itself, which would deadlock; `worth`: false for so little work that one
    core is faster.
    """
    items = list(items)
    try:
        return _pool().map(function, items) if worth else map(function, items)
    except RuntimeError:  # the interpreter is exiting, and the pool takes no more work
        return map(function, items)
