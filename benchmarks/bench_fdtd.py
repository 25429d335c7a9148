"""The simulation's update: against the same in NumPy, against copying the same arrays, and a whole run."""

from __future__ import annotations

import time

import numpy as np

from benchmarks.report import Figure
from fdcal.arrays import positions_of
from fdcal.fdtd import advance, make_grid, simulate
from fdcal.scene import load_scene

STEPS = 320
ROUNDS = 15


def run() -> list[Figure]:
    scene = load_scene("array1_circle")
    grid = make_grid(scene.room, scene.source.sample_rate)
    cells = grid.mask.size
    fields = np.random.default_rng(0).normal(size=(2, *grid.mask.shape))
    numpy_update, copy = _numpy_update(grid, fields), _copy(fields)
    compiled, plain, copied = _best_times(lambda: advance(grid, *fields, STEPS), numpy_update, copy)
    rate, copy_rate = STEPS * cells / compiled, cells / copied
    start = time.perf_counter()
    simulate(scene.room, scene.source, positions_of(scene))
    whole = time.perf_counter() - start
    ratio = rate * plain / cells
    return [
        Figure("cell updates", 1e-9 * rate, "1e9/s"),
        Figure("the same update in NumPy, with out=", 1e-9 * cells / plain, "1e9/s"),
        Figure("copying both fields, cells of one pair of fields", 1e-9 * copy_rate, "1e9/s"),
        Figure("compiled over NumPy", ratio, "times", "at least 10", ratio >= 10),
        Figure("updates over copies", rate / copy_rate, "times", "at least 0.5", rate / copy_rate >= 0.5),
        Figure(f"{scene.source.duration:g} s of {grid.mask.shape[1]} x {grid.mask.shape[0]} cells", whole, "s"),
    ]


def _best_times(*functions) -> list[float]:
    """Shortest time of each, seconds, taken in turns, so that a busy machine slows all of them alike."""
    best = [np.inf] * len(functions)
    for turn in range(ROUNDS + 1):
        for index, function in enumerate(functions):
            start = time.perf_counter()
            function()
            if turn:  # the first turn compiles
                best[index] = min(best[index], time.perf_counter() - start)
    return best


def _numpy_update(grid, fields):
    """Function that takes one step, rigid walls included, without a temporary array."""
    old, now = (np.pad(field, 1) for field in fields)
    lam2, total, scaled = grid.courant**2, np.empty(grid.mask.shape), np.empty(grid.mask.shape)
    centre = 2 - lam2 * grid.stiffness

    def update():
        np.add(now[1:-1, :-2], now[1:-1, 2:], out=total)
        np.add(total, now[:-2, 1:-1], out=total)
        np.add(total, now[2:, 1:-1], out=total)
        np.multiply(total, lam2, out=total)
        np.multiply(now[1:-1, 1:-1], centre, out=scaled)
        np.add(total, scaled, out=total)
        np.subtract(total, old[1:-1, 1:-1], out=old[1:-1, 1:-1])

    return update


def _copy(fields):
    """Function that copies the two fields that an update reads."""
    source, target = np.array(fields), np.empty_like(fields)
    return lambda: np.copyto(target, source)
