"""A thread that runs only the newest request: for cost maps, pictures and other results that may arrive late."""

import collections
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from ..model.validation import InputError

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Delivery:
    """Result of a `LatestWorker`: the request, its result or its exception, and readings of `time.perf_counter`, s."""

    request: tuple
    result: Any = None
    error: str = ""
    cause: Exception | None = None
    began: float = 0.0
    ended: float = 0.0


class WakeEvent(threading.Event):
    """Ends the waiting of a loop early; any thread may `set` it."""

    def wait(self, timeout: float | None = None) -> bool:
        """Block until the event is set, and clear it; return False if it is not set within `timeout`, s."""
        happened = super().wait(timeout)
        if happened:  # one that comes after the end of the waiting counts for the next
            self.clear()
        return happened


class LatestWorker:
    """A thread that calls `function` with the newest requests; older ones than the `keep` that wait are dropped.

    An exception becomes `latest.error`; the thread continues, and calls `notify` after every delivery. `latest`: the
    newest delivery; `requested`: the arguments that `newest` has requested last; None where they count no longer.
    """

    def __init__(
        self,
        function: Callable,
        name: str = "fdcal-worker",
        keep: int = 1,
        notify: Callable[[], None] = lambda: None,
    ):
        self._function, self._notify = function, notify
        self._changed = threading.Condition()
        self._waiting: collections.deque[tuple] = collections.deque(maxlen=keep)
        self._busy = self._closed = False
        self.latest: Delivery | None = None
        self.requested: tuple | None = None
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)
        self._thread.start()

    @property
    def busy(self) -> bool:
        """Whether a request waits or is running."""
        with self._changed:
            return self._busy or bool(self._waiting)

    @property
    def full(self) -> bool:
        """Whether one more request would drop one that waits."""
        return len(self._waiting) == self._waiting.maxlen

    def request(self, *arguments) -> None:
        """Request `function(*arguments)`; if the queue is `full`, this replaces the oldest request that waits."""
        with self._changed:
            self._waiting.append(arguments)
            self._changed.notify_all()

    def newest(self, *arguments) -> Delivery | None:
        """Request the computation, unless it was requested last; return the newest delivery, perhaps an older one."""
        if arguments != self.requested:
            self.requested = arguments
            self.request(*arguments)
        return self.latest

    def wants(self, *arguments) -> bool:
        """Return whether a request still counts: what a long computation asks between its parts."""
        return self.requested == arguments

    def wait_for(self, predicate: Callable[[Delivery | None], bool], timeout: float | None = None) -> bool:
        """Block until `predicate(latest)` is true; return False if it is not within `timeout` seconds."""
        with self._changed:
            return self._changed.wait_for(lambda: predicate(self.latest), timeout)

    def close(self, timeout: float = 2.0) -> bool:
        """End the thread after the running request; return False if that takes longer than `timeout` seconds."""
        with self._changed:
            self._closed, self.requested = True, None
            self._changed.notify_all()
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _serve(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._waiting)
                if self._closed:
                    return
                arguments, self._busy = self._waiting.popleft(), True
            began = time.perf_counter()
            try:
                delivery = Delivery(arguments, result=self._function(*arguments))
            except Exception as error:
                expected = isinstance(error, (InputError, OSError))  # the caller reports it, in one line
                log.log(logging.DEBUG if expected else logging.ERROR, "%s failed", self._thread.name, exc_info=True)
                delivery = Delivery(arguments, error=f"{type(error).__name__}: {error}", cause=error)
            delivery = replace(delivery, began=began, ended=time.perf_counter())
            with self._changed:
                self.latest, self._busy = delivery, False
                self._changed.notify_all()
            self._notify()
