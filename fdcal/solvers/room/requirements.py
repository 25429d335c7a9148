"""What a measurement must hold for the solver of known rooms."""

from __future__ import annotations

import numpy as np

from ...model.problem import Problem
from ...model.settings import SolverSettings
from ...model.validation import InputError
from .thresholds import SIZES


def require_enough(count: int, D: int, modes: int) -> None:
    """Raise InputError if the pressures of `count` microphones are fewer than the unknowns."""
    needed = -(-(count * D + D + 2) // max(count - 1, 1))
    if count < 2 or modes < needed:
        raise InputError(
            f"{modes} modes of {count} microphones are too few for a known room",
            f"use {needed} modes (<modes>) or more, and two microphones at least",
            key="modes",
            value=modes,
        )


def require_room(problem: Problem, settings: SolverSettings) -> tuple[float, ...]:
    """Return the size of the room, metres.

    Raises
    ------
    InputError
        Without the size of the room, or for one that the measurement does not fit.
    """
    size, D, (measured, N) = settings.room, problem.dimension, problem.pressures.shape
    if size is None:
        remedy = "give <room> LxW, or LxWxH for a field of three dimensions"
        raise InputError('solver "room" needs the size of the room', remedy, key="room")
    if len(size) != D:
        message = f"room = {_text(size)} has {len(size)} lengths, but the sound field has {D} dimensions"
        raise InputError(message, "give as many", key="room", value=size)
    if problem.array_dimension != D:
        raise InputError("a known room gives all three coordinates", "set array_dimension = 3 in the measurement")
    if settings.modes > measured:
        raise InputError(
            f"solver.modes = {settings.modes}, but {measured} modes were measured",
            f"use at most {measured} modes (<modes>)",
            key="modes",
            value=settings.modes,
        )
    require_enough(N, D, settings.modes)
    _require_size(problem, settings.modes, size)
    _require_inside(problem, size)
    return size


def _text(size: tuple[float, ...]) -> str:
    return "x".join(f"{length:g}" for length in size)


def _require_size(problem: Problem, modes: int, size: tuple[float, ...]) -> None:
    """Raise InputError for a room whose resonances cannot be those of the first `modes` modes, or are too many."""
    text = _text(size)
    k = np.real(problem.wavenumbers[:modes])
    if k.max() < np.pi / max(size):
        lowest = problem.sound_speed / 2 / max(size)
        raise InputError(
            f"room = {text}: so small a room has its first resonance at {lowest:.4g} Hz, above all frequencies in use",
            "give <room> in metres",
            key="room",
            value=size,
        )
    top = SIZES.highest(problem.dimension) / np.pi
    if modes * np.prod([1 + top * length for length in size]) > SIZES.response:
        remedy = "give <room> in metres"
        raise InputError(f"room = {text}: a room so large has too many modes", remedy, key="room", value=size)


def _require_inside(problem: Problem, size: tuple[float, ...]) -> None:
    """Raise InputError for a known microphone outside the room."""
    outside = np.any((problem.known_positions < 0) | (problem.known_positions > np.asarray(size)), axis=1)
    if outside.any():
        n = int(np.flatnonzero(outside)[0])
        place = problem.known_positions[n].tolist()
        raise InputError(
            f"room = {_text(size)}: known microphone {problem.known[n]} at {place} m stands outside",
            "give positions from a corner of the room, or <known> none",
            key="room",
            value=size,
        )
