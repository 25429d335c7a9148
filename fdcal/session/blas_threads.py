"""BLAS on one thread while fdcal computes.

The matrices of the solvers are small and their own threads share the work by modes: more threads of BLAS cost more time
than they save, most of all beside another process. The limit is taken back after the computation, and importing fdcal
changes nothing.
"""

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

VARIABLE = "OPENBLAS_NUM_THREADS"
_lock = threading.Lock()
_computations: list[int] = []  # one entry for each computation that runs
_limits: list[tuple] = []  # of the first of them: controller, limit, thread


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread in the block; the last of several blocks that overlap restores what was before.

    The limit holds for the process, since BLAS knows no other.
    """
    import numpy  # noqa: F401  a library that is loaded later would not be limited
    import scipy.linalg  # noqa: F401  has a BLAS of its own
    from threadpoolctl import ThreadpoolController

    with _lock:
        if not _computations:
            controller = ThreadpoolController()
            _limits.append((controller, controller.limit(limits=1, user_api="blas"), threading.get_ident()))
        _computations.append(1)
    try:
        yield
    finally:
        with _lock:
            _computations.pop()
            if not _computations:
                controller, limit, thread = _limits.pop()
                _release(controller, force=thread != threading.get_ident())
                limit.restore_original_limits()
                _release(controller)


@contextmanager
def one_blas_thread_for_command() -> Iterator[None]:
    """Limit BLAS to one thread in the block, without loading NumPy before a command needs it.

    Where NumPy is not loaded yet, BLAS reads the environment when it is, as do child processes; the environment is
    restored after the block.
    """
    if "numpy" in sys.modules:
        with one_blas_thread():
            yield
        return
    before = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = before or "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[VARIABLE]


def _release(controller, force: bool = False) -> None:
    """Let another thread set limits: from version 3.7 on, threadpoolctl lets one thread do so for a process."""
    for library in controller.lib_controllers:
        if hasattr(library, "clear_controlling_thread"):
            library.clear_controlling_thread(force=force)
