"""Two defects of viser 1.1.1, shown with viser alone: `python docs/viser_defects.py`.

`fdcal/viewer/server/hardening.py` works round both. Without a defect each line ends with "as it should be".
"""

import asyncio
import threading
import time

import numpy as np
from viser import _messages, _scene_api
from viser.infra._async_message_buffer import AsyncMessageBuffer


async def message_arrives() -> bool:
    """Return whether a message arrives that another thread pushes just as the sender begins to wait.

    `push` sets an asyncio.Event on its own thread. If that happens after `Event.wait` has found the event unset and
    before its future is queued, the future is not woken: the second `set`, on the event loop, finds the event set and
    does nothing. A browser gets no more messages. Here the thread is made to come at that moment.
    """
    buffer = AsyncMessageBuffer(asyncio.get_running_loop(), persistent_messages=True)
    event = buffer.message_event
    get_loop = event._get_loop  # `wait` calls it between the two

    def push_in_between() -> asyncio.AbstractEventLoop:
        event._get_loop = get_loop
        other = threading.Thread(target=buffer.push, args=(_messages.RunJavascriptMessage("1"),))
        other.start()
        other.join()
        return get_loop()

    event._get_loop = push_in_between
    try:
        await asyncio.wait_for(anext(buffer.window_generator(0)), 3)
    except TimeoutError:
        return False
    return True


def image_time() -> float:
    """Return the time to encode 500 x 500 smooth colours as PNG, s; viser chooses the highest compression."""
    image = np.indices((500, 500, 3)).sum(axis=0).astype(np.uint8)
    began = time.perf_counter()
    _scene_api.cv2_imencode_with_fallback("png", image, None, "rgb")
    return time.perf_counter() - began


if __name__ == "__main__":
    arrives, seconds = asyncio.run(message_arrives()), image_time()
    print("a message from another thread:", "as it should be" if arrives else "never arrives")
    print(f"an image: {1e3 * seconds:.0f} ms,", "as it should be" if seconds < 0.02 else "of which most is compression")
