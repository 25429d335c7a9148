"""Checks of the messages of browsers, before viser or any other code reads them.

viser does not check the camera that a browser reports, and stores the value of a control for all other pages. A message
is therefore accepted only if the page of fdcal sends messages of this kind, it has the fields that viser declares for
them, its values are plain and bounded, and its camera is possible.
"""

import dataclasses
import itertools
import math
from collections.abc import Iterator
from typing import Any

import msgspec
from viser import _messages

MAX_TEXT_LENGTH = 200  # largest number of characters of a text from a browser
MAX_NUMBER = 2**53  # largest integer that a browser represents exactly
MAX_ITEMS, MAX_DEPTH = 64, 4  # largest number of items and depth of one message


def is_plain(updates) -> bool:
    """Return whether a browser's update sets one value: a truth value, a finite number or a short text."""
    if not isinstance(updates, dict) or set(updates) != {"value"}:
        return False
    return isinstance(updates["value"], (int, float, str)) and _is_plain(updates["value"], 0, itertools.count())


def _is_plain(value, depth: int, items: Iterator[int]) -> bool:
    """Return whether data are small, with finite numbers and short texts only."""
    if next(items) > MAX_ITEMS or depth > MAX_DEPTH:
        return False
    if isinstance(value, str):
        return len(value) <= MAX_TEXT_LENGTH
    if isinstance(value, (int, float)):
        return abs(value) <= MAX_NUMBER  # False for NaN, too
    if isinstance(value, dict):
        return all(isinstance(key, str) and _is_plain(inner, depth + 1, items) for key, inner in value.items())
    if isinstance(value, (list, tuple)):
        return all(_is_plain(inner, depth + 1, items) for inner in value)
    return value is None


def fits(control, value) -> bool:
    """Return whether a plain value is one that a control can have.

    `control`: handle of a control of viser; `value`: truth value, number or text, as `is_plain` accepts it.
    """
    options = getattr(control, "options", None)
    if options is not None:
        return isinstance(value, str) and value in options
    if isinstance(control.value, (bool, str)):
        return isinstance(value, type(control.value))
    low, high = getattr(control, "min", None), getattr(control, "max", None)
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return number and (low is None or value >= low) and (high is None or value <= high)


MAX_COORDINATE = 1e6  # largest coordinate of a camera or a pointer, metres
MIN_LENGTH = 1e-9  # least length of a direction and of a line of sight, metres
CAMERA = "ViewerCameraMessage"
POINTS = "position look_at up_direction start_position end_position ray_origin ray_direction".split()  # metres
COSTS = {  # cost of one message of each kind, in units of a control's update; messages of other kinds are dropped
    CAMERA: 1.0,
    "GuiUpdateMessage": 1.0,
    "ScenePointerMessage": 1.0,
    "SceneNodeDragMessage": 1.0,
    "SceneNodeClickMessage": 5.0,
    "CommandTriggerMessage": 5.0,
    "GuiButtonHoldMessage": 5.0,
    "FileTransferStartUpload": 1.0,
    "FileTransferPart": 0.25,
}
DRAG_START_COST = 40.0  # each drag adds a state to the history


def decoded_message(raw) -> dict[str, Any]:
    """Return a message as plain data; ValueError if it is not the msgpack encoding of a message."""
    if not isinstance(raw, bytes):
        raise ValueError("a text was sent instead of a message")
    message = msgspec.msgpack.decode(raw)  # its DecodeError is a ValueError
    if not isinstance(message, dict) or not isinstance(message.get("type"), str):
        raise ValueError("data without a type were sent instead of a message")
    return message


def is_acceptable(message: dict[str, Any]) -> bool:
    """Return whether the page sends messages of this kind, all values are plain, and a camera is possible."""
    kind, given = message["type"], {key: value for key, value in message.items() if key != "type"}
    if kind not in COSTS:
        return False
    # only a part of a file has bytes, as many as the size of a message allows
    others = given | {"content": None} if kind == "FileTransferPart" else given
    declared: Any = getattr(_messages, kind)
    if not _is_plain(others, 0, itertools.count()) or given.keys() != {f.name for f in dataclasses.fields(declared)}:
        return False
    try:
        read = msgspec.convert(given, declared, builtin_types=[bytes])
    except msgspec.ValidationError:
        return False
    points = [getattr(read, name, None) or (0.0,) for name in POINTS]
    if not all(abs(x) <= MAX_COORDINATE for point in points for x in point):
        return False
    if kind != CAMERA:
        return True
    looks = math.dist(read.position, read.look_at) > MIN_LENGTH and math.hypot(*read.up_direction) > MIN_LENGTH
    lens = 0 < read.fov < math.pi and 0 < read.near < read.far <= 1e9
    return looks and lens and read.image_width >= 0 and read.image_height >= 0
