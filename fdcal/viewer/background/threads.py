"""The threads of one session: whoever needs one starts it here, and all of them end together."""

import time
from collections.abc import Callable
from typing import Protocol

from ...session.worker import Delivery, LatestWorker


class Closable(Protocol):
    """What has threads to be ended."""

    def close(self, timeout: float) -> bool:
        """End the threads after the work in progress; False if that takes longer than `timeout`, s."""
        ...


class Background(LatestWorker):
    """A computation on a thread of its own, of which only the newest request counts.

    `requested`: the arguments of the newest request, None where it was cancelled.
    """

    requested: tuple | None = None

    def newest(self, *arguments) -> Delivery | None:
        """Request the computation, unless it was requested last; return the newest delivery, perhaps an older one."""
        if arguments != self.requested:
            self.requested = arguments
            self.request(*arguments)
        return self.latest

    @property
    def current(self) -> Delivery | None:
        """The delivery of the newest request; None while it is computed, or where it was cancelled."""
        latest = self.latest
        return latest if latest is not None and latest.request == self.requested else None

    def wants(self, *arguments) -> bool:
        """Return whether a request still counts: what a long computation asks between its parts."""
        return self.requested == arguments

    def cancel(self) -> None:
        """Let the request in progress count no longer."""
        self.requested = None

    def close(self, timeout: float = 2.0) -> bool:
        """End the thread after the work in progress; False if that takes longer than `timeout`, s."""
        self.cancel()
        return super().close(timeout)


class Threads:
    """Owns all that has to be ended with a session.

    `wake`: function that makes the main loop update the page at once.
    """

    def __init__(self, wake: Callable[[], None] = lambda: None):
        self._wake = wake
        self._owned: list[Closable] = []
        self._abandoned: list[Closable] = []

    def start(
        self, function: Callable, name: str, keep: int = 1, wakes: bool = False, awaited: bool = True
    ) -> Background:
        """Start a thread that calls `function` with the arguments of each request.

        `keep`: requests that may wait; `wakes`: whether a delivery makes the main loop update the page at once;
        `awaited`: whether `close` waits for the work in progress.
        """
        worker = Background(function, name, keep, self._wake if wakes else lambda: None)
        (self._owned if awaited else self._abandoned).append(worker)
        return worker

    def own(self, owner: Closable) -> None:
        """End something else with the threads."""
        self._owned.append(owner)

    def close(self, timeout: float) -> None:
        """End everything after the work in progress; wait `timeout` at most, s."""
        end = time.perf_counter() + timeout
        for owner in (*self._owned, *self._abandoned):  # all are asked to stop before any is waited for
            owner.close(0.0)
        for owner in self._owned:
            owner.close(max((end - time.perf_counter()) / 2, 0.0))
