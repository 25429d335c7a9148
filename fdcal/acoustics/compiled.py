"""Compilation to machine code, threads on all cores, and deadlines.

numba stores machine code beside the source, or in the user's cache folder if the source is read-only. A read-only
installation stores it under FDCAL_CACHE if that is set. If no folder can be written to, every run compiles again.

The functions of a calibration are not compiled, since its first run would wait for the compiler, and every run for
numba to load.
"""

import functools
import os
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import partial
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
Item = TypeVar("Item")
Found = TypeVar("Found")


def compiled(function: Callable[P, Found], **options: Any) -> Callable[P, Found]:
    """Decorate a function to be compiled at its first call with arguments of each type, and cached on disk.

    It runs without the interpreter's lock; `options`: of `numba.njit`. For numba a read-only array is of another type
    than a writable one.
    """
    import numba
    from numba.core import config

    elsewhere = getattr(config, "CACHE_DIR", "") or os.access(Path(__file__).parent, os.W_OK)
    if "FDCAL_CACHE" in os.environ and not elsewhere:
        config.CACHE_DIR = str(Path(os.environ["FDCAL_CACHE"]) / "compiled")  # pyright: ignore[reportAttributeAccessIssue]
    options = {"nogil": True, "error_model": "numpy", **options}
    try:
        return numba.njit(function, cache=True, **options)
    except RuntimeError:  # no folder that numba may write to
        return numba.njit(function, **options)


MAX_THREADS = 4


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(min(MAX_THREADS, os.cpu_count() or 1), "fdcal-modes")


def shut_down_threads() -> None:
    """End the threads of `parallel_map` after their current work; a later call starts new ones."""
    pool = _pool()
    _pool.cache_clear()
    pool.shutdown()


def parallel_map(function: Callable[[Item], Found], items: Iterable[Item], worth: bool = True) -> Iterator[Found]:
    """Return an iterator over the values of a function for all items, in their order, computed on all cores.

    The function must not call `parallel_map`, which would be a deadlock. `worth` is false for so little work that one
    core is faster.
    """
    items = list(items)
    runs = [partial(copy_context().run, function, item) for item in items]  # with the deadline of this thread
    try:
        return _pool().map(lambda run: run(), runs) if worth else map(function, items)
    except RuntimeError:  # the interpreter is exiting, and the pool takes no more work
        return map(function, items)


_time_is_up: ContextVar[Callable[[], bool] | None] = ContextVar("time_is_up", default=None)


class OutOfTime(Exception):
    """The time limit of a calculation has passed."""


@contextmanager
def deadline(end: float, clock: Callable[[], float]) -> Generator[None]:
    """Make `check_deadline` raise OutOfTime inside this context once `clock()`, seconds, is past `end`.

    A deadline applies to the thread that sets it, and to those of `parallel_map` that work for it.
    """
    token = _time_is_up.set(lambda: clock() > end)
    try:
        yield
    finally:
        _time_is_up.reset(token)


def check_deadline() -> None:
    """Raise OutOfTime if the deadline of this thread has passed; without a deadline do nothing."""
    time_is_up = _time_is_up.get()
    if time_is_up is not None and time_is_up():
        raise OutOfTime
