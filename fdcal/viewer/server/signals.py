"""Ctrl-C and SIGTERM."""

from __future__ import annotations

import contextlib
import signal


class Interrupt:
    """Ctrl-C as a flag, so that nothing is torn in the middle: the loops look at `came`. A context manager."""

    def __init__(self):
        self.came = False

    def __enter__(self) -> Interrupt:
        self._before = []
        for number in (signal.SIGINT, signal.SIGTERM):
            with contextlib.suppress(ValueError):  # outside the main thread there are no signals to hear
                self._before.append((number, signal.signal(number, self._note)))
        return self

    def _note(self, *_) -> None:
        self.came = True

    def __exit__(self, *_) -> None:
        for number, handler in self._before:
            signal.signal(number, handler)
