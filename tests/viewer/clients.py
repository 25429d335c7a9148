"""Clients of the page that are no browsers: what they send, and what they are sent."""

import contextlib

import msgspec
import viser
import zstandard
from browsing import WAIT
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [1, 0, 0, 0], "position": [0, 0, 5], "fov": 1.0, "near": 0.1, "far": 9.0,
    "image_height": 700, "image_width": 600, "look_at": [0, 0, 0], "up_direction": [0, 0, 1],
}  # fmt: skip
NAN, INFINITE = float("nan"), float("inf")
HOSTILE_CAMERAS = [
    *({name: [bad] * 3} for name in ("position", "look_at", "up_direction") for bad in (NAN, INFINITE, 1e308, -1e308)),
    *({name: [0.0] * count} for name in ("position", "look_at", "up_direction") for count in (0, 2, 4)),
    *({name: bad} for name in ("position", "look_at", "up_direction") for bad in (None, 3, "abc", ["a", "b", "c"])),
    {"position": [[1, 2, 3]] * 3}, {"position": [1e308, 0, 0], "look_at": [-1e308, 0, 0]},
    {"look_at": CAMERA["position"]}, {"up_direction": [0, 0, 0]}, {"up_direction": {"z": 1}}, {"up_direction": True},
    {"wxyz": [0, 0, 0]}, {"wxyz": [NAN] * 4}, {"wxyz": "no"}, {"fov": NAN}, {"fov": 1e308}, {"fov": -1},
    {"near": NAN}, {"far": INFINITE}, {"near": 9.0, "far": 0.1}, {"near": 0},
    {"image_width": NAN}, {"image_width": 10**18}, {"image_height": "wide"}, {"image_height": -5},
]  # fmt: skip


def join(server, **options):
    """Connect to a viser server of this process."""
    return join_address(f"ws://127.0.0.1:{server.get_port()}", **options)


def join_address(address: str, version: str = viser.__version__):
    return connect(address, subprotocols=[f"viser-v{version}"], open_timeout=WAIT, close_timeout=1, max_size=None)


def say(client, **message):
    with contextlib.suppress(ConnectionClosed):
        client.send(msgspec.msgpack.encode(message))


def messages(client):
    """Yield the messages that a client is sent."""
    while True:
        raw = client.recv(timeout=WAIT)
        size = int.from_bytes(raw[8:16], "little")
        inner = zstandard.ZstdDecompressor().decompress(raw[16 : 16 + size], int.from_bytes(raw[:8], "little"))
        yield from msgspec.msgpack.decode(inner)["messages"]


def is_served(server) -> bool:
    """Whether a new client is sent the whole page."""
    with join(server) as client:
        say(client, **CAMERA)
        return any(message["type"] == "ReplayDoneMessage" for message in messages(client))
