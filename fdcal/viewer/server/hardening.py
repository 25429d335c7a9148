"""A viser server that accepts only its own page, and only plain values from it.

viser does not authenticate its clients, and the page opens files. This module refuses all clients but the page itself:
other sites, pages of other programs on this machine, and programs that send no Origin header. It disables the public
share tunnel and all other messages that the page of fdcal does not use, limits the size of messages, and drops updates
that are not values of their control. It changes private parts of viser, whose version is therefore bounded.

GuardedConnection   passes on only messages that `client_values` accepts, at a bounded rate, and disconnects a client
                    that does not read
version_checked     refuses clients of another version of viser, without viser's message on standard output
open_server         the server
LoopEvent           ensures that a message that another thread pushes reaches the browser
encoded             compresses an image quickly rather than as small as possible
"""

import asyncio
import collections
import contextlib
import errno
import functools
import gzip
import http
import io
import ipaddress
import logging
import math
import re
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NoReturn

import numpy as np
import viser
import websockets
import websockets.asyncio.server
import websockets.exceptions
from PIL import Image
from viser import _messages, _scene_api
from viser.infra import _infra
from viser.infra._async_message_buffer import AsyncMessageBuffer
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Response

from ...model.validation import InputError
from .client_values import COSTS, DRAG_START_COST, decoded_message, fits, is_acceptable, is_plain
from .process import printable

log = logging.getLogger(__name__)

Handler = Callable[..., Any]  # a coroutine function
RATE, BURST = 200.0, 400.0  # control updates of one client, per second and at once
FLOOD_TIME = 5.0  # s, total delay of a client beyond its budget after which it is disconnected
OPEN_TIME = 2.0  # s within which a client must send its request; a server that stops waits as long for it
STALL_TIME = 10.0  # s within which a client must read some of the bytes that wait for it
MAX_UNREAD_BYTES = 16_000_000  # bytes that may wait for one client
NOT_READING = "a client that does not read was disconnected"
PROTOCOL_ERROR = 1002  # code with which a connection is closed


REFUSALS = collections.Counter[str]()  # number of log records of refused clients, by kind


def shortened(record: logging.LogRecord) -> bool:
    """Shorten a record of a refused client to one line; return whether it is the 1st, 10th, 100th ... of its kind."""
    error, kind = record.exc_info[1] if record.exc_info else None, record.msg
    if error is not None:
        record.msg, record.args = f"{record.getMessage()} ({type(error).__name__}: {error})", ()
    REFUSALS[kind] += 1
    count = REFUSALS[kind]
    record.msg, record.args = printable(record.getMessage()), ()
    record.exc_info = record.exc_text = record.stack_info = None
    if count > 1:
        record.msg += f" ({count} times so far)"
    return count == 10 ** (len(str(count)) - 1)


log.addFilter(shortened)


class GuardedConnection(ServerConnection):
    """A connection of websockets that passes on what `client_values` accepts, at a bounded rate."""

    _left, _since, _waited = BURST, -math.inf, 0.0  # updates left in the budget; last message and total delay, s

    async def recv(self, decode: bool | None = None):
        """Return the next acceptable message; a client that sends too much for FLOOD_TIME is disconnected."""
        while True:
            raw = await super().recv(decode)
            message = decoded_message(raw)
            now, cost = time.monotonic(), COSTS.get(message["type"], 1.0)
            if message["type"] == "SceneNodeDragMessage" and message.get("phase") == "start":
                cost = DRAG_START_COST
            self._left = min(self._left + (now - self._since) * RATE, BURST) - cost
            self._since, delay = now, max(-self._left / RATE, 0.0)
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
                    self._drop(NOT_READING)
        finally:
            sending.cancel()

    def data_received(self, data: bytes) -> None:
        """Handle data from the client; a client that requests answers and does not read them is disconnected."""
        super().data_received(data)
        if self.transport.get_write_buffer_size() > MAX_UNREAD_BYTES:
            log.warning(NOT_READING)
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


Respond = Callable[..., Response | None]  # gets a connection and a request


TITLE = "fdcal"
OF_VISER = b"<title>Viser</title>"
BUNDLE = re.compile(rb"<script data-p=.*?</script>", re.DOTALL)  # the program of viser's page
STYLE, SCRIPT = (Path(__file__).with_name(name) for name in ("page.css", "page.js"))


