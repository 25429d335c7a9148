"""Who may connect to the page, and what a client may say.

viser itself asks nobody who they are. Here pages of other sites are refused by their Origin, the public share tunnel
is out of reach, and what a client sends is a plain number or a short text before any of this project's code sees it.
Both hooks are viser's private parts, hence its pinned version.
"""

from __future__ import annotations

import contextlib
import io
import logging
import math
import re
import socket
from collections.abc import Callable
from unittest import mock

import viser
import websockets.asyncio.server
import websockets.exceptions
from viser import _messages

from ...model.validation import InputError
from .message_buffer import use_safe_buffers

log = logging.getLogger(__name__)

LOOPBACK = ("localhost", "127.0.0.1", "::1")
LONGEST = 200  # characters of a client's text
MOST_BYTES = 100_000  # of one message of a client: cameras, values, clicks
UNHEARD = (  # what no page of fdcal says: the public tunnel, uploads, forms, gizmos
    _messages.ShareUrlRequest,
    _messages.ShareUrlDisconnect,
    _messages.FileTransferStartUpload,
    _messages.FileTransferPart,
    _messages.GuiFormSubmitMessage,
    _messages.GuiFormDirtyMessage,
    _messages.TransformControlsUpdateMessage,
    _messages.TransformControlsDragStartMessage,
    _messages.TransformControlsDragEndMessage,
)


def open_server(host: str, port: int) -> viser.ViserServer:
    """A server at `host` and `port` (0 takes a free one) that only its own page may talk to.

    Raises InputError for a bad address or a port in use.
    """
    _require_address(host, port)
    use_safe_buffers()
    serve = websockets.asyncio.server.serve

    def listen(handler, *arguments, **named):
        return serve(
            _patient(handler), *arguments, **{**named, "origins": allowed_origins(host), "max_size": MOST_BYTES}
        )

    with mock.patch.object(websockets.asyncio.server, "serve", listen):
        server = quietly(lambda: viser.ViserServer(host=host, port=port, verbose=False))
    if port and server.get_port() != port:  # viser takes the next free one without a word
        server.stop()
        raise InputError(f"port = {port} is in use; choose another, or 0 for a free one")
    for unused in UNHEARD:
        server._websock_server.unregister_handler(unused)
    _guard_inputs(server)
    return server


def _silent() -> logging.Logger:
    """For what websockets says of connections that come to nothing: who knocks must not fill the terminal."""
    logger = logging.getLogger(f"{__name__}.sockets")
    logger.setLevel(logging.CRITICAL + 1)
    return logger


def _patient(handler: Callable) -> Callable:
    """The handler of a connection, which a client that sends what is no message ends without a traceback."""

    async def handle(connection) -> None:
        try:
            await handler(connection)
        except websockets.exceptions.ConnectionClosed:
            raise
        except Exception as error:
            log.warning("a client was let go that sent what is no message (%s)", type(error).__name__)

    return handle


def quietly(function: Callable):
    """Call a function of viser without what it prints: standard output belongs to the command line."""
    with contextlib.redirect_stdout(io.StringIO()):
        return function()


def allowed_origins(host: str) -> list:
    """Origins a page may come from: this machine's names, or none at all (programs send no Origin)."""
    names = {*LOOPBACK, host}
    if host not in LOOPBACK:
        names |= {socket.gethostname(), socket.getfqdn()}
    if host in ("0.0.0.0", "::", ""):
        with contextlib.suppress(OSError):  # a host whose own name does not resolve is still reached by the others
            names |= {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None)}
    words = "|".join(re.escape(f"[{name}]" if ":" in name else name) for name in sorted(names))
    return [re.compile(rf"https?://({words})(:\d+)?", re.IGNORECASE), None]


def _require_address(host: str, port: int) -> None:
    """viser waits for ever on an address that cannot be listened at: try it first."""
    if not 0 <= port <= 65535:
        raise InputError(f"port = {port} is out of range; use 0 to 65535, where 0 takes a free one")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except (OSError, UnicodeError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"host = {host}, port = {port} cannot be listened at ({reason}); choose another") from error


def _guard_inputs(server: viser.ViserServer) -> None:
    """Pass on a client's message about a control only if it sets the value, and only to something plain."""
    handlers = server._websock_server._incoming_handlers
    heard = handlers[_messages.GuiUpdateMessage]

    def guarded(handler):
        async def hear(client_id, message):
            if is_plain(message.updates):
                with contextlib.suppress(ValueError, TypeError, OverflowError):  # not of the control's type
                    await handler(client_id, message)

        return hear

    handlers[_messages.GuiUpdateMessage] = [guarded(handler) for handler in heard]


def is_plain(updates) -> bool:
    """Whether a client's updates are one value: a truth value, a finite number or a short text."""
    if not isinstance(updates, dict) or set(updates) != {"value"}:
        return False
    value = updates["value"]
    if isinstance(value, str):
        return len(value) <= LONGEST
    return isinstance(value, int) or (isinstance(value, float) and math.isfinite(value))


def bounded(value, low: int, high: int, otherwise: int) -> int:
    """`value` as a whole number from `low` to `high`; `otherwise` if it is no number."""
    try:
        return min(max(round(float(value)), low), high)
    except (TypeError, ValueError, OverflowError):
        return otherwise


def bounded_number(value, low: float, high: float, otherwise: float) -> float:
    """`value` as a finite number from `low` to `high`; `otherwise` if it is none."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return otherwise
    return min(max(number, low), high) if math.isfinite(number) else otherwise


def one_of(value, options, otherwise):
    """`value` if it is one of `options`."""
    return value if isinstance(value, str) and value in options else otherwise
