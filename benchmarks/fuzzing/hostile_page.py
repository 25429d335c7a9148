"""Messages that a hostile page sends to `fdcal view`, from a seed, while an honest page must get answers.

A case is one connection and the messages that it sends: messages of the page's own kinds with unusual values, messages
of kinds that only a server sends, messages with broken bytes, or none. After every tenth case the scene must take on
the colours that the honest page requests. At the end a new page is served, and the server must have logged no error.
"""

import contextlib
import copy
import inspect

import msgspec
import numpy as np
from viser import _messages
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection

from ..pages import Served
from ..protocol import CAMERA, ProtocolPage, connect

SCENE, GROWTH = "tiny", 1e9  # bytes
MESSAGES_PER_CASE, CASES_PER_CHECK = 8, 10
DRAWN = "LineSegmentsMessage"
RETRY = 2.0  # s after which the honest page asks again: its control may have gone with a scene
WORKING = ("Apply", "Save", "Start", "Restart")  # buttons that begin minutes of work, as they should
KINDS = sorted(name for name, kind in vars(_messages).items() if inspect.isclass(kind) and name.endswith("Message"))
ODD = (
    None, True, False, 0, -1, 1, 2**31, 2**53 + 1, 2**63 - 1, -(2**63), 0.5, 1e20, 1e308, -1e308, float("nan"),
    float("inf"), 5e-324, "", "x", "x" * 300, "\x00", "\u202e\x1b[31m", "</script>", "../../etc/passwd", b"", b"\xff",
    [], [0, 0, 0], [1e308] * 3, [float("nan")] * 4, [[1]], [0] * 70, {}, {"value": 1}, {"visible": False},
    {"label": "<b>"}, {1: 2}, {"a": {"b": {"c": {"d": {"e": 1}}}}},
)  # fmt: skip
POINTER = {"start_screen_pos": [0.1, 0.2], "end_screen_pos": [0.3, 0.4], "button": "left", "modifier": None}
UPLOAD = {"source_component_uuid": "", "transfer_uuid": ""}
NODE = {"name": "/picking/0", "owner": "", "modifier": None}
DRAG = {**NODE, "start_position": [0, 0, 0], "end_position": [0.7, 0.5, 0], "instance_index": 4}


def hostile_messages(rng: np.random.Generator, uuids: list[str]) -> list[bytes | str]:
    """Return the messages of one hostile connection.

    Every second one begins as a page does, with its camera, and sends complete messages, so that it stays connected.
    """
    whole = bool(rng.integers(2))
    first: list[bytes | str] = [_encoded(_broken_message({**CAMERA}, rng), rng)] if whole else []
    return first + [_message(rng, uuids, whole) for _ in range(MESSAGES_PER_CASE)]


def _message(rng: np.random.Generator, uuids: list[str], whole: bool) -> bytes | str:
    raw = _encoded(_broken_message(_base_message(rng, uuids), rng), rng)
    if whole:
        return raw
    kind = int(rng.integers(12))
    if kind == 0:
        return rng.bytes(int(rng.integers(0, 300)))
    if kind == 1:
        return "text"
    if kind == 2:
        return raw[: int(rng.integers(0, len(raw)))]
    if kind == 3:
        place = int(rng.integers(len(raw)))
        return raw[:place] + rng.bytes(int(rng.integers(1, 5))) + raw[place + 1 :]
    return raw


def _encoded(message: dict, rng: np.random.Generator) -> bytes:
    try:
        return msgspec.msgpack.encode(message)
    except (OverflowError, TypeError):  # not for msgpack
        return rng.bytes(20)


