"""A thread that runs only the newest request made to it: for maps, pictures and whatever else may be late.

Nothing here knows a screen or a solver.
"""

from __future__ import annotations

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
    """What a `LatestWorker` made: the request's arguments, and its result or the exception, as text too.

    `began` and `ended` are readings of `time.perf_counter`, s.
    """

    request: tuple
    result: Any = None
    error: str = ""
    cause: Exception | None = None
    began: float = 0.0
    ended: float = 0.0


class WakeEvent:
    """Has a loop go round sooner than it would by itself."""

    def __init__(self):
        self._rung = threading.Event()

    def set(self) -> None:
        """Any thread."""
        self._rung.set()

    def wait(self, timeout: float) -> bool:
        """Block until somebody rings, or has rung since the last time; False if nobody did within `timeout`, s."""
        rung = self._rung.wait(timeout)
        self._rung.clear()
        return rung


class LatestWorker:
    """A thread that runs only the newest request, or the newest `keep`, oldest first; others that wait are dropped.

    `latest` is the newest `Delivery`, None before the first; `notify` is called once there is a new one. An exception
    becomes `latest.error`; the thread lives on.
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
        self._latest: Delivery | None = None
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)
        self._thread.start()

    @property
    def latest(self) -> Delivery | None:
        return self._latest

    @property
    def busy(self) -> bool:
        """Whether a request waits or is being worked on."""
        with self._changed:
            return self._busy or bool(self._waiting)

    @property
    def full(self) -> bool:
        """Whether one more request would drop one that waits."""
        return len(self._waiting) == self._waiting.maxlen

    def request(self, *arguments) -> None:
        """Ask for `function(*arguments)`, in place of the oldest request not begun yet where it is `full`."""
        with self._changed:
            self._waiting.append(arguments)
            self._changed.notify_all()

    def wait_for(self, predicate: Callable[[Delivery | None], bool], timeout: float | None = None) -> bool:
        """Block until `predicate(latest)` holds; False if it did not within `timeout` seconds."""
        with self._changed:
            return self._changed.wait_for(lambda: predicate(self._latest), timeout)

    def close(self, timeout: float = 2.0) -> bool:
        """End the thread after the request under way; False if it was still at work after `timeout` seconds."""
        with self._changed:
            self._closed = True
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
            delivery = replace(self._work(arguments), began=began, ended=time.perf_counter())
            with self._changed:
                self._latest, self._busy = delivery, False
                self._changed.notify_all()
            self._notify()

    def _work(self, arguments: tuple) -> Delivery:
        try:
            return Delivery(arguments, result=self._function(*arguments))
        except Exception as error:
            expected = isinstance(error, (InputError, OSError))  # whoever asked reports it, in one line
            log.log(logging.DEBUG if expected else logging.ERROR, "%s failed", self._thread.name, exc_info=True)
            return Delivery(arguments, error=f"{type(error).__name__}: {error}", cause=error)
