"""Everything that fdcal compiles: what solvers and maps need, and the simulation of a scene."""

from __future__ import annotations

import numpy as np

from ..model.room import Room, Source
from ..solvers.warmup import MINIMA, SEARCH, Piece


def all_pieces() -> list[Piece]:
    """Return what is compiled, in words, and the calls that compile it."""
    return [("simulation of a room", _simulate), SEARCH, MINIMA]


def _simulate() -> None:
    """Simulate a room with few rows, and one with enough for several threads."""
    from ..acoustics.fdtd import simulate

    source = Source(position=(0.1, 0.1), low=1000.0, high=3000.0, sample_rate=13000.0, duration=0.02)
    for height in (0.4, 4.0):
        simulate(Room(size=(0.4, height), walls="rigid", cell=0.04), source, np.array([[0.3, 0.3]]))
