"""Which channels of a recording to use, and which microphones are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..model.validation import InputError
from .recording import Recording, select_channels

PLANE_TOLERANCE = 1e-3  # m: microphones this close to a plane lie in it
CORNERS = "corners"


def select_plane(recording: Recording, plane: str) -> Recording:
    """Return the recording of the microphones in a plane, with two coordinates each.

    `plane`: such as "z=0" or, the same, "0"; metres. Raises InputError: the recording has no positions in space,
    `plane` is malformed, or no microphone lies in it.
    """
    axis, _, value = plane.rpartition("=")
    axis = axis.strip().lower() or "z"
    positions = recording.positions
    if positions is None or positions.shape[1] != 3:
        raise InputError(
            f"plane = {plane} needs positions in space, which {recording.path} does not contain",
            "leave out <plane>",
            key="plane",
            value=plane,
        )
    try:
        height = float(value)
    except ValueError:
        height = np.nan
    if axis not in "xyz" or len(axis) != 1 or not np.isfinite(height):
        raise InputError(f'plane = "{plane}" is no plane', "write <plane> as z=0.1, metres", key="plane", value=plane)
    along = positions[:, "xyz".index(axis)]
    inside = np.flatnonzero(np.abs(along - height) < PLANE_TOLERANCE)
    if not len(inside):
        near = along[np.argmin(np.abs(along - height))]
        raise InputError(
            f"plane = {plane}: no microphone lies there; the nearest plane is {axis}={near:g}",
            "give <plane> as that one",
            key="plane",
            value=plane,
        )
    kept = [a for a in range(3) if a != "xyz".index(axis)]
    return replace(select_channels(recording, inside), positions=positions[inside][:, kept])


def select_subset(recording: Recording, text: str, seed: int) -> Recording:
    """Return the recording of some microphones.

    `text`: a list of numbers and ranges, "0,3,8:12", or how many are drawn at random, "200"; `seed`: of the random
    draw. Raises InputError: the text is malformed, or names microphones that the recording does not have.
    """
    try:
        numbers = _listed(text, recording.count)
    except ValueError:
        raise InputError(
            f'subset = "{text}" is no number and no list',
            "write <subset> as 200, or 0,3,8:12",
            key="subset",
            value=text,
        ) from None
    if len(numbers) == 1 and "," not in text and ":" not in text:
        return _drawn(recording, numbers[0], seed)
    wrong = [n for n in numbers if not 0 <= n < recording.count]
    if wrong or len(set(numbers)) < len(numbers) or not numbers:
        raise InputError(
            f"subset = {text} must name microphones of 0 to {recording.count - 1}, each at most once",
            key="subset",
            value=text,
        )
    return select_channels(recording, numbers)


def _listed(text: str, count: int) -> list[int]:
    """Return the numbers of a list such as "0,3,8:12"; a range ends at most one after `count`."""
    numbers: list[int] = []
    for part in text.split(","):
        first, colon, end = part.partition(":")
        numbers += range(int(first), min(int(end), count + 1)) if colon else [int(part)]
    return numbers


def _drawn(recording: Recording, number: int, seed: int) -> Recording:
    if not 1 <= number <= recording.count:
        raise InputError(
            f"subset = {number} cannot be drawn from {recording.count} microphones",
            "give a smaller <subset>",
            key="subset",
            value=number,
        )
    if seed < 0:
        raise InputError(f"seed = {seed} must not be negative", "use 0 or more", key="seed", value=seed)
    drawn = np.random.default_rng(seed).choice(recording.count, number, replace=False)
    return select_channels(recording, np.sort(drawn))


def exclude_channels(recording: Recording, text: str, bad: np.ndarray) -> Recording:
    """Return the recording without some channels.

    `text`: a list of names; "bad" stands for all of `bad`; `bad` (n,) int64, indices of faulty channels. Raises
    InputError: a name is unknown, or no channel is left.
    """
    excluded: set[int] = set()
    for name in (part.strip() for part in text.split(",")):
        if name == "bad":
            excluded |= set(bad.tolist())
        else:
            excluded.add(_index_of(recording, name, "leave_out"))
    left = [n for n in range(recording.count) if n not in excluded]
    if not left:
        raise InputError(f"leave_out = {text} leaves no channel", "record again", key="leave_out", value=text)
    return select_channels(recording, left)


def known_microphones(recording: Recording, text: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices and the positions of the known microphones.

    `text`: a list of channel names, whose positions the recording contains; "corners", those nearest to the corners of
    the bounding box; or the path of a table (.csv) with name,x,y or name,x,y,z. Returns (A,) int64, (A, D) float64,
    indices; positions, metres. Raises InputError, StorageError: a name is unknown, the recording has no positions, or
    the table cannot be used or read.
    """
    if text.lower().endswith(".csv"):
        from .formats.table import read_positions

        names, positions = read_positions(text)
        return _indices(recording, names), positions
    if recording.positions is None:
        raise InputError(
            f"known = {text}: {recording.path} contains no positions", "give a table: <known> FILE.csv", key="known"
        )
    if text == CORNERS:
        indices = _corners(recording.positions)
    else:
        indices = _indices(recording, [part.strip() for part in text.split(",")])
    return indices, recording.positions[indices]


def _corners(positions: np.ndarray) -> np.ndarray:
    """Return the indices of the microphones nearest to the corners of the bounding box."""
    low, high = positions.min(axis=0), positions.max(axis=0)
    sides = [(a,) if a == b else (a, b) for a, b in zip(low, high, strict=True)]
    corners = np.stack([c.ravel() for c in np.meshgrid(*sides)], axis=1)
    distances = np.linalg.norm(positions[None] - corners[:, None], axis=2)
    return np.unique(np.argmin(distances, axis=1))


def _indices(recording: Recording, names: list[str]) -> np.ndarray:
    return np.array([_index_of(recording, name, "known") for name in names], dtype=np.int64)


def _index_of(recording: Recording, name: str, key: str) -> int:
    names = recording.names
    if name in names:
        return names.index(name)
    few = ", ".join(names[:3])
    listed = f"the channels are {few} ... {names[-1]}" if len(names) > 4 else f"use {few}"
    raise InputError(f'{key}: there is no channel "{name}"', listed, key=key, value=name)
