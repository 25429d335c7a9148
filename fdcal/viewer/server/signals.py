"""Ctrl-C and SIGTERM."""

from __future__ import annotations

import contextlib
import signal


class Interrupt:
    """A flag in place of KeyboardInterrupt: the main loop reads `received` and ends in good order.

    A second signal raises KeyboardInterrupt, for a user who does not want to wait for that.

    A context manager; it restores the previous handlers of SIGINT and SIGTERM.
    """

    def __init__(self):
        self.received = False

    def __enter__(self) -> Interrupt:
        self._previous = []
        for number in (signal.SIGINT, signal.SIGTERM):
            with contextlib.suppress(ValueError):  # signals can be handled in the main thread only
                self._previous.append((number, signal.signal(number, self._receive)))
        return self

    def _receive(self, *_) -> None:
        if self.received:
            raise KeyboardInterrupt
        self.received = True

    def __exit__(self, *_) -> None:
        for number, handler in self._previous:
            signal.signal(number, handler)
