"""Workarounds for defects of viser 1.1.1, which change private parts of it, so that its version is pinned.

`docs/viser_defects.py` shows them with viser alone.

LoopEvent   a message that another thread pushes may never reach the browser
encoded     an image is compressed as small as possible, which takes ten times as long
"""

import asyncio
import contextlib
import io
from typing import Any, Literal

import numpy as np
from PIL import Image
from viser import _scene_api
from viser.infra import _infra
from viser.infra._async_message_buffer import AsyncMessageBuffer


class LoopEvent(asyncio.Event):
    """An event that only its own event loop sets; viser sets it there, too, after every message.

    `wait` finds an event unset, and then queues its future. If another thread sets the event between the two, `wait`
    never returns, because later calls of `set` find the event set and do nothing. The browser gets no more messages.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop):
        super().__init__()
        self._own = loop

    def set(self) -> None:
        """Set the event if the caller runs on its event loop, else do nothing."""
        with contextlib.suppress(RuntimeError):  # no event loop runs on this thread
            if asyncio.get_running_loop() is self._own:
                super().set()


class SafeMessageBuffer(AsyncMessageBuffer):
    """A buffer whose messages all reach the browsers, whichever thread pushes them."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.message_event = LoopEvent(self.event_loop)


LEVEL = 1  # of compression, 0 to 9
QUALITY = 75  # of a JPEG image unless given


def encoded(
    format: Literal["png", "jpeg"], image: np.ndarray, jpeg_quality: int | None, channel_ordering: Literal["rgb", "bgr"]
) -> bytes:
    """Return an image (h, w, 3) or (h, w, 4) uint8 as a file; the parameters are those of viser's function."""
    if channel_ordering == "bgr":
        image = image[:, :, [2, 1, 0, 3][: image.shape[2]]]
    file, options = io.BytesIO(), {"compress_level": LEVEL} if format == "png" else {"quality": jpeg_quality or QUALITY}
    Image.fromarray(np.ascontiguousarray(image)).save(file, format, **options)
    return file.getvalue()


def mend() -> None:
    """Replace viser's buffer and encoder by ours, for servers and clients created from now on."""
    servers: Any = _infra
    images: Any = _scene_api
    servers.AsyncMessageBuffer, images.cv2_imencode_with_fallback = SafeMessageBuffer, encoded
