"""Sound in a room of any outline: the 2-D wave equation on a grid, by the leapfrog scheme (paper, section 5).

    p       pressure at a cell centre; p_old, p, p_new at three successive steps
    lam     Courant number c / (fs h), at most 1 / sqrt(2)
    h, fs   cell size in metres, sampling rate in hertz

One form serves every cell,

    p_new = (2 p - (1 - b) p_old + lam^2 (sum of the neighbours inside - K p)) / (1 + b),

with what the wall does at each cell face in two numbers. A rigid face carries no flux: K counts the neighbours inside.
A pressure-release face mirrors the pressure with its sign changed, so that it is zero on the face: 2 more in K. An
absorbing face of specific admittance beta lets dp/dn = -(beta / c) dp/dt through, the derivative in time centred on the
step: b = lam beta / 2 for each such face. Walls lie on cell faces, cell centres at (i + 0.5) h.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..model.polygons import in_polygon
from ..model.room import Room, Source
from ..model.validation import InputError

Progress = Callable[[float], None]

REPORTS = 50  # calls of `progress` in one run
CHUNK = 100_000_000  # cell updates between two looks at Ctrl-C, a few hundredths of a second
MOST_SAMPLES = 500_000_000  # of all recordings together, 4 GB
TAPS = 3.3  # length of a Hamming-windowed filter times its transition width over fs


@dataclass(frozen=True)
class Grid:
    """The coefficients of every cell.

    Attributes
    ----------
    mask : (ny, nx) bool, cells inside the room; row j is at y = (j + 0.5) h
    courant : float, lam
    stiffness : (ny, nx) float64, K
    loss : (ny, nx) float64, b
    """

    mask: np.ndarray
    courant: float
    stiffness: np.ndarray
    loss: np.ndarray


def cell_mask(room: Room) -> np.ndarray:
    """Cells whose centre lies inside the room : (ny, nx) bool array, x along the rows.

    Raises InputError for a wall parallel to an axis that lies on no cell face, an outline left of or below the origin,
    and a room of no cells or of several pieces.
    """
    _check_walls(room)
    nx, ny = (math.ceil(length / room.cell - 1e-6) for length in room.vertices.max(axis=0))
    centres = np.stack(np.meshgrid((np.arange(nx) + 0.5) * room.cell, (np.arange(ny) + 0.5) * room.cell), axis=-1)
    mask = in_polygon(centres, room.vertices)
    pieces = _pieces(mask)
    if pieces != 1:
        key = "room.size" if room.size else "room.outline"
        what = f"falls into {pieces} pieces" if pieces else "holds no cell centre"
        raise InputError(f"{key} {what} with room.cell = {room.cell:g} m; use a smaller cell or mend the outline")
    return mask


def _pieces(mask: np.ndarray) -> int:
    """Number of connected pieces."""
    from scipy.ndimage import label  # half a second to load, which a simulation out of the cache does without

    return label(mask)[1]


def _check_walls(room: Room) -> None:
    """Walls parallel to an axis lie on cell faces, and none left of or below the origin."""
    key = "room.size" if room.size else "room.outline"
    corners = room.vertices
    if corners.min() < 0:
        raise InputError(f"{key} has a coordinate of {corners.min():g} m; shift the scene so that none is below 0")
    straight = np.isclose(corners, np.roll(corners, -1, axis=0), rtol=0, atol=1e-9)
    for value in corners[straight]:
        cells = value / room.cell
        if abs(cells - round(cells)) > 1e-6:
            below, above = (f(cells) * room.cell for f in (math.floor, math.ceil))
            raise InputError(
                f"{key} has a wall at {value:g} m, which is no whole number of cells of room.cell = {room.cell:g} m;"
                f" use {below:g} or {above:g} m, or a cell that divides it"
            )


def make_grid(room: Room, sample_rate: float) -> Grid:
    """Coefficients of the scheme for `room` at `sample_rate` Hz; InputError above the stability limit or for a box."""
    if room.dimension != 2:
        raise InputError(
            f"room.size = {list(room.size)} has three lengths, and the grid has two; fdcal.acoustics.box_field has its"
            " field"
        )
    courant = room.sound_speed / (sample_rate * room.cell)
    if courant > math.sqrt(0.5) * (1 + 1e-12):
        least = math.ceil(math.sqrt(2) * room.sound_speed / room.cell)
        raise InputError(
            f"source.sample_rate = {sample_rate:g} Hz breaks the CFL limit for room.cell = {room.cell:g} m;"
            f" use at least {least} Hz"
        )
    mask = cell_mask(room)
    neighbours = _neighbour_sum(mask.astype(float)) * mask
    faces = 4 * mask - neighbours
    return Grid(
        mask=mask,
        courant=courant,
        stiffness=neighbours + (2 * faces if room.walls == "pressure-release" else 0),
        loss=0.5 * courant * room.admittance * faces,
    )


def _neighbour_sum(p: np.ndarray) -> np.ndarray:
    """Sum over the four neighbours of every cell, zero beyond the edge : (ny, nx) float64."""
    q = np.pad(p, 1)
    return q[1:-1, :-2] + q[1:-1, 2:] + q[:-2, 1:-1] + q[2:, 1:-1]


def _taps(source: Source) -> int:
    """Length of the pulse in samples, told before it is built: a low enough band would fill the memory."""
    return 2 * math.ceil(0.5 * TAPS * source.sample_rate / source.low) + 1


def pulse(source: Source) -> np.ndarray:
    """Zero-mean pulse, flat from `source.low` to `source.high`, that starts and ends in silence : (P,) float64.

    A linear-phase band-pass whose gain falls to nothing in `source.low` hertz on either side of the band. The mean,
    small already, is taken off exactly: a rigid room keeps it for ever, or grows with it.
    """
    from scipy.signal import firwin, get_window  # a second to load, which a simulation out of the cache does without

    low, high, fs = source.low, source.high, source.sample_rate
    taps = _taps(source)
    edges = [0.5 * low, min(high + 0.5 * low, 0.5 * (high + 0.5 * fs))]
    samples = firwin(taps, edges, window="hamming", pass_zero=False, fs=fs)
    window = get_window("hamming", taps, fftbins=False)
    for _ in range(2):  # the second time for what rounding left
        samples = samples - window * (math.fsum(samples) / math.fsum(window))
    return samples


def simulate(room: Room, source: Source, receivers: np.ndarray, progress: Progress | None = None) -> np.ndarray:
    """Recordings of the source's pulse at the receivers.

    Parameters
    ----------
    room, source : walls and air; position, band, sampling rate and duration
    receivers : (N, 2) array, metres; each records the cell it lies in
    progress : called with the fraction done, some 50 times; what it raises ends the run

    Returns
    -------
    (N, T) float64 array, any unit, T = duration times sample_rate; sample t at time t / sample_rate

    Raises
    ------
    InputError
        The CFL limit is broken, the source or a receiver is outside the room, the recording is shorter than the pulse
        or too long to hold.
    """
    grid = make_grid(room, source.sample_rate)
    samples = round(source.duration * source.sample_rate)
    if samples * max(len(receivers), 1) > MOST_SAMPLES:
        raise InputError(f"source.duration = {source.duration:g} s makes recordings of over 4 GB; use a shorter one")
    taps = _taps(source)
    if samples < taps:
        raise InputError(
            f"source.duration = {source.duration:g} s is shorter than the pulse; use at least"
            f" {math.ceil(1000 * taps / source.sample_rate) / 1000:g} s, or a higher source.low"
        )
    signal = pulse(source)
    start = _cells(grid, [source.position], room.cell, "source.position")[0]
    ends = _cells(grid, receivers, room.cell, "microphone")
    recordings = np.zeros((len(ends), samples))
    state = np.zeros((2, grid.mask.shape[0] + 2, _width(grid)))
    _run(grid, state, samples - 1, (start, signal), (ends, recordings), progress)
    return recordings


def advance(grid: Grid, p_old: np.ndarray, p: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """The last two fields after `steps` steps without a source, from two fields : all (ny, nx) float64, newer last."""
    state = np.stack([_framed(field * grid.mask, _width(grid)) for field in (p, p_old)])
    _run(grid, state, steps, ((0, 0), np.zeros(0)), (np.zeros((0, 2), int), np.zeros((0, 0))), None)
    fields = state[:, 1:-1, 1 : grid.mask.shape[1] + 1]
    return fields[1 - steps % 2], fields[steps % 2]


def energy(grid: Grid, p_old: np.ndarray, p: np.ndarray) -> float:
    """Energy of two successive fields (ny, nx), any unit: what the scheme keeps exactly, or loses to absorbing walls.

    Half of |p - p_old|^2 + lam^2 p . A p_old, with A p = K p - sum of the neighbours; not negative below the CFL limit.
    """
    stiff = grid.stiffness * p_old - _neighbour_sum(p_old * grid.mask)
    return 0.5 * float(np.sum((p - p_old) ** 2 * grid.mask) + grid.courant**2 * np.sum(p * stiff * grid.mask))


def _cells(grid: Grid, points, cell: float, name: str) -> np.ndarray:
    """Row and column of the cells that hold `points`, (N, 2) metres : (N, 2) int64; InputError for one outside."""
    points = np.asarray(points, dtype=float).reshape(-1, 2)
    cells = np.floor(points[:, ::-1] / cell + 1e-9).astype(np.int64)
    fits = np.all((cells >= 0) & (cells < grid.mask.shape), axis=1)
    fits[fits] = grid.mask[tuple(cells[fits].T)]
    for index in np.flatnonzero(~fits):
        which = f"{name} {index}" if name == "microphone" else name
        x, y = points[index]
        raise InputError(f"{which} = [{x:g}, {y:g}] m is outside the room or in a wall; move it inside")
    return cells


def _run(grid, state, steps, source, receivers, progress) -> None:
    """Advance `state` (2, ny + 2, width), [0] the newest, in chunks between which Ctrl-C and `progress` get a turn."""
    from .fdtd_kernels import march  # loads the compiler, which reading a scene should not

    tables = _tables(grid, source, receivers)
    chunk = max(1, min(-(-steps // REPORTS), CHUNK // grid.mask.size))
    reported = 0
    for step in range(0, steps, chunk):
        stop = min(step + chunk, steps)
        march(state, step, stop, tables)
        if progress is not None and stop * REPORTS // steps > reported:
            reported = stop * REPORTS // steps
            progress(stop / steps)


def _width(grid: Grid) -> int:
    """Cells of a stored row: the room's, a border on either side, and up to a whole number of cache lines."""
    return -(-(grid.mask.shape[1] + 2) // 8) * 8


def _framed(values: np.ndarray, width: int) -> np.ndarray:
    """(ny, nx) array in a border of zeros : (ny + 2, width)."""
    return np.pad(values, ((1, 1), (1, width - values.shape[1] - 1)))


def _tables(grid: Grid, source, receivers) -> tuple:
    """What `stencil.march` needs to know of the grid, laid out row by row in a grid with a border of one cell."""
    width = _width(grid)
    mask, stiffness, loss = (_framed(values, width) for values in (grid.mask, grid.stiffness, grid.loss))
    rows = np.arange(len(mask) + 1) * width
    inner = _framed((_neighbour_sum(grid.mask.astype(float)) == 4) & grid.mask, width).ravel()
    edges = np.flatnonzero(np.diff(inner.astype(np.int8))) + 1
    start, stop = edges[::2], edges[1::2]
    walls = np.flatnonzero(mask.ravel() & ~inner)
    stiffness, loss = stiffness.ravel()[walls], loss.ravel()[walls]
    lam2 = grid.courant**2
    (row, column), signal = source
    cells, recordings = receivers
    ends = (cells[:, 0] + 1) * width + cells[:, 1] + 1
    by_cell = np.argsort(ends, kind="stable")
    spans = np.searchsorted(start, rows), start.copy(), stop - start
    coefficients = (2 - lam2 * stiffness) / (1 + loss), (1 - loss) / (1 + loss), lam2 / (1 + loss)
    walls = np.searchsorted(walls, rows), walls, *coefficients
    source = (int(row) + 1) * width + int(column) + 1, signal
    return (
        width,
        lam2,
        *spans,
        *walls,
        *source,
        np.searchsorted(ends[by_cell], rows),
        ends[by_cell],
        by_cell,
        recordings,
    )
