"""A message buffer for viser that wakes the server's event loop reliably.

`AsyncMessageBuffer.push` sets an asyncio event on the calling thread, although such an event belongs to its loop. If
the loop changes the event's waiters at that moment, `push` raises and does not wake the loop. The message is in the
queue by then. These classes are private parts of viser, which is why its version is pinned.
"""

from __future__ import annotations

import contextlib

from viser.infra import _infra
from viser.infra._async_message_buffer import AsyncMessageBuffer


class SafeMessageBuffer(AsyncMessageBuffer):
    """A buffer that always wakes the event loop."""

    def push(self, message) -> None:
        """Queue a message; any thread."""
        try:
            super().push(message)
        except RuntimeError:  # "deque mutated during iteration"
            with contextlib.suppress(RuntimeError):  # the loop is closed
                self.event_loop.call_soon_threadsafe(self.message_event.set)


def use_safe_buffers() -> None:
    """Have viser use these buffers for servers and clients that are created from now on.

    Raises AttributeError: viser no longer has the name under which it takes them.
    """
    if not hasattr(_infra, "AsyncMessageBuffer"):
        raise AttributeError("viser has no AsyncMessageBuffer")
    setattr(_infra, "AsyncMessageBuffer", SafeMessageBuffer)  # noqa: B010  the name is private to viser's module
