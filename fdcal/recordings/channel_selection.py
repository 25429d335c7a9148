"""Which microphones of a recording to take, and which of them are known: the options --subset, --plane and --known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..model.validation import InputError
from .recording import Recording, select_channels

LEVEL = 1e-3  # m: microphones this close to a plane lie in it
CORNERS = "corners"


def select_plane(recording: Recording, plane: str) -> Recording:
    """The microphones on a plane such as "z=0" (or "0", the same). Raises InputError where there are none."""
    axis, _, value = plane.rpartition("=")
    axis = axis.strip().lower() or "z"
    if recording.positions is None or recording.positions.shape[1] != 3:
        raise InputError(f"--plane {plane} needs positions in space, which {recording.path} does not tell")
    try:
        height = float(value)
    except ValueError:
        height = np.nan
    if axis not in "xyz" or len(axis) != 1 or not np.isfinite(height):
        raise InputError(f'--plane "{plane}" is no plane; write z=0.1, metres')
    along = recording.positions[:, "xyz".index(axis)]
    inside = np.flatnonzero(np.abs(along - height) < LEVEL)
    if not len(inside):
        near = along[np.argmin(np.abs(along - height))]
        raise InputError(f"--plane {plane}: no microphone lies there; the nearest plane is {axis}={near:g}")
    chosen = select_channels(recording, inside)
    kept = [a for a in range(3) if a != "xyz".index(axis)]
    return _with_positions(chosen, chosen.positions[:, kept])


def _with_positions(recording: Recording, positions: np.ndarray) -> Recording:
    return replace(recording, positions=positions)


def select_subset(recording: Recording, text: str, seed: int) -> Recording:
    """The microphones of a list of numbers and ranges, "0,3,8:12", or a number of them drawn at random, "200"."""
    try:
        numbers = _listed(text, recording.count)
    except ValueError:
        raise InputError(f'--subset "{text}" is no number and no list; write 200, or 0,3,8:12') from None
    if len(numbers) == 1 and "," not in text and ":" not in text:
        return _drawn(recording, numbers[0], seed)
    wrong = [n for n in numbers if not 0 <= n < recording.count]
    if wrong or len(set(numbers)) < len(numbers) or not numbers:
        raise InputError(f"--subset {text} must name microphones of 0 to {recording.count - 1}, each at most once")
    return select_channels(recording, numbers)


def _listed(text: str, count: int) -> list[int]:
    """Numbers of a list such as "0,3,8:12"; ranges end one past `count` at most. Raises ValueError."""
    numbers: list[int] = []
    for part in text.split(","):
        first, colon, end = part.partition(":")
        numbers += range(int(first), min(int(end), count + 1)) if colon else [int(part)]
    return numbers


def _drawn(recording: Recording, number: int, seed: int) -> Recording:
    if not 1 <= number <= recording.count:
        raise InputError(f"--subset {number} cannot be drawn from {recording.count} microphones; use fewer")
    if seed < 0:
        raise InputError(f"--seed {seed} must not be negative; use 0 or more")
    drawn = np.random.default_rng(seed).choice(recording.count, number, replace=False)
    return select_channels(recording, np.sort(drawn))


def exclude_channels(recording: Recording, text: str, bad: np.ndarray) -> Recording:
    """All microphones but those of a list of names; "bad" stands for the numbers (n,) `bad`."""
    gone: set[int] = set()
    for name in (part.strip() for part in text.split(",")):
        if name == "bad":
            gone |= set(bad.tolist())
        elif name in recording.names:
            gone.add(recording.names.index(name))
        else:
            raise InputError(f'--leave-out: there is no channel "{name}"; {_names(recording)}')
    left = [n for n in range(recording.count) if n not in gone]
    if not left:
        raise InputError(f"--leave-out {text} leaves no channel; record again")
    return select_channels(recording, left)


def known_microphones(recording: Recording, text: str) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (A,) and positions (A, D), metres, of the known microphones.

    `text` is a list of channel names, placed where the file says; "corners", those nearest to the corners of the box
    around all; or a table (.csv) of name,x,y or name,x,y,z.
    """
    if text.lower().endswith(".csv"):
        from .formats.table import read_positions

        names, places = read_positions(text)
        return _numbers(recording, names, text), places
    if recording.positions is None:
        raise InputError(f"--known {text}: {recording.path} tells no positions; give a table: --known FILE.csv")
    if text == CORNERS:
        low, high = recording.positions.min(axis=0), recording.positions.max(axis=0)
        sides = [(a,) if a == b else (a, b) for a, b in zip(low, high, strict=True)]
        corners = np.stack([c.ravel() for c in np.meshgrid(*sides)], axis=1)
        apart = np.linalg.norm(recording.positions[None] - corners[:, None], axis=2)
        numbers = np.unique(np.argmin(apart, axis=1))
    else:
        numbers = _numbers(recording, [part.strip() for part in text.split(",")], text)
    return numbers, recording.positions[numbers]


def _numbers(recording: Recording, names: list[str], text: str) -> np.ndarray:
    for name in names:
        if name not in recording.names:
            raise InputError(f'--known {text}: there is no channel "{name}"; {_names(recording)}')
    return np.array([recording.names.index(name) for name in names], dtype=np.int64)


def _names(recording: Recording) -> str:
    few = ", ".join(recording.names[:3])
    return f"the channels are {few} ... {recording.names[-1]}" if recording.count > 4 else f"use {few}"
