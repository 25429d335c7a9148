"""Sound in a room of any outline: the 2-D wave equation on a grid, by the leapfrog scheme (paper, section 5).

    p       pressure at a cell centre; p_old, p and p_new are its values at three successive time steps
    lam     Courant number c / (fs h), at most 1 / sqrt(2)
    h, fs   cell size in metres, sampling rate in hertz

One equation holds for every cell,

    p_new = (2 p - (1 - b) p_old + lam^2 (sum of the neighbours inside - K p)) / (1 + b),

in which two coefficients per cell, K and b, describe the walls at its faces. K is the number of neighbours inside the
room, so that no flux passes through a rigid face. At a pressure-release face the pressure is mirrored with opposite
sign, so that it is zero on the face; this adds 2 to K. An absorbing face of specific admittance beta satisfies
dp/dn = -(beta / c) dp/dt. With a central difference for the time derivative, each such face adds lam beta / 2 to b.
Walls lie on cell faces; cell centres lie at (i + 0.5) h.

The compiled loops are in `fdcal.acoustics.fdtd_kernels`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..model.arrays import in_polygon
from ..model.scene import Room, Source
from ..model.validation import InputError, refusal

if TYPE_CHECKING:
    from .fdtd_kernels import StencilTables


ALIGNMENT = 8  # cells per cache line; each row is padded to a whole number of cache lines
FACE_TOLERANCE = 1e-6  # in cells; a wall that is closer than this to a cell face counts as lying on it
ON_AXIS = 1e-9  # metres; a wall is parallel to an axis if its ends differ by less than this in one coordinate


@dataclass(frozen=True)
class Grid:
    """The coefficients of the scheme for every cell."""

    mask: np.ndarray  # (ny, nx) bool, true for cells inside the room; row j is at y = (j + 0.5) h
    courant: float  # lam, dimensionless
    stiffness: np.ndarray  # (ny, nx) float64, K, dimensionless
    loss: np.ndarray  # (ny, nx) float64, b, dimensionless


def make_grid(room: Room, sample_rate: float) -> Grid:
    """Return the coefficients of the scheme for the cells whose centres are inside the room.

    Raises InputError if the Courant number exceeds the stability limit, if the room has three dimensions, consists of
    several pieces or has a negative coordinate, or if a wall that is parallel to an axis does not lie on cell faces.
    """
    from scipy.ndimage import label  # imported here: it loads in 0.5 s, and a cached simulation does not need it

    h, corners, key = room.cell_size, room.vertices, "room.size" if room.size else "room.outline"
    courant = room.sound_speed / (sample_rate * h)
    if courant > math.sqrt(0.5) * (1 + 1e-12):
        least = math.ceil(math.sqrt(2) * room.sound_speed / h)
        why = f"breaks the CFL limit for room.cell = {h:g} m"
        raise refusal("source.sample_rate", sample_rate, why, f"use at least {least} Hz", "Hz")
    if corners.min() < 0:
        raise InputError(f"{key} has a coordinate of {corners.min():g} m", "move it until none is below 0", key=key)
    straight = np.isclose(corners, np.roll(corners, -1, axis=0), rtol=0, atol=ON_AXIS)
    for value in corners[straight]:
        cells = value / h
        if abs(cells - round(cells)) > FACE_TOLERANCE:
            below, above = (f(cells) * h for f in (math.floor, math.ceil))
            problem = f"{key} has a wall at {value:g} m, which is not a whole number of cells of room.cell = {h:g} m"
            raise InputError(problem, f"use {below:g} or {above:g} m, or a cell that divides it", key=key)
    nx, ny = (math.ceil(length / h - FACE_TOLERANCE) for length in corners.max(axis=0))
    centres = np.stack(np.meshgrid((np.arange(nx) + 0.5) * h, (np.arange(ny) + 0.5) * h), axis=-1)
    mask = in_polygon(centres, corners)
    _, pieces = label(mask)  # pyright: ignore[reportGeneralTypeIssues, reportAssignmentType]
    if pieces != 1:
        what = f"falls into {pieces} pieces" if pieces else "holds no cell centre"
        raise InputError(f"{key} {what} with room.cell = {h:g} m", "use a smaller cell or another outline", key=key)
    neighbours = neighbour_sum(mask.astype(float)) * mask
    faces = 4 * mask - neighbours
    return Grid(
        mask=mask,
        courant=courant,
        stiffness=neighbours + (2 * faces if room.walls == "pressure-release" else 0),
        loss=0.5 * courant * room.admittance * faces,
    )


def neighbour_sum(p: np.ndarray) -> np.ndarray:
    """Return the sum of p over the four neighbours of every cell, with p = 0 beyond the edge : (ny, nx) float64."""
    q = np.pad(p, 1)
    return q[1:-1, :-2] + q[1:-1, 2:] + q[:-2, 1:-1] + q[2:, 1:-1]


def cells_at(grid: Grid, points, cell: float, name: str) -> np.ndarray:
    """Return row and column (N, 2) of the cells that contain points (N, 2), metres; `cell` is the cell size, metres.

    Raises InputError for a point outside the room; the message calls the point `name`.
    """
    points = np.asarray(points, dtype=float).reshape(-1, 2)
    cells = np.floor(points[:, ::-1] / cell + 1e-9).astype(np.int64)
    fits = np.all((cells >= 0) & (cells < grid.mask.shape), axis=1)
    fits[fits] = grid.mask[tuple(cells[fits].T)]
    for index in np.flatnonzero(~fits):
        which = f"{name} {index}" if name == "microphone" else name
        x, y = points[index]
        raise InputError(f"{which} = [{x:g}, {y:g}] m is outside the room or in a wall", "move it inside", key=name)
    return cells


def padded_width(grid: Grid) -> int:
    """Return the number of cells in a stored row: the room and one border cell on either side, in whole cache lines."""
    return -(-(grid.mask.shape[1] + 2) // ALIGNMENT) * ALIGNMENT


def padded(values: np.ndarray, width: int) -> np.ndarray:
    """Return a (ny, nx) array surrounded by a border of zeros : (ny + 2, width)."""
    return np.pad(values, ((1, 1), (1, width - values.shape[1] - 1)))


def stencil_tables(grid: Grid, source, receivers) -> StencilTables:
    """Return the grid as the compiled loops use it, row by row with a border of one cell.

    `source` holds the cell of the source, (row, column), and the pulse (P,). `receivers` holds the cells of the
    receivers (N, 2) and the recordings (N, T), which the loops fill.
    """
    from .fdtd_kernels import StencilTables

    width = padded_width(grid)
    mask, stiffness, loss = (padded(values, width) for values in (grid.mask, grid.stiffness, grid.loss))
    rows = np.arange(len(mask) + 1) * width
    inner = padded((neighbour_sum(grid.mask.astype(float)) == 4) & grid.mask, width).ravel()
    edges = np.flatnonzero(np.diff(inner.astype(np.int8))) + 1
    start, stop = edges[::2], edges[1::2]
    walls = np.flatnonzero(mask.ravel() & ~inner)
    stiffness, loss = stiffness.ravel()[walls], loss.ravel()[walls]
    lam2 = grid.courant**2
    (row, column), signal = source
    cells, recordings = receivers
    receiver_cell = (cells[:, 0] + 1) * width + cells[:, 1] + 1
    by_cell = np.argsort(receiver_cell, kind="stable")
    return StencilTables(
        width=width,
        lam2=lam2,
        spans=np.searchsorted(start, rows),
        span_start=start.copy(),
        span_count=stop - start,
        walls=np.searchsorted(walls, rows),
        wall_cell=walls,
        wall_centre=(2 - lam2 * stiffness) / (1 + loss),
        wall_before=(1 - loss) / (1 + loss),
        wall_around=lam2 / (1 + loss),
        source=(int(row) + 1) * width + int(column) + 1,
        pulse=signal,
        receivers=np.searchsorted(receiver_cell[by_cell], rows),
        receiver_cell=receiver_cell[by_cell],
        receiver_number=by_cell,
        recordings=recordings,
    )


Progress = Callable[[float], None]

REPORTS = 50  # number of calls of `progress` in a run
CHUNK = 100_000_000  # cell updates between two checks for Ctrl-C; they take a few hundredths of a second
MAX_SAMPLES = 500_000_000  # largest number of samples in all recordings together; they occupy 4 GB
TAPS = 3.3  # length of a Hamming-windowed filter in samples, times its transition width divided by fs


def pulse_length(source: Source) -> int:
    """Return the length of the pulse in samples, without building the pulse, which might fill the memory."""
    return 2 * math.ceil(0.5 * TAPS * source.band.sample_rate / source.band.low) + 1


def pulse(source: Source) -> np.ndarray:
    """Return a zero-mean pulse of finite length whose spectrum is flat from `source.low` to `source.high` : (P,).

    It is the impulse response of a linear-phase band-pass filter whose gain falls to zero within `source.low` hertz on
    either side of the band. The mean is small already, and is removed exactly, because in a rigid room it would never
    decay and rounding errors might make it grow.
    """
    from scipy.signal import firwin, get_window  # imported here: it loads in 1 s; a cached simulation does not need it

    low, high, fs = source.band
    taps = pulse_length(source)
    edges = [0.5 * low, min(high + 0.5 * low, 0.5 * (high + 0.5 * fs))]
    samples = np.asarray(firwin(taps, edges, window="hamming", pass_zero=False, fs=fs))
    window = np.asarray(get_window("hamming", taps, fftbins=False))
    for _ in range(2):  # the second time for the rounding errors of the first
        samples = samples - window * (math.fsum(samples) / math.fsum(window))
    return samples


def simulate(room: Room, source: Source, receivers: np.ndarray, progress: Progress | None = None) -> np.ndarray:
    """Return the recordings of the source's pulse in the cells of the receivers (N, 2), metres : (N, T), any unit.

    `progress` is called about 50 times with the fraction done; an exception that it raises ends the run. Raises
    InputError for a duration that is too long or shorter than the pulse, and as `make_grid` and `cells_at` do.
    """
    fs = source.band.sample_rate
    grid = make_grid(room, fs)
    samples, taps = round(source.duration * fs), pulse_length(source)
    if samples * max(len(receivers), 1) > MAX_SAMPLES:
        raise refusal("source.duration", source.duration, "makes recordings of over 4 GB", "use a shorter one", "s")
    if samples < taps:
        remedy = f"use at least {math.ceil(1000 * taps / fs) / 1000:g} s, or a higher source.low"
        raise refusal("source.duration", source.duration, "is shorter than the pulse", remedy, "s")
    source_cell = cells_at(grid, [source.place], room.cell_size, "source.position")[0]
    receiver_cells = cells_at(grid, receivers, room.cell_size, "microphone")
    recordings = np.zeros((len(receivers), samples))
    state = np.zeros((2, grid.mask.shape[0] + 2, padded_width(grid)))
    _run(grid, state, samples - 1, (source_cell, pulse(source)), (receiver_cells, recordings), progress)
    return recordings


def advance(grid: Grid, p_old: np.ndarray, p: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the last two fields (ny, nx), any unit, the newer one last, after `steps` time steps without a source."""
    state = np.stack([padded(field * grid.mask, padded_width(grid)) for field in (p, p_old)])
    _run(grid, state, steps, ((0, 0), np.zeros(0)), (np.zeros((0, 2), int), np.zeros((0, 0))), None)
    fields = state[:, 1:-1, 1 : grid.mask.shape[1] + 1]
    return fields[1 - steps % 2], fields[steps % 2]


def _run(grid: Grid, state: np.ndarray, steps: int, source, receivers, progress: Progress | None) -> None:
    """Advance `state` (2, ny + 2, width), whose first field is the newest, in place.

    It is advanced in chunks, between which Ctrl-C takes effect and `progress` is called.
    """
    from .fdtd_kernels import march  # imported here: it loads the compiler, which reading a scene does not need

    tables = stencil_tables(grid, source, receivers)
    chunk = max(1, min(-(-steps // REPORTS), CHUNK // grid.mask.size))
    reported = 0
    for step in range(0, steps, chunk):
        stop = min(step + chunk, steps)
        march(state, step, stop, tables)
        if progress is not None and stop * REPORTS // steps > reported:
            reported = stop * REPORTS // steps
            progress(stop / steps)
