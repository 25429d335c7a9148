"""Measured rooms: impulse responses with directions of arrival, by name or as files.

The response is measured at one point; the field between the microphones is modelled, as `fdcal.acoustics.plane_waves`
describes. The walls and the position of the source are unknown.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .validation import InputError, StorageError

SUFFIX = ".mat"
UNKNOWN_WALLS = "unknown"  # room.walls of a measured room
MEASURED_AND_MODELLED = (
    "The impulse response is measured, at one point, with the direction of arrival of each sample. The field between"
    " the microphones is modelled: each sample is a plane wave from its direction. Walls and source are unknown."
)


def response_folder() -> Path:
    """Return the folder of the responses that come with fdcal: in the checkout, or inside an installed package."""
    beside = Path(__file__).parents[1] / "rooms"
    return beside if beside.is_dir() else Path(__file__).parents[2] / "rooms"


def response_names() -> list[str]:
    """Return the names of the responses that come with fdcal."""
    return sorted(path.stem for path in response_folder().glob(f"*{SUFFIX}"))


def is_response_file(text: str) -> bool:
    """Return whether a text is the path of a response, rather than a name."""
    return text.lower().endswith(SUFFIX)


def require_response_name(text: str) -> None:
    """Raise InputError for a text that is neither the path of a response nor one of `response_names()`."""
    if not is_response_file(text) and text not in response_names():
        raise InputError(
            f'room.response = "{text}" is unknown',
            f"use {', '.join(response_names())} or the path of a {SUFFIX} file",
            key="room.response",
            value=text,
        )


def require_no_walls(room: Mapping[str, Any]) -> None:
    """Raise InputError for a measured room, as a table, with an unknown response or what only walls have."""
    require_response_name(room["response"])
    for key in ("size", "outline", "cell", "walls", "admittance"):
        value = room[key]
        if value and value != UNKNOWN_WALLS:
            raise InputError(
                f"room.{key} = {value!r} has no meaning in a measured room, whose walls are unknown",
                "remove it",
                key=f"room.{key}",
                value=value,
            )


def response_path(text: str) -> Path:
    """Return the file of a response that is given by its name or its path.

    `text`: one of `response_names()`, or the path of a .mat file. Raises InputError: the name is unknown; StorageError:
    there is no such file.

    Examples
    --------
    >>> response_path("listening_lab").name
    'listening_lab.mat'
    """
    require_response_name(text)
    path = Path(text) if is_response_file(text) else response_folder() / f"{text}{SUFFIX}"
    if not path.is_file():
        raise StorageError(f"cannot read {path}: No such file or directory")
    return path


def response_digest(text: str) -> str:
    """Return the SHA-256 of the file of a response: two files of one content are the same room."""
    return hashlib.sha256(response_path(text).read_bytes()).hexdigest()
