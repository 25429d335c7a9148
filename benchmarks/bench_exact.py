"""How many frequencies make the positions exact without noise: arrays 1 and 2, over draws of source and random array.

Exact, with known microphones: every microphone is right after rounding to the 1 cm lattice. Blind: each is within 5 mm
of its position after a rigid motion. The paper needs 57 frequencies for array 1 and 39 for array 2.
"""

import os
from collections.abc import Iterator

import numpy as np

from fdcal.model.gauge import position_errors

from .draws import draw, solve
from .report import Figure

DRAWS = int(os.environ.get("FDCAL_BENCH_DRAWS", "50"))
MODES = (6, 8, 10, 12, 16)
TARGETS = {("array1_circle", 16): 1.0, ("array2_random", 8): 0.7}  # fraction of the draws
NEAR = 0.005  # metres


def exact(name: str, seed: int, modes: int, known: str) -> bool:
    """Return whether every microphone of one draw is found exactly."""
    measurement = draw(name, seed, modes).measurement
    found, truth, search = solve(measurement, known, modes).positions, measurement.positions, measurement.search
    if known == "none":
        return bool(position_errors(found, truth).max() < NEAR)
    cells = [np.round((x - search.origin) / search.step) for x in (found, truth)]
    return bool(np.array_equal(*cells))


def run() -> Iterator[Figure]:
    for name in ("array1_circle", "array2_random"):
        yield from rows(name, "all")
        yield from rows(name, "none")


def rows(name: str, known: str) -> Iterator[Figure]:
    """Yield the figures of one array, with `known` microphones "all" or "none"."""
    words, hits = "three known" if known == "all" else "blind", {}
    for modes in MODES:
        hits[modes] = sum(exact(name, seed, modes, known) for seed in range(DRAWS))
        goal = TARGETS.get((name, modes)) if known == "all" else None
        target = "" if goal is None else f"at least {round(goal * DRAWS)} of {DRAWS}"
        met = None if goal is None else hits[modes] >= round(goal * DRAWS)
        yield Figure(f"{name}, {words}, {modes} modes: exact", hits[modes], f"of {DRAWS}", target, met)
    enough = [m for m in MODES if hits[m] == DRAWS]
    least = float(enough[0]) if enough else np.nan
    yield Figure(f"{name}, {words}: fewest modes with which all are exact", least, "modes")
