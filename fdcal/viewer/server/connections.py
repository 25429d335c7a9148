"""One browser's connection, bounded in what it may send, how fast, and how much may wait to be read by it.

GuardedConnection   passes on only messages that `client_values` accepts
Budget              how long a client must wait before its next message is handled
version_checked     refuses clients of another version of viser, without viser's message on standard output
"""

import asyncio
import logging
import time
from collections.abc import Callable
from typing import Any, NoReturn

import viser
import websockets.exceptions
from websockets.asyncio.server import ServerConnection

from .client_values import decoded_message, is_acceptable, message_cost
from .process import printable

log = logging.getLogger(__name__)

Handler = Callable[..., Any]  # a coroutine function
RATE, BURST = 200.0, 400.0  # control updates per second of one client, and at once
FLOOD_TIME = 5.0  # s that a client may have to wait in all, before it has been within its budget again
STALL_TIME = 10.0  # s in which a client must read something of what waits for it
MAX_UNREAD_BYTES = 16_000_000  # that wait for one client
FOREIGN_ORIGIN = "http://foreign.invalid"  # of the server's own probe (`hardening`)
DEAF = "a client that does not read was disconnected"
PROTOCOL_ERROR = 1002  # code of a closed connection


class Budget:
    """A number of updates that refills steadily.

    `rate`: updates per second; `burst`: updates at once; `clock`: function that returns the time, s.
    """

    def __init__(self, rate: float = RATE, burst: float = BURST, clock: Callable[[], float] = time.monotonic):
        self._rate, self._burst, self._clock = rate, burst, clock
        self._left, self._since = burst, clock()

    def spend(self, cost: float) -> float:
        """Take `cost` updates; return the time until the next message may be handled, s."""
        now = self._clock()
        self._left = min(self._left + (now - self._since) * self._rate, self._burst) - cost
        self._since = now
        return max(-self._left / self._rate, 0.0)


class StrangerFilter(logging.Filter):
    """Reduces what strangers cause to one short line without a traceback, the 1st, 10th, 100th ... time of each."""

    def __init__(self):
        super().__init__()
        self._counts: dict[str, int] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Shorten a record; return whether it is kept."""
        error, kind = record.exc_info[1] if record.exc_info else None, record.msg
        if error is not None:
            record.msg, record.args = f"{record.getMessage()} ({type(error).__name__}: {error})", ()
        if FOREIGN_ORIGIN in str(error):  # the server's own probe
            return False
        count = self._counts[kind] = self._counts.get(kind, 0) + 1
        record.msg, record.args = printable(record.getMessage()), ()
        record.exc_info = record.exc_text = record.stack_info = None
        if count > 1:
            record.msg += f" ({count} times so far)"
        return count == 10 ** (len(str(count)) - 1)


class GuardedConnection(ServerConnection):
    """A connection of websockets that passes on what `client_values` accepts, at a bounded rate."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self._budget, self._waited = Budget(), 0.0

    async def recv(self, decode: bool | None = None):
        """Return the next acceptable message; a client that sends too much for FLOOD_TIME is disconnected."""
        while True:
            raw = await super().recv(decode)
            message = decoded_message(raw)
            delay = self._budget.spend(message_cost(message))
            self._waited = self._waited + delay if delay > 0 else 0.0
            if self._waited > FLOOD_TIME:
                self._drop("a client that sends too much was disconnected")
            if delay > 0:
                await asyncio.sleep(delay)  # meanwhile websockets stops reading from this client
            if is_acceptable(message):
                return raw
            log.warning("a message that no page sends was dropped")

    async def send(self, message, text: bool | None = None) -> None:
        """Send a message; a client that reads nothing for STALL_TIME is disconnected."""
        sending = asyncio.ensure_future(super().send(message, text))
        try:
            while True:
                unread = self.transport.get_write_buffer_size()
                done, _ = await asyncio.wait({sending}, timeout=STALL_TIME)
                if done:
                    return sending.result()
                if self.transport.get_write_buffer_size() >= unread:
                    self._drop(DEAF)
        finally:
            sending.cancel()

    def data_received(self, data: bytes) -> None:
        """Handle data from the client; one that asks for answers and does not read them is disconnected."""
        super().data_received(data)
        if self.transport.get_write_buffer_size() > MAX_UNREAD_BYTES:
            log.warning(DEAF)
            self.transport.abort()

    def _drop(self, reason: str) -> NoReturn:
        log.warning(reason)
        self.transport.abort()
        raise websockets.exceptions.ConnectionClosedError(None, None)


def version_checked(handler: Handler) -> Handler:
    """Wrap the handler of a connection: other versions and malformed messages end it without output or traceback."""

    async def handle(connection) -> None:
        version = (connection.subprotocol or "").removeprefix("viser-v")
        if version != viser.__version__:
            log.warning("a client of another version of viser was refused")
            reason = f"Version mismatch. Client: {printable(version, 20)}, Server: {viser.__version__}"
            await connection.close(PROTOCOL_ERROR, reason)
            return
        try:
            await handler(connection)
        except websockets.exceptions.ConnectionClosed:
            raise
        except Exception as error:
            log.warning("a client sent a malformed message and was disconnected (%s)", type(error).__name__)

    return handle


log.addFilter(StrangerFilter())
