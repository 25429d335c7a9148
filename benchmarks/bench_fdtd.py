"""Speed of the simulation's update, against NumPy and against copying the same arrays, and of a whole run."""

import time

import numpy as np

from benchmarks.report import Figure
from fdcal.acoustics.fdtd import make_grid, padded, padded_width, simulate, stencil_tables
from fdcal.acoustics.fdtd_kernels import march
from fdcal.model.arrays import positions_of
from fdcal.model.scene import load_scene

# A timed call takes some milliseconds, so that other work of the machine does not disturb the best of many calls.
STEPS = 64
SLOW_STEPS = 4
COPIES = 20
ROUNDS = 100


def run() -> list[Figure]:
    scene = load_scene("array1_circle")
    grid = make_grid(scene.room, scene.source.sample_rate)
    cells = grid.mask.size
    fields = np.random.default_rng(0).normal(size=(2, *grid.mask.shape))
    compiled, plain, copied = _best_times(_update(grid, fields), _numpy_update(grid, fields), _copy(fields))
    rate, plain_rate, copy_rate = STEPS * cells / compiled, SLOW_STEPS * cells / plain, COPIES * cells / copied
    start = time.perf_counter()
    simulate(scene.room, scene.source, positions_of(scene))
    whole = time.perf_counter() - start
    ratio = rate / plain_rate
    return [
        Figure("cell updates", 1e-9 * rate, "1e9/s"),
        Figure("the same update in NumPy, with out=", 1e-9 * plain_rate, "1e9/s"),
        Figure("copying both fields, cells of the pair", 1e-9 * copy_rate, "1e9/s"),
        Figure("compiled over NumPy", ratio, "times", "at least 10", ratio >= 10),
        Figure("updates over copies", rate / copy_rate, "times", "at least 0.5", rate / copy_rate >= 0.5),
        Figure(f"{scene.source.duration:g} s of {grid.mask.shape[1]} x {grid.mask.shape[0]} cells", whole, "s"),
    ]


def _best_times(*functions) -> list[float]:
    """Return the shortest time of each, seconds. They take turns, so that a busy machine slows all of them alike."""
    best = [np.inf] * len(functions)
    for turn in range(ROUNDS + 1):
        for index, function in enumerate(functions):
            start = time.perf_counter()
            function()
            if turn:  # the first turn compiles
                best[index] = min(best[index], time.perf_counter() - start)
    return best


def _update(grid, fields):
    """Return a function that takes STEPS steps, as `fdcal.acoustics.fdtd.advance` does, with tables of the grid that
    are made beforehand."""
    state = np.stack([padded(field, padded_width(grid)) for field in fields])
    tables = stencil_tables(grid, ((0, 0), np.zeros(0)), (np.zeros((0, 2), int), np.zeros((0, 0))))
    return lambda: march(state, 0, STEPS, tables)


def _numpy_update(grid, fields):
    """Return a function that takes SLOW_STEPS steps, rigid walls included, without a temporary array."""
    old, now = (np.pad(field, 1) for field in fields)
    lam2, total, scaled = grid.courant**2, np.empty(grid.mask.shape), np.empty(grid.mask.shape)
    centre = 2 - lam2 * grid.stiffness

    def step(old, now):
        np.add(now[1:-1, :-2], now[1:-1, 2:], out=total)
        np.add(total, now[:-2, 1:-1], out=total)
        np.add(total, now[2:, 1:-1], out=total)
        np.multiply(total, lam2, out=total)
        np.multiply(now[1:-1, 1:-1], centre, out=scaled)
        np.add(total, scaled, out=total)
        np.subtract(total, old[1:-1, 1:-1], out=old[1:-1, 1:-1])

    def update():
        for _ in range(SLOW_STEPS // 2):
            step(old, now)
            step(now, old)

    return update


def _copy(fields):
    """Return a function that copies the two fields that an update reads, COPIES times."""
    source, target = np.array(fields), np.empty_like(fields)

    def copy():
        for _ in range(COPIES):
            np.copyto(target, source)

    return copy
