"""What the paper states about its two arrays, and the choices of its figures."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Printed:
    """What the paper states about an array; not the time, the number of runs or the total of iterations."""

    title: str  # what the paper calls the array
    modes: int  # number of modes needed for exact positions
    highest: float  # frequency of the highest of them, Hz
    iteration: int  # the one that Fig. 2 shows, before the end


PRINTED = {
    "array1_circle": Printed("Array 1", 57, 328.0, 60),
    "array2_random": Printed("Array 2", 39, 262.0, 120),
}
ARRAYS = tuple(PRINTED)
LANDSCAPE = "fig1_square", 16, (20, 40, 57)  # the scene of Fig. 1, the microphone that is moved, modes from 1


def title_of(name: str) -> str:
    """Return what a figure calls the array of scene `name`."""
    return PRINTED[name].title if name in PRINTED else name
