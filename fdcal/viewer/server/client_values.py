"""Checks of the messages of browsers, before viser or any other code reads them.

viser does not check the camera that a browser reports, and stores the value of a control for all other pages. A message
is therefore accepted only if the page of fdcal sends messages of this kind, its values are plain and bounded, and its
camera is possible.
"""

import itertools
import math
from typing import Any

import msgspec

MAX_TEXT_LENGTH = 200  # characters of a text from a browser
MAX_NUMBER = 2**53  # largest integer that a browser represents exactly


def is_plain(updates) -> bool:
    """Return whether a browser's update sets one value: a truth value, a finite number or a short text."""
    if not isinstance(updates, dict) or set(updates) != {"value"}:
        return False
    value = updates["value"]
    if isinstance(value, str):
        return len(value) <= MAX_TEXT_LENGTH
    return isinstance(value, (int, float)) and abs(value) <= MAX_NUMBER  # False for NaN, too


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


MAX_COORDINATE = 1e6  # metres, of a camera or a pointer, from the origin
MAX_ITEMS, MAX_DEPTH = 64, 4  # of one message
MIN_LENGTH = 1e-9  # metres, of a direction and of a line of sight
CAMERA = "ViewerCameraMessage"
NAMES = ("uuid", "name")  # keys of a control and of a node
POINTS = ("start_position", "end_position")  # of a drag, metres
RAYS = ("ray_origin", "ray_direction")  # of a click, or None
COSTS = {  # of one message of each kind, in units of a control's update; other kinds are dropped
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
        raise ValueError("a text where a message was expected")
    message = msgspec.msgpack.decode(raw)  # its DecodeError is a ValueError
    if not isinstance(message, dict) or not isinstance(message.get("type"), str):
        raise ValueError("data without a type where a message was expected")
    return message


def is_acceptable(message: dict[str, Any]) -> bool:
    """Return whether the page sends messages of this kind, all values are plain, and a camera is possible."""
    if message["type"] == "FileTransferPart":  # the only one with bytes, as many as the size of a message allows
        texts = (message.get("source_component_uuid"), message.get("transfer_uuid"))
        return isinstance(message.get("content"), bytes) and texts == ("", "") and len(message) == 5
    if message["type"] not in COSTS or not _is_plain(message, 0, itertools.count(1)):
        return False
    if not all(isinstance(message.get(key, ""), str) for key in NAMES):  # viser looks them up in a dictionary
        return False
    points = [message[key] for key in POINTS if key in message]
    points += [message[key] for key in RAYS if message.get(key) is not None]
    index = message.get("instance_index")  # of what a pointer hit
    if not all(_is_vector(x, 3) for x in points) or not (index is None or type(index) is int):
        return False
    if message["type"] != CAMERA:
        return True
    vectors: list[Any] = [message.get(name) for name in ("position", "look_at", "up_direction")]
    if not all(_is_vector(vector, 3) for vector in vectors) or not _is_vector(message.get("wxyz"), 4):
        return False
    numbers: list[Any] = [message.get(name) for name in ("fov", "near", "far", "image_width", "image_height")]
    if not all(map(_is_number, numbers)):
        return False
    (position, look_at, up), (fov, near, far, width, height) = vectors, numbers
    looks = math.dist(position, look_at) > MIN_LENGTH and math.hypot(*up) > MIN_LENGTH
    return looks and 0 < fov < math.pi and 0 < near < far <= 1e9 and width >= 0 and height >= 0


def _is_plain(value, depth: int, items) -> bool:
    """Return whether data are small, with finite numbers and short texts only."""
    if next(items) > MAX_ITEMS or depth > MAX_DEPTH:
        return False
    if isinstance(value, str):
        return len(value) <= MAX_TEXT_LENGTH
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, int):
        return abs(value) <= MAX_NUMBER
    if isinstance(value, dict):
        return all(isinstance(key, str) and _is_plain(inner, depth + 1, items) for key, inner in value.items())
    if isinstance(value, (list, tuple)):
        return all(_is_plain(inner, depth + 1, items) for inner in value)
    return value is None


def _is_number(value) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _is_vector(value, count: int) -> bool:
    of_length = isinstance(value, (list, tuple)) and len(value) == count
    return of_length and all(_is_number(x) and abs(x) <= MAX_COORDINATE for x in value)
