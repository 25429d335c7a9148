"""The compiled inner loops of the wave equation on a grid; `fdcal.acoustics.fdtd` states the scheme.

    sweep         advances a strip of rows by several steps, including its wall cells, the source and the microphones
    march         advances the whole grid by many steps, with its strips distributed over threads

Steps are taken in blocks of BLOCK (split tiling in time). Each thread advances its strip of rows by the whole block. At
every border with another strip it advances one row fewer in each step than in the step before; the triangles in space
and time that are left out are filled in afterwards. The threads thus synchronise twice per block instead of once per
step, so that other load on the machine delays them little. Within a strip the rows are visited as a wave front that is
DEPTH steps deep. Both only change the order of the computation: the numbers are exactly those of a computation step by
step.
"""

import functools
import os
from typing import NamedTuple

import numpy as np

from .compiled import MAX_THREADS, compiled, parallel_map

BLOCK = 32  # steps in a block
DEPTH = 3  # steps in a wave front; the 5 rows of 2 arrays that it needs fit in the first-level cache


@functools.partial(compiled, fastmath={"contract"})  # allows a fused multiplication and addition
def sweep(state, step, steps, low, high, low_slope, high_slope, width, lam2, spans, span_start, span_count, walls,
          wall_cell, wall_centre, wall_before, wall_around, source, pulse, receivers, receiver_cell, receiver_number,
          recordings):  # fmt: skip
    """Advance rows low + low_slope t (included) to high + high_slope t (excluded) in each step t = 0 ... steps - 1.

    `state` is the flattened state of `march`, and `step` the number of the first step; the arguments from `width` on
    are those of `StencilTables`. All loops are in one function. If each row called another one, the reference counts of
    the arrays would change at every call, which takes as long as computing the row. Indices are unsigned, so that numba
    omits the test for negative ones.
    """
    half, wide, one, centre = state.size // 2, np.uint64(width), np.uint64(1), 2 - 4 * lam2
    for group in range(0, steps, DEPTH):
        last = min(group + DEPTH, steps) - 1
        first_front = low + min(low_slope * group, low_slope * last)
        last_front = high + max(high_slope * group, high_slope * last) + last - group
        for front in range(first_front, last_front):
            for t in range(group, last + 1):
                row = front - (t - group)  # one row behind the previous step, whose result in the next row it needs
                if row < low + low_slope * t or row >= high + high_slope * t:
                    continue
                time = step + t
                now = half * (time % 2)
                old = half - now
                for i in range(spans[row], spans[row + 1]):
                    at, count = now + span_start[i], span_count[i]
                    new, here = state[old + span_start[i] :][:count], state[at:][:count]
                    left, right = state[at - 1 :][:count], state[at + 1 :][:count]
                    above, below = state[at - width :][:count], state[at + width :][:count]
                    for c in range(count):  # separate slices, so that the compiler uses vector instructions
                        new[c] = centre * here[c] - new[c] + lam2 * ((left[c] + right[c]) + (above[c] + below[c]))
                for i in range(walls[row], walls[row + 1]):
                    j, k = np.uint64(now + wall_cell[i]), np.uint64(old + wall_cell[i])
                    around = (state[j - one] + state[j + one]) + (state[j - wide] + state[j + wide])
                    state[k] = wall_centre[i] * state[j] - wall_before[i] * state[k] + wall_around[i] * around
                if row * width <= source < (row + 1) * width and time < pulse.size:
                    state[old + source] += pulse[time]
                if time + 1 < recordings.shape[1]:
                    for i in range(receivers[row], receivers[row + 1]):
                        recordings[receiver_number[i], time + 1] = state[old + receiver_cell[i]]


class StencilTables(NamedTuple):
    """The grid as the compiled loops use it. Cells are numbered row by row, in a field with its padding."""

    width: int  # cells of a padded row
    lam2: float  # lam^2
    spans: np.ndarray  # (rows + 1,) int64, first span of each row
    # span_start, span_count: (S,) int64, first cell and number of cells of each span, a run of cells of one row that
    # have four neighbours inside the room
    span_start: np.ndarray
    span_count: np.ndarray
    walls: np.ndarray  # (rows + 1,) int64, first wall cell of each row
    wall_cell: np.ndarray  # (W,) int64, the other cells inside the room
    # wall_centre, wall_before, wall_around: (W,) float64, coefficients of p, of p_old and of the sum of the neighbours
    # in each wall cell
    wall_centre: np.ndarray
    wall_before: np.ndarray
    wall_around: np.ndarray
    source: int  # cell of the source
    pulse: np.ndarray  # (P,) float64, added to that cell, one sample per step
    receivers: np.ndarray  # (rows + 1,) int64, first microphone of each row, counted in the order of `receiver_cell`
    # receiver_cell, receiver_number: (N,) int64, cells of the microphones, ascending, and their rows in `recordings`
    receiver_cell: np.ndarray
    receiver_number: np.ndarray
    recordings: np.ndarray  # (N, T) float64, written at [:, step + 1]


def march(state: np.ndarray, step: int, stop: int, tables: StencilTables) -> None:
    """Advance the grid from `step` to `stop`, with several threads if the grid is large enough.

    `state` (2, rows, width) holds the fields at even and at odd steps, each with a border of zeros; it is changed in
    place.
    """
    rows, flat = state.shape[1] - 2, state.reshape(-1)
    strips = min(MAX_THREADS, os.cpu_count() or 1, rows // (2 * BLOCK))
    if strips <= 1:
        sweep(flat, step, stop - step, 1, rows + 1, 0, 0, *tables)
        return
    borders = [1 + rows * strip // strips for strip in range(strips + 1)]
    # For each strip, then for the triangle at each border: the first row, the row after the last, and how many rows
    # each of these two limits moves per step.
    narrowing = [(borders[i], borders[i + 1], min(1, i), -min(1, strips - 1 - i)) for i in range(strips)]
    widening = [(border, border, -1, 1) for border in borders[1:-1]]
    for start in range(step, stop, BLOCK):
        n = min(BLOCK, stop - start)
        for parts in (narrowing, widening):
            for _ in parallel_map(
                lambda part, start=start, n=n: sweep(flat, start, n, *part, *tables), parts, threaded=len(parts) > 1
            ):
                pass  # waits for each part
