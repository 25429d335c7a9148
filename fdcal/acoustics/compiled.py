"""Compilation to machine code, threads on up to four cores, and deadlines.

numba stores machine code beside the source. If the folder of the source is read-only, it stores the code under
FDCAL_CACHE if that is set, otherwise in the user's cache folder. If no folder can be written to, every run compiles
again.

The likelihood solvers call no compiled function. Otherwise their first run would have to wait for the compiler, and
every run for the import of numba.
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
Result = TypeVar("Result")


def compiled(function: Callable[P, Result], **options: Any) -> Callable[P, Result]:
    """Decorate a function so that its first call with each combination of argument types compiles it.

    The machine code is cached on disk. The compiled function releases the interpreter's lock. `options` are keyword
    arguments of `numba.njit`. For numba, read-only and writable arrays are different types: a function that is called
    with both is compiled twice.
    """
    import numba
    from numba.core import config

    has_folder = getattr(config, "CACHE_DIR", "") or os.access(Path(__file__).parent, os.W_OK)
    if "FDCAL_CACHE" in os.environ and not has_folder:
        config.CACHE_DIR = str(Path(os.environ["FDCAL_CACHE"]) / "compiled")  # pyright: ignore[reportAttributeAccessIssue]
    options = {"nogil": True, "error_model": "numpy", **options}
    try:
        return numba.njit(function, cache=True, **options)
    except RuntimeError:  # no folder that numba may write to
        return numba.njit(function, **options)


MAX_THREADS = 4  # largest number of threads of a pool


@functools.cache
def _pool(name: str) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(min(MAX_THREADS, os.cpu_count() or 1), f"fdcal-{name}")


def shut_down_threads() -> None:
    """End the threads of `parallel_map` after their current work; a later call starts new ones."""
    for name in ("modes", "takes"):
        _pool(name).shutdown()
    _pool.cache_clear()


def parallel_map(
    function: Callable[[Item], Result], items: Iterable[Item], threaded: bool = True, pool: str = "modes"
) -> Iterator[Result]:
    """Return an iterator over the values of a function for all items, in their order, computed by up to 4 threads.

    The function must not call `parallel_map`, because that could deadlock. Pass `threaded=False` if there is so little
    work that one thread is faster. `pool` names the pool of threads, "modes" or "takes". A function that takes long
    must use "takes", because solvers and maps wait for the threads of "modes".
    """
    items = list(items)
    runs = [partial(copy_context().run, function, item) for item in items]  # the context holds this thread's deadline
    try:
        return _pool(pool).map(lambda run: run(), runs) if threaded else map(function, items)
    except RuntimeError:  # `shut_down_threads` has been called, and the pool accepts no more work
        return map(function, items)


_time_is_up: ContextVar[Callable[[], bool] | None] = ContextVar("time_is_up", default=None)


class OutOfTime(Exception):
    """The time limit of a calculation has passed."""


@contextmanager
def deadline(end: float, clock: Callable[[], float]) -> Generator[None]:
    """Make `check_deadline` raise OutOfTime inside this context once `clock()`, seconds, is past `end`.

    The deadline applies to the thread that sets it, and to the threads of `parallel_map` that work for this thread.
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
