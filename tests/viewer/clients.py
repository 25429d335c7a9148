"""Clients of the page that are no browsers: what they send, and what they are sent."""

from benchmarks.protocol import CAMERA, connect, messages, send

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


def join(server):
    """Connect to a viser server of this process."""
    return connect(f"ws://127.0.0.1:{server.get_port()}")


def is_served(server) -> bool:
    """Whether a new client is sent the whole page."""
    with join(server) as client:
        send(client, **CAMERA)
        return any(message["type"] == "ReplayDoneMessage" for message in messages(client))