def own_page_only(
    respond: Respond, origins: list[re.Pattern[str]], film: str = "", on_sent: Callable[[], None] = lambda: None
) -> Respond:
    """Wrap the function that answers requests for files, so that it answers only pages of this server.

    The header Host must be one of `origins`, and the header Origin must be the same address as Host. A browser sets
    both, and a forwarded port does not change them. The page has our title, style and script. It is sent uncompressed
    to loopback addresses, also through an SSH tunnel, because compression delays the first byte by 30 ms. `film`,
    `on_sent`: as in `open_server`.
    """

    def answer(connection, request) -> Response | None:
        hosts = [host.lower() for host in request.headers.get_all("Host")]
        if not hosts or not all(any(one.fullmatch(f"http://{host}") for one in origins) for host in hosts):
            return connection.respond(http.HTTPStatus.FORBIDDEN, "This server has another name.\n")
        came_from = [origin.partition("//")[2].lower() for origin in request.headers.get_all("Origin")]
        if (came_from or "Upgrade" in request.headers) and came_from != hosts:
            return connection.respond(http.HTTPStatus.FORBIDDEN, "Only the page of this server may connect.\n")
        if request.path.partition("?")[0] == "/" and is_loopback(connection.remote_address[0]):
            request.headers.pop("Accept-Encoding", None)
        try:
            response = respond(connection, request)
        except OSError:  # a name that is too long for a file
            return connection.respond(http.HTTPStatus.NOT_FOUND, "404\n")
        if response is not None and response.headers.get("Content-Type", "").startswith("text/html"):
            response.body = own_page(bytes(response.body), response.headers.get("Content-Encoding") == "gzip", film)
            del response.headers["Content-Length"]
            response.headers["Content-Length"] = str(len(response.body))
            # so that no other site can show the page in a frame and trick users into clicks
            response.headers["Content-Security-Policy"] = "frame-ancestors 'self'"
            on_sent()
        return response

    return answer


@functools.lru_cache(maxsize=4)
def own_page(body: bytes, zipped: bool, film: str = "") -> bytes:
    """Return viser's page with the title TITLE, page.css and page.js; any other page is not changed.

    `body`: bytes of the page; `zipped`: whether gzip has compressed them; `film`: HTML for the beginning of its body.
    """
    plain = gzip.decompress(body) if zipped else body
    style, script = STYLE.read_text(encoding="utf-8"), SCRIPT.read_text(encoding="utf-8")
    head = f"<title>{TITLE}</title><style>{style}</style><script>{script}</script>"
    renamed = plain.replace(OF_VISER, head.encode(), 1)
    if renamed == plain:
        return body
    before, tag, after = renamed.rpartition(b"<body>")
    bundle = BUNDLE.search(before) if film else None
    if bundle is not None:  # the film is drawn before a browser has read the 800 kB of viser's program
        before, after = before.replace(bundle[0], b""), after.replace(b"</body>", bundle[0] + b"</body>")
    renamed = before + tag + film.encode() + after
    return gzip.compress(renamed, 1) if zipped else renamed


FREE_PORT = "use <port> 1024 to 65535, or <port> 0 for a free one"
LOOPBACK = ("localhost", "127.0.0.1", "::1")
MAX_MESSAGE_BYTES = 100_000  # largest size of one message of a browser: a camera, a value, a click


def open_server(host: str, port: int, film: str = "", on_sent: Callable[[], None] = lambda: None) -> viser.ViserServer:
    """Open a server that only its own page can use.

    `host`: address to listen at; `port`: 0 to 65535, where 0 selects a free port; `film`: HTML that the page shows
    before its scene, or ""; `on_sent`: called when the page is about to be sent. InputError if the address cannot be
    used, or if the port is in use.
    """
    if not 0 <= port <= 65535:
        raise InputError(f"port = {port} is out of range", FREE_PORT, key="port")
    try:  # an address that cannot be bound is refused here: viser would wait indefinitely
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except (OSError, UnicodeError, OverflowError) as error:
        if getattr(error, "errno", None) == errno.EADDRINUSE:
            raise InputError(f"port = {port} is in use", FREE_PORT, key="port") from None
        reason = getattr(error, "strerror", None) or error
        problem = f"the server cannot listen at host = {host}, port = {port} ({reason})"
        remedy = "use 127.0.0.1 for this machine alone, and a <port> from 1024 on"
        raise InputError(problem, remedy, key="host") from error
    module: Any = websockets.asyncio.server
    origins = allowed_origins(host)
    serve = module.serve

    def restricted(handler: Handler, *arguments, **given):
        """Listen with a list of allowed origins and bounds of what a client may send."""
        if given.get("process_request") is not None:
            given["process_request"] = own_page_only(given["process_request"], origins, film, on_sent)
        given |= {"origins": origins, "max_size": MAX_MESSAGE_BYTES, "open_timeout": OPEN_TIME}
        given |= {"create_connection": GuardedConnection, "logger": log}
        return serve(version_checked(handler), *arguments, **given)

    install_workarounds()
    module.serve = restricted
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # standard output belongs to the command line
            server = viser.ViserServer(host=host, port=port, verbose=False)
    finally:
        module.serve = serve
    for message in [*server._websock_server._incoming_handlers]:
        name = message.__name__
        if name not in COSTS or name.startswith("FileTransfer"):  # `explore` takes uploads itself
            server._websock_server.unregister_handler(message)
    _drop_bad_updates(server)
    return server


