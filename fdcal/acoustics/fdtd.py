"""Sound in a room of any outline: the 2-D wave equation on a grid, by the leapfrog scheme (paper, section 5).

    p       pressure at a cell centre; p_old, p, p_new at three successive steps
    lam     Courant number c / (fs h), at most 1 / sqrt(2)
    h, fs   cell size in metres, sampling rate in hertz

One equation holds for every cell,

    p_new = (2 p - (1 - b) p_old + lam^2 (sum of the neighbours inside - K p)) / (1 + b),

and two numbers a cell describe the walls at its faces. No flux passes a rigid face: K counts the neighbours inside.
A pressure-release face mirrors the pressure with its sign changed, so that it is zero on the face: 2 more in K. An
absorbing face of specific admittance beta satisfies dp/dn = -(beta / c) dp/dt, the derivative in time centred on the
step: b = lam beta / 2 for each such face. Walls lie on cell faces, cell centres at (i + 0.5) h.

`fdcal.acoustics.fdtd_grid` computes the coefficients, `fdcal.acoustics.fdtd_kernels` has the compiled loops.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ..model.room import Room, Source
from ..model.validation import InputError
from .fdtd_grid import Grid, cells_at, make_grid, neighbour_sum, padded, padded_width, stencil_tables

Progress = Callable[[float], None]

REPORTS = 50  # calls of `progress` in one run
CHUNK = 100_000_000  # cell updates between two checks for Ctrl-C, a few hundredths of a second
MOST_SAMPLES = 500_000_000  # of all recordings together, 4 GB
TAPS = 3.3  # length of a Hamming-windowed filter times its transition width over fs


def pulse_length(source: Source) -> int:
    """Return the length of the pulse in samples, to be checked before it is built: a low band needs much memory."""
    return 2 * math.ceil(0.5 * TAPS * source.band.sample_rate / source.band.low) + 1


def pulse(source: Source) -> np.ndarray:
    """Return a zero-mean pulse, flat from `source.low` to `source.high`, that starts and ends in silence.

    A linear-phase band-pass whose gain falls to zero within `source.low` hertz on either side of the band. The mean,
    small already, is removed exactly: a rigid room would keep it, or it would grow.

    Returns (P,) float64.
    """
    from scipy.signal import firwin, get_window  # takes a second to load, which a cached simulation does not need

    low, high, fs = source.band
    taps = pulse_length(source)
    edges = [0.5 * low, min(high + 0.5 * low, 0.5 * (high + 0.5 * fs))]
    samples = np.asarray(firwin(taps, edges, window="hamming", pass_zero=False, fs=fs))
    window = np.asarray(get_window("hamming", taps, fftbins=False))
    for _ in range(2):  # the second time for the rounding errors of the first
        samples = samples - window * (math.fsum(samples) / math.fsum(window))
    return samples


def simulate(room: Room, source: Source, receivers: np.ndarray, progress: Progress | None = None) -> np.ndarray:
    """Return the recordings of the source's pulse at the receivers.

    `room`: of two dimensions; `source`: position, band, sampling rate and duration; `receivers` (N, 2) float64, metres;
    each records the cell that contains it; `progress`: called with the fraction done, some 50 times; an exception that
    it raises ends the run. Returns (N, T) float64, any unit; T is duration times sample_rate, sample t at time t /
    sample_rate. Raises InputError if the CFL limit is broken, the source or a receiver is outside the room, or the
    recording is shorter than the pulse or larger than 4 GB.
    """
    fs = source.band.sample_rate
    grid = make_grid(room, fs)
    samples = round(source.duration * fs)
    _check_length(source, samples, len(receivers))
    signal = pulse(source)
    start = cells_at(grid, [source.place], room.cell_size, "source.position")[0]
    ends = cells_at(grid, receivers, room.cell_size, "microphone")
    recordings = np.zeros((len(ends), samples))
    state = np.zeros((2, grid.mask.shape[0] + 2, padded_width(grid)))
    _run(grid, state, samples - 1, (start, signal), (ends, recordings), progress)
    return recordings


def _check_length(source: Source, samples: int, receivers: int) -> None:
    """Raise InputError for recordings that are shorter than the pulse, or too long to hold."""
    duration = f"source.duration = {source.duration:g} s"
    if samples * max(receivers, 1) > MOST_SAMPLES:
        problem = f"{duration} makes recordings of over 4 GB"
        raise InputError(problem, "use a shorter one", key="source.duration", value=source.duration)
    taps = pulse_length(source)
    if samples < taps:
        raise InputError(
            f"{duration} is shorter than the pulse",
            f"use at least {math.ceil(1000 * taps / source.band.sample_rate) / 1000:g} s, or a higher source.low",
            key="source.duration",
            value=source.duration,
        )


def advance(grid: Grid, p_old: np.ndarray, p: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the last two fields after `steps` steps without a source.

    `p_old`, `p` (ny, nx) float64, two successive fields, any unit. Returns two (ny, nx) float64 arrays, the newer last.
    """
    state = np.stack([padded(field * grid.mask, padded_width(grid)) for field in (p, p_old)])
    _run(grid, state, steps, ((0, 0), np.zeros(0)), (np.zeros((0, 2), int), np.zeros((0, 0))), None)
    fields = state[:, 1:-1, 1 : grid.mask.shape[1] + 1]
    return fields[1 - steps % 2], fields[steps % 2]


def energy(grid: Grid, p_old: np.ndarray, p: np.ndarray) -> float:
    """Return the energy of two successive fields (ny, nx), any unit, which only absorbing walls change.

    Half of |p - p_old|^2 + lam^2 p . A p_old, with A p = K p - sum of the neighbours; not negative below the CFL limit.
    """
    stiff = grid.stiffness * p_old - neighbour_sum(p_old * grid.mask)
    return 0.5 * float(np.sum((p - p_old) ** 2 * grid.mask) + grid.courant**2 * np.sum(p * stiff * grid.mask))


def _run(grid: Grid, state: np.ndarray, steps: int, source, receivers, progress: Progress | None) -> None:
    """Advance `state` (2, ny + 2, width), [0] the newest, in chunks, so that Ctrl-C and `progress` are served."""
    from .fdtd_kernels import march  # loads the compiler, which reading a scene does not need

    tables = stencil_tables(grid, source, receivers)
    chunk = max(1, min(-(-steps // REPORTS), CHUNK // grid.mask.size))
    reported = 0
    for step in range(0, steps, chunk):
        stop = min(step + chunk, steps)
        march(state, step, stop, tables)
        if progress is not None and stop * REPORTS // steps > reported:
            reported = stop * REPORTS // steps
            progress(stop / steps)