def _base_message(rng: np.random.Generator, uuids: list[str]) -> dict:
    """Return a message of a kind that a page sends, or another one."""
    uuid = uuids[int(rng.integers(len(uuids)))]
    drag = {**POINTER, **DRAG, "phase": ("start", "update", "end")[int(rng.integers(3))]}
    line = {"ray_origin": [0, 0, 5], "ray_direction": [0, 0, -1]}
    bases = [
        {**CAMERA},
        {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": ODD[int(rng.integers(len(ODD)))]}},
        {"type": "SceneNodeDragMessage", **drag},
        {"type": "SceneNodeClickMessage", **NODE, "instance_index": 3, "screen_pos": [0.5, 0.5], **line},
        {"type": "ScenePointerMessage", "event_type": "click", "modifier": None, "screen_pos": [[0.5, 0.5]], **line},
        {"type": "CommandTriggerMessage", "uuid": uuid},
        {"type": "GuiButtonHoldMessage", "uuid": uuid, "frequency": 10.0},
        {
            "type": "FileTransferStartUpload",
            **UPLOAD,
            "filename": "a.npz",
            "mime_type": "",
            "part_count": 1,
            "size_bytes": 3,
        },
        {"type": "FileTransferPart", **UPLOAD, "part_index": 0, "content": b"raw"},
        {"type": KINDS[int(rng.integers(len(KINDS)))], "uuid": uuid, "name": "/room", "props": {}, "value": 1},
    ]
    return copy.deepcopy(bases[int(rng.integers(len(bases)))])


def _broken_message(message: dict, rng: np.random.Generator) -> dict:
    """Return a message in which up to two keys have a strange value, or are removed or added."""
    for _ in range(int(rng.integers(0, 3))):
        key = sorted(message)[int(rng.integers(len(message)))]
        kind, odd = int(rng.integers(5)), ODD[int(rng.integers(len(ODD)))]
        if kind == 0 and len(message) > 1:
            del message[key]
        elif kind == 1:
            message["extra"] = odd
        elif kind == 3 and isinstance(message[key], list) and message[key]:
            place = int(rng.integers(len(message[key])))
            message[key] = [odd if n == place else value for n, value in enumerate(message[key])]
        elif key != "type" or kind == 2:
            message[key] = odd
    return message


def page_faults(first: int, count: int) -> list[str]:
    """Return what was wrong with a server in the cases `first` to `first + count - 1`; each is its seed."""
    with Served(SCENE, {}, own_cache=True) as served:
        with ProtocolPage(served.url) as page, contextlib.ExitStack() as connections:
            page.wait_for(lambda: "Dark page" in page.controls)
            _require_answer(page, True)
            memory = served.memory()
            for case in range(first, first + count):
                uuids = [uuid for label, uuid in sorted(page.controls.items()) if label not in WORKING]
                connection = connections.enter_context(connect(served.url))
                _attack(connection, hostile_messages(np.random.default_rng([case, 7]), uuids))
                if (case + 1) % CASES_PER_CHECK == 0:
                    try:
                        _require_answer(page, case // CASES_PER_CHECK % 2 == 1)
                    except (TimeoutError, ConnectionClosed) as error:
                        return [f"page, cases {case + 1 - CASES_PER_CHECK} to {case}: {error}"]
                    connections.close()  # only now, because the main loop places the cameras of connected pages
        found = [f"page, cases {first} to {first + count - 1}: {line}" for line in served.complaints()]
        if served.memory() - memory > GROWTH:
            found.append(f"page, cases {first} to {first + count - 1}: more than 1 GB")
        with ProtocolPage(served.url) as page:
            page.wait_for(lambda: "ReplayDoneMessage" in page.received)
    return found


def _attack(connection: ClientConnection, messages: list[bytes | str]) -> None:
    with contextlib.suppress(ConnectionClosed):
        for message in messages:
            connection.send(message)
        connection.ping().wait(RETRY)  # the server has read them


def _require_answer(page: ProtocolPage, dark: bool) -> None:
    """Raise TimeoutError unless the server's main loop draws the scene in other colours."""
    before = page.received.get(DRAWN, 0)
    for attempt in range(30):
        page.set("Dark page", dark == (attempt % 2 == 0))
        with contextlib.suppress(TimeoutError):
            page.wait_for(lambda: page.received.get(DRAWN, 0) > before, RETRY)
            return
    raise TimeoutError("the honest page is not answered")
