"""A page without a browser: a client that speaks viser's protocol, for benchmarks and tests of the server."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator

import msgspec
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection
from websockets.sync.client import connect as open_connection
from websockets.typing import Origin, Subprotocol

TIMEOUT = 60.0  # s, bound of every wait
CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [1, 0, 0, 0], "position": [0, 0, 5], "fov": 1.0, "near": 0.1, "far": 9.0,
    "image_height": 700, "image_width": 600, "look_at": [0, 0, 0], "up_direction": [0, 0, 1],
}  # fmt: skip


def connect(address: str, version: str = viser.__version__) -> ClientConnection:
    """Connect to the page at `address`, http:// or ws://, as a page of a version of viser."""
    address = address.partition("//")[2].rstrip("/")  # an origin has no path
    return open_connection(
        f"ws://{address}", origin=Origin(f"http://{address}"), subprotocols=[Subprotocol(f"viser-v{version}")],
        open_timeout=TIMEOUT, close_timeout=1, max_size=None,
    )  # fmt: skip


def send(connection: ClientConnection, **message) -> None:
    """Send a message, unless the connection is closed."""
    with contextlib.suppress(ConnectionClosed):
        connection.send(msgspec.msgpack.encode(message))


def messages(connection: ClientConnection, timeout: float | None = TIMEOUT) -> Iterator[dict]:
    """Yield the messages that a client receives."""
    while True:
        raw = connection.recv(timeout=timeout)
        size = int.from_bytes(raw[8:16], "little")
        inner = zstandard.ZstdDecompressor().decompress(raw[16 : 16 + size], int.from_bytes(raw[:8], "little"))
        yield from msgspec.msgpack.decode(inner)["messages"]


class ProtocolPage:
    """A page that reads all messages on its own thread; a context manager.

    Attributes
    ----------
    connection : ClientConnection
    controls : dict, the newest control of each label
    nodes : set, the names of the nodes of the scene that have been added
    received : dict, how many messages of each type have come
    """

    def __init__(self, address: str):
        self.connection = connect(address)
        self.controls: dict[str, str] = {}
        self.nodes: set[str] = set()
        self.received: dict[str, int] = {}
        self._thread = threading.Thread(target=self._read, daemon=True)

    def __enter__(self) -> ProtocolPage:
        self._thread.start()
        send(self.connection, **CAMERA)
        return self

    def __exit__(self, *_) -> None:
        self.connection.close()
        self._thread.join(TIMEOUT)

    def set(self, label: str, value) -> None:
        """Set a control; True presses a button."""
        self.update(self.controls[label], value)

    def update(self, uuid: str, value) -> None:
        """Set the control of a number."""
        send(self.connection, type="GuiUpdateMessage", uuid=uuid, updates={"value": value})

    def wait_for(self, happened: Callable[[], object], timeout: float = TIMEOUT) -> float:
        """Wait until something happens; return how long that took, s, or raise TimeoutError."""
        start = time.perf_counter()
        while not happened():
            if time.perf_counter() - start > timeout:
                raise TimeoutError("the page does not answer")
            time.sleep(0.002)
        return time.perf_counter() - start

    def _read(self) -> None:
        with contextlib.suppress(ConnectionClosed):
            for message in messages(self.connection, None):
                self.read(message)

    def read(self, message: dict) -> None:
        """Count a message, and keep the name of its node or control."""
        kind, label = message["type"], (message.get("props") or {}).get("label")
        self.received[kind] = self.received.get(kind, 0) + 1
        if "props" in message and "name" in message:
            self.nodes.add(message["name"])
        if kind.startswith("Gui") and label is not None and "uuid" in message:
            self.controls[label] = message["uuid"]
