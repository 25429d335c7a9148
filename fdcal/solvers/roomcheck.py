"""What a measurement must hold before its microphones are sought in a room of known size."""

from __future__ import annotations

import numpy as np

from ..checks import InputError
from ..measurement import Problem
from ..scene import Solver

MOST_NUMBERS = 1e7  # of the response of the exact model, complex
HIGHEST = 26.0, 19.0  # rad/m, about where its sum ends, in 2-D and 3-D


def require_room(problem: Problem, settings: Solver) -> tuple[float, ...]:
    """The size of the room; InputError where there is none, or one that the measurement does not fit."""
    size, D, (measured, N) = settings.room, problem.dimension, problem.pressures.shape
    if size is None:
        raise InputError(
            'solver "room" needs the size of the room: --room LxW, or LxWxH for a field of three dimensions'
        )
    text = "x".join(f"{length:g}" for length in size)
    if len(size) != D:
        raise InputError(f"--room {text} has {len(size)} lengths; the sound field has {D} dimensions, give as many")
    if problem.array_dimension != D:
        raise InputError("a known room gives all three coordinates; set array_dimension = 3 in the measurement")
    if settings.modes > measured:
        raise InputError(f"solver.modes = {settings.modes}, but {measured} modes were measured; use at most {measured}")
    needed = -(-(N * D + D + 2) // max(N - 1, 1))
    if N < 2 or settings.modes < needed:
        raise InputError(
            f"{settings.modes} modes of {N} microphones are too few for a known room; use {needed} modes or more, and"
            " two microphones at least"
        )
    k = np.real(problem.wavenumbers[: settings.modes])
    if k.max() < np.pi / max(size):
        lowest = problem.sound_speed / 2 / max(size)
        raise InputError(
            f"--room {text}: a room so small has its first resonance at {lowest:.4g} Hz, above all frequencies in use"
        )
    top = HIGHEST[D - 2] / np.pi
    if settings.modes * np.prod([1 + top * length for length in size]) > MOST_NUMBERS:
        raise InputError(f"--room {text}: a room so large has too many modes; give its size in metres")
    outside = np.any((problem.known_positions < 0) | (problem.known_positions > np.asarray(size)), axis=1)
    if outside.any():
        n = int(np.flatnonzero(outside)[0])
        raise InputError(
            f"--room {text}: known microphone {problem.known[n]} at {problem.known_positions[n].tolist()} m stands"
            " outside; give positions from a corner of the room, or --known none"
        )
    return size
