"""Signal handlers and the number of BLAS threads: fdcal changes them while it works and restores them afterwards.

The matrices of the solvers are small, and the solvers distribute the modes over threads of their own. More threads of
BLAS would cost more time than they save, especially beside another process. Importing fdcal changes nothing.
"""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator

ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


@contextlib.contextmanager
def handled_by(handler: Callable[..., object], every: bool) -> Iterator[None]:
    """Within the block, let `handler` receive the signals in ENDING that have no handler, or with `every` all of them.

    A signal that was ignored before, as under nohup, stays ignored.
    """
    previous = []
    for number in ENDING:
        before = signal.getsignal(number)
        if before is signal.SIG_DFL or (every and before is not signal.SIG_IGN):
            with contextlib.suppress(ValueError):  # signals can be handled in the main thread only
                previous.append((number, signal.signal(number, handler)))
    try:
        yield
    finally:
        for number, before in previous:
            signal.signal(number, before)


@contextlib.contextmanager
def interrupts(urgent: bool = True) -> Iterator[threading.Event]:
    """Yield an event that Ctrl-C, SIGTERM and SIGHUP set in the block, instead of raising KeyboardInterrupt.

    If `urgent`, a second signal raises KeyboardInterrupt.
    """
    received = threading.Event()

    def receive(*_) -> None:
        if received.is_set() and urgent:
            raise KeyboardInterrupt
        received.set()

    with handled_by(receive, every=True):
        yield received


_lock = threading.Lock()
_computations: list[int] = []  # one entry for each running computation
_limits: list[tuple] = []  # controller, limit and thread of the computation that began first


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread in the block; of several blocks that overlap, the last one removes the limit.

    The limit applies to the whole process, because BLAS has no limit for a single thread.
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


def _release(controller, force: bool = False) -> None:
    """Allow another thread to set limits: from version 3.7 on, threadpoolctl allows only one thread to set them."""
    for library in controller.lib_controllers:
        if hasattr(library, "clear_controlling_thread"):
            library.clear_controlling_thread(force=force)
