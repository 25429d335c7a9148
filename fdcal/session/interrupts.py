"""Signals that end a program: it notes them, and ends what it does in good order."""

from __future__ import annotations

import contextlib
import signal

ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class Interrupt:
    """A flag in place of KeyboardInterrupt, of Ctrl-C, SIGTERM and SIGHUP: a loop reads `received`.

    `urgent`: a second signal raises KeyboardInterrupt, for a user who does not want to wait. A signal that was ignored
    before, as under nohup, stays ignored. A context manager; it restores the previous handlers.
    """

    def __init__(self, urgent: bool = True):
        self.received, self._urgent = False, urgent

    def __enter__(self) -> Interrupt:
        self._previous = []
        for number in ENDING:
            if signal.getsignal(number) is not signal.SIG_IGN:
                with contextlib.suppress(ValueError):  # signals can be handled in the main thread only
                    self._previous.append((number, signal.signal(number, self._receive)))
        return self

    def _receive(self, *_) -> None:
        if self.received and self._urgent:
            raise KeyboardInterrupt
        self.received = True

    def __exit__(self, *_) -> None:
        for number, handler in self._previous:
            signal.signal(number, handler)
