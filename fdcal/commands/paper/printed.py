"""What the paper prints of its two arrays, and which of its figures' choices are ours to make."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Printed:
    """modes : number needed; highest : Hz; iteration : that Fig. 2 shows, before the end. It tells no time, no number
    of runs and no total of iterations."""

    title: str
    modes: int
    highest: float
    iteration: int


PRINTED = {
    "array1_circle": Printed("Array 1", 57, 328.0, 60),
    "array2_random": Printed("Array 2", 39, 262.0, 120),
}
ARRAYS = tuple(PRINTED)
LANDSCAPE = "fig1_square", 16, (20, 40, 57)  # the scene of Fig. 1, the microphone that is moved, modes from 1


def title_of(name: str) -> str:
    """What a figure calls the array of scene `name`."""
    return PRINTED[name].title if name in PRINTED else name
