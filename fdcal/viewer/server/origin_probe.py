"""Whether a server refuses the page of another site, found out by asking it.

The list of origins is handed to websockets through names that are private to viser. If they change, the list is lost
without an error. So a server is asked as a foreign page would ask it, before its address is given to anybody.
"""

from __future__ import annotations

import socket

import viser

from .connections import FOREIGN_ORIGIN

PROBE_TIMEOUT = 10.0  # s
REFUSED = b"HTTP/1.1 403 "


class ForeignOriginAccepted(Exception):
    """The server lets a page of another site connect."""


def require_foreign_origin_refused(host: str, port: int) -> None:
    """Raise ForeignOriginAccepted unless the server at this address refuses a foreign page with status 403."""
    name = {"": "127.0.0.1", "0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    request = (
        f"GET / HTTP/1.1\r\nHost: localhost:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        f"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
        f"Sec-WebSocket-Protocol: viser-v{viser.__version__}\r\nOrigin: {FOREIGN_ORIGIN}\r\n\r\n"
    )
    try:
        with socket.create_connection((name, port), PROBE_TIMEOUT) as connection:
            connection.sendall(request.encode("ascii"))
            answer = connection.recv(len(REFUSED), socket.MSG_WAITALL)
    except OSError as error:
        raise ForeignOriginAccepted(f"the server does not answer ({error})") from error
    if answer != REFUSED:
        raise ForeignOriginAccepted("a page of another site is not refused")
