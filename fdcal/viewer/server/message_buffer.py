"""viser's queue of what goes to the pages, made safe for the main loop.

`push` sets an asyncio event on the thread that calls it, too, though such an event belongs to its loop: now and then
one whose waiters the loop just then changes raises, and what should wake the loop is left out. The message is in the
queue by then. viser's private part, hence its pinned version.
"""

from __future__ import annotations

import contextlib

from viser.infra import _infra
from viser.infra._async_message_buffer import AsyncMessageBuffer


class Buffer(AsyncMessageBuffer):
    """One that wakes the loop in any case."""

    def push(self, message) -> None:
        """Queue a message; any thread."""
        try:
            super().push(message)
        except RuntimeError:  # "deque mutated during iteration"
            with contextlib.suppress(RuntimeError):  # a loop that is closed has nobody to wake
                self.event_loop.call_soon_threadsafe(self.message_event.set)


def use_safe_buffers() -> None:
    """Have viser use them for servers, and for clients who come, from now on."""
    _infra.AsyncMessageBuffer = Buffer