def allowed_origins(host: str) -> list[re.Pattern[str]]:
    """Return the origins from which a page may connect to a server at `host`: a pattern for the names of this machine.

    `host`: address at which the server listens. The pattern accepts any port, because `own_page_only` compares the port
    with that of the header Host.
    """
    names = {*LOOPBACK, host}
    if host not in LOOPBACK:
        names |= {socket.gethostname(), socket.getfqdn()}
    if host in ("0.0.0.0", "::", ""):
        with contextlib.suppress(OSError):  # a host whose own name does not resolve is still reached by other names
            names |= {str(info[4][0]) for info in socket.getaddrinfo(socket.gethostname(), None)}
    alternatives = "|".join(re.escape(f"[{name}]" if ":" in name else name) for name in sorted(names))
    return [re.compile(rf"https?://({alternatives})(:\d+)?", re.IGNORECASE)]


def is_loopback(host: str) -> bool:
    """Return whether only programs of this machine reach a server at `host`."""
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host in LOOPBACK


def _drop_bad_updates(server: viser.ViserServer) -> None:
    """Let a message about a control pass only if it sets the control to a value that it can have."""
    handlers, controls = server._websock_server._incoming_handlers, server.gui._gui_input_handle_from_uuid

    async def handle(handler: Handler, client_id, message) -> None:
        control = controls.get(message.uuid)
        if not (hasattr(control, "on_update") or hasattr(control, "on_click")):  # none, or a progress bar
            return
        if is_plain(message.updates) and fits(control, message.updates["value"]):
            with contextlib.suppress(ValueError, TypeError, OverflowError):  # the control holds another type
                await handler(client_id, message)

    given = handlers[_messages.GuiUpdateMessage]
    handlers[_messages.GuiUpdateMessage] = [functools.partial(handle, handler) for handler in given]


# Workarounds for defects of viser 1.1.1; `docs/viser_defects.py` shows them with viser alone.


class LoopEvent(asyncio.Event):
    """An event that only its own event loop can set; on this loop viser sets the event after every message.

    The method `wait` finds the event unset, and then queues its future. If another thread sets the event in between,
    `wait` never returns, because later calls of `set` find the event set and do nothing. The browser then gets no more
    messages.
    """

    own: asyncio.AbstractEventLoop

    def set(self) -> None:
        """Set the event if the caller runs on its event loop, else do nothing."""
        with contextlib.suppress(RuntimeError):  # no event loop runs on this thread
            if asyncio.get_running_loop() is self.own:
                super().set()


class SafeMessageBuffer(AsyncMessageBuffer):
    """A buffer whose messages all reach the browsers, whichever thread pushes them."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.message_event = event = LoopEvent()
        event.own = self.event_loop


LEVEL = 1  # level of compression, 0 to 9
QUALITY = 75  # quality of a JPEG image unless given


def encoded(
    format: Literal["png", "jpeg"], image: np.ndarray, jpeg_quality: int | None, channel_ordering: Literal["rgb", "bgr"]
) -> bytes:
    """Return an image (h, w, 3) or (h, w, 4) uint8 as a file; the parameters are those of viser's function."""
    if channel_ordering == "bgr":
        image = image[:, :, [2, 1, 0, 3][: image.shape[2]]]
    file, options = io.BytesIO(), {"compress_level": LEVEL} if format == "png" else {"quality": jpeg_quality or QUALITY}
    Image.fromarray(np.ascontiguousarray(image)).save(file, format, **options)
    return file.getvalue()


def install_workarounds() -> None:
    """Replace viser's buffer and encoder by ours, for servers and clients created from now on."""
    servers: Any = _infra
    images: Any = _scene_api
    servers.AsyncMessageBuffer, images.cv2_imencode_with_fallback = SafeMessageBuffer, encoded
