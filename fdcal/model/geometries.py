"""Geometries of arrays about the origin, and the cells of a grid. Lengths are metres.

circle, rectangle, rectangle_plus_random    in the plane
ball, box, plane                            in space
snap, cells_of                              cells of a grid that contain given points
"""

from __future__ import annotations

import numpy as np

from .polygons import ROUNDING
from .validation import InputError


def circle(count: int, radius: float) -> np.ndarray:
    """Return `count` points evenly spaced on a circle about the origin : (count, 2) float64, metres."""
    angles = 2 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def rectangle(shape: tuple[int, ...], size: tuple[float, ...]) -> np.ndarray:
    """Return a regular lattice about the origin.

    `shape` (2,) int, points along x and y; an axis with a single point has it at 0; `size` (2,) float, outer lengths,
    metres. Returns (nx * ny, 2) float64, metres, x fastest.
    """
    x, y = (np.linspace(-s / 2, s / 2, n) if n > 1 else np.zeros(1) for n, s in zip(shape, size, strict=True))
    return np.column_stack([axis.ravel() for axis in np.meshgrid(x, y)])


def rectangle_plus_random(
    shape: tuple[int, ...],
    size: tuple[float, ...],
    extra: int,
    cell: float,
    rng: np.random.Generator,
    center: tuple[float, ...] = (0.0, 0.0),
) -> np.ndarray:
    """Return a regular lattice, then `extra` points drawn without replacement from the free cells inside it.

    Unlike the other geometries this one takes its `center`: which cells are free depends on it.

    `shape`, `size`: see `rectangle`; `cell`: edge of a cell, metres; `center` (2,) float, metres. Returns (nx * ny +
    extra, 2) float64, metres, on cell centres. Raises InputError: fewer free cells than `extra`.
    """
    regular = cells_of(rectangle(shape, size) + center, cell)
    low, high = regular.min(axis=0), regular.max(axis=0)
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    taken = {tuple(index) for index in regular.tolist()}
    free = [index for index in zip(x.ravel().tolist(), y.ravel().tolist(), strict=True) if index not in taken]
    if extra > len(free):
        raise InputError(
            f"array.random = {extra} is more than the {len(free)} free cells of room.cell = {cell:g} m inside"
            f" array.size = {list(size)} m",
            f"use at most {len(free)}",
            key="array.random",
            value=extra,
        )
    drawn = np.array(free)[rng.choice(len(free), extra, replace=False)]
    return (np.concatenate([regular, drawn]) + 0.5) * cell


def snap(points: np.ndarray, cell: float) -> np.ndarray:
    """Return the centres of the cells that contain `points` : (..., 2) float64, metres."""
    return (cells_of(points, cell) + 0.5) * cell


def cells_of(points: np.ndarray, cell: float) -> np.ndarray:
    """Return the indices of the cells that contain `points` : (..., 2) int64."""
    return np.floor(np.asarray(points, dtype=float) / cell + ROUNDING).astype(np.int64)


def ball(count: int, radius: float, rng: np.random.Generator) -> np.ndarray:
    """Return `count` random points in a ball, uniform in its volume : (count, 3) float64, metres."""
    directions = rng.standard_normal((count, 3))
    reach = radius * rng.random(count) ** (1 / 3)
    return directions * (reach / np.linalg.norm(directions, axis=1))[:, None]


def box(count: int, size, rng: np.random.Generator) -> np.ndarray:
    """Return `count` random points in a box of edges `size` (3,), metres, uniform : (count, 3) float64, metres."""
    return np.array(size) * (rng.random((count, 3)) - 0.5)


def plane(shape: tuple[int, ...], size: tuple[float, ...]) -> np.ndarray:
    """Return the lattice of `rectangle` at height 0 : (nx * ny, 3) float64, metres, x fastest."""
    flat = rectangle(shape, size)
    return np.column_stack([flat, np.zeros(len(flat))])
