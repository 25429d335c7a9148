"""The grid of a simulation: which cells are inside a room, and the coefficients of the scheme in each of them.

`fdcal.acoustics.fdtd` states the scheme and its symbols.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..model.polygons import in_polygon
from ..model.room import Room
from ..model.validation import InputError

if TYPE_CHECKING:  # loads the compiler
    from .fdtd_kernels import StencilTables

ALIGNMENT = 8  # cells of a cache line: rows are stored in a whole number of them
FACE_TOLERANCE = 1e-6  # of a cell: a wall this close to a cell face lies on it
ON_AXIS = 1e-9  # metres: a wall whose ends differ less in a coordinate is parallel to an axis


@dataclass(frozen=True)
class Grid:
    """The coefficients of every cell."""

    mask: np.ndarray  # (ny, nx) bool, cells inside the room; row j is at y = (j + 0.5) h
    courant: float  # lam, dimensionless
    stiffness: np.ndarray  # (ny, nx) float64, K, dimensionless
    loss: np.ndarray  # (ny, nx) float64 b, dimensionless.


def make_grid(room: Room, sample_rate: float) -> Grid:
    """Return the coefficients of the scheme.

    `room`: of two dimensions; `sample_rate`: fs, Hz. Raises InputError: above the stability limit, for a room of three
    dimensions, and as `cell_mask` does.
    """
    if room.dimension != 2:
        raise InputError(
            f"room.size = {list(room.size or ())} has three lengths, and the grid has two",
            "compute its field with fdcal.acoustics.box_field",
            key="room.size",
            value=room.size,
        )
    courant = room.sound_speed / (sample_rate * room.cell_size)
    if courant > math.sqrt(0.5) * (1 + 1e-12):
        least = math.ceil(math.sqrt(2) * room.sound_speed / room.cell_size)
        raise InputError(
            f"source.sample_rate = {sample_rate:g} Hz breaks the CFL limit for room.cell = {room.cell:g} m",
            f"use at least {least} Hz",
            key="source.sample_rate",
            value=sample_rate,
        )
    mask = cell_mask(room)
    neighbours = neighbour_sum(mask.astype(float)) * mask
    faces = 4 * mask - neighbours
    return Grid(
        mask=mask,
        courant=courant,
        stiffness=neighbours + (2 * faces if room.walls == "pressure-release" else 0),
        loss=0.5 * courant * room.admittance * faces,
    )


def cell_mask(room: Room) -> np.ndarray:
    """Return the cells whose centre lies inside the room : (ny, nx) bool array, x along the rows.

    Raises InputError for a wall parallel to an axis that lies on no cell face, an outline left of or below the origin,
    and a room of no cells or of several pieces.
    """
    _check_walls(room)
    h = room.cell_size
    nx, ny = (math.ceil(length / h - FACE_TOLERANCE) for length in room.vertices.max(axis=0))
    centres = np.stack(np.meshgrid((np.arange(nx) + 0.5) * h, (np.arange(ny) + 0.5) * h), axis=-1)
    mask = in_polygon(centres, room.vertices)
    pieces = _count_pieces(mask)
    if pieces != 1:
        key = "room.size" if room.size else "room.outline"
        what = f"falls into {pieces} pieces" if pieces else "holds no cell centre"
        raise InputError(f"{key} {what} with room.cell = {h:g} m", "use a smaller cell or another outline", key=key)
    return mask


def _count_pieces(mask: np.ndarray) -> int:
    """Return the number of connected pieces."""
    from scipy.ndimage import label  # takes half a second to load, which reading a cached simulation does not need

    _, pieces = label(mask)  # pyright: ignore[reportGeneralTypeIssues, reportAssignmentType]
    return int(pieces)


def _check_walls(room: Room) -> None:
    """Raise InputError unless walls parallel to an axis lie on cell faces, and none left of or below the origin."""
    key = "room.size" if room.size else "room.outline"
    corners, h = room.vertices, room.cell_size
    if corners.min() < 0:
        problem = f"{key} has a coordinate of {corners.min():g} m"
        raise InputError(problem, "shift the scene so that none is below 0", key=key)
    straight = np.isclose(corners, np.roll(corners, -1, axis=0), rtol=0, atol=ON_AXIS)
    for value in corners[straight]:
        cells = value / h
        if abs(cells - round(cells)) > FACE_TOLERANCE:
            below, above = (f(cells) * h for f in (math.floor, math.ceil))
            raise InputError(
                f"{key} has a wall at {value:g} m, which is not a whole number of cells of room.cell = {h:g} m",
                f"use {below:g} or {above:g} m, or a cell that divides it",
                key=key,
                value=value,
            )


def neighbour_sum(p: np.ndarray) -> np.ndarray:
    """Return the sum over the four neighbours of every cell, zero beyond the edge : (ny, nx) float64."""
    q = np.pad(p, 1)
    return q[1:-1, :-2] + q[1:-1, 2:] + q[:-2, 1:-1] + q[2:, 1:-1]


def cells_at(grid: Grid, points, cell: float, name: str) -> np.ndarray:
    """Return row and column of the cells that contain given points.

    `points` (N, 2) float64, metres; `cell`: h, metres; `name`: what messages call the points. Returns (N, 2) int64.
    Raises InputError for a point outside the room.
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
    """Return the cells of a stored row: the room's, a border on either side, up to a whole number of cache lines."""
    return -(-(grid.mask.shape[1] + 2) // ALIGNMENT) * ALIGNMENT


def padded(values: np.ndarray, width: int) -> np.ndarray:
    """Return a (ny, nx) array in a border of zeros : (ny + 2, width)."""
    return np.pad(values, ((1, 1), (1, width - values.shape[1] - 1)))


def stencil_tables(grid: Grid, source, receivers) -> StencilTables:
    """Return the grid as the compiled loops use it, row by row with a border of one cell.

    `source`: its cell, (row, column), and the pulse (P,) float64; `receivers`: their cells (N, 2), and the recordings
    (N, T) float64 that are written.
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
    ends = (cells[:, 0] + 1) * width + cells[:, 1] + 1
    by_cell = np.argsort(ends, kind="stable")
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
        ends=np.searchsorted(ends[by_cell], rows),
        end_cell=ends[by_cell],
        end_number=by_cell,
        recordings=recordings,
    )
