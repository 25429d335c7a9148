"""Points in the plane and in space, metres: polygons, hulls, geometries of arrays, cells of a grid, a random source."""

from collections.abc import Callable
from typing import Any

import numpy as np

from .validation import refusal

ROUNDING = 1e-9  # of a coordinate, metres, and of an angle, radians: differences this small are none


def in_polygon(points: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Return which points (..., 2) lie inside the polygon of `vertices` (V, 2), in order, by the even-odd rule."""
    x, y = np.moveaxis(np.asarray(points, dtype=float), -1, 0)
    crossings = np.zeros(x.shape, dtype=bool)
    for (xa, ya), (xb, yb) in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
        if ya != yb:  # a horizontal edge is never crossed by the horizontal ray
            spans = (ya > y) != (yb > y)
            crossings ^= spans & (x < xa + (y - ya) * (xb - xa) / (yb - ya))
    return crossings


def encloses(points: np.ndarray, point: np.ndarray) -> bool:
    """Return whether the convex hull of `points` (N, 2) contains `point` (2,), its edge included.

    Seen from inside, the points leave no gap of more than half a turn. Valid for collinear points, too.
    """
    seen = np.asarray(points, dtype=float) - point
    if np.any(np.all(np.abs(seen) < ROUNDING, axis=1)):
        return True
    angles = np.sort(np.arctan2(seen[:, 1], seen[:, 0]))
    gaps = np.diff(angles, append=angles[0] + 2 * np.pi)
    return bool(gaps.max() <= np.pi + ROUNDING)


def convex_hull(points: np.ndarray) -> np.ndarray:
    """Return the corners of the convex hull of `points` (N, 2), anticlockwise : (H, 2) float64.

    Collinear points have the two outermost as their hull. Monotone chain: the points from left to right, and of each
    side only those where it turns left.
    """
    ordered = np.unique(np.asarray(points, dtype=float), axis=0)
    sides: list[np.ndarray] = []
    for row in (ordered, ordered[::-1]):
        side: list[np.ndarray] = []
        for point in row:
            while len(side) > 1 and _turn(side[-2], side[-1], point) <= ROUNDING**2:
                side.pop()
            side.append(point)
        sides += side[:-1]
    return np.array(sides) if sides else ordered


def crosses_polygon(a: np.ndarray, b: np.ndarray, corners: np.ndarray) -> bool:
    """Return whether the segment from `a` to `b` enters the convex polygon of `corners` (H, 2), or touches it."""
    if encloses(corners, a) or encloses(corners, b):
        return True
    for c, d in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        ends, sides = (_turn(a, b, c), _turn(a, b, d)), (_turn(c, d, a), _turn(c, d, b))
        if np.prod(np.sign(ends)) <= 0 and np.prod(np.sign(sides)) <= 0 and any(ends):
            return True
    return False


def _turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """Return twice the signed area of a triangle, m^2: above zero where the path a, b, c turns left."""
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def circle(count: int, radius: float) -> np.ndarray:
    """Return `count` points evenly spaced on a circle about the origin : (count, 2) float64, metres."""
    angles = 2 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def rectangle(shape: tuple[int, ...], size: tuple[float, ...]) -> np.ndarray:
    """Return a regular lattice about the origin, of `shape` points and lengths `size` : (nx * ny, 2), x fastest."""
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
    """Return a regular lattice, then `extra` points drawn from the free cells inside it : (nx * ny + extra, 2), metres.

    Unlike the other geometries this one takes its `center`: which cells are free depends on it.
    """
    regular = cells_of(rectangle(shape, size) + center, cell)
    low, high = regular.min(axis=0), regular.max(axis=0)
    x, y = np.meshgrid(*(np.arange(float(low[a]), float(high[a]) + 1) for a in (0, 1)))
    taken = {tuple(index) for index in regular.tolist()}
    free = [index for index in zip(x.ravel().tolist(), y.ravel().tolist(), strict=True) if index not in taken]
    if extra > len(free):
        why = f"is more than the {len(free)} free cells of room.cell = {cell:g} m inside array.size = {list(size)} m"
        raise refusal("array.random", extra, why, f"use at most {len(free)}")
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


def box(count: int, size: Any, rng: np.random.Generator) -> np.ndarray:
    """Return `count` random points in a box of edges `size` (3,), metres, uniform : (count, 3) float64, metres."""
    return np.array(size) * (rng.random((count, 3)) - 0.5)


def plane(shape: tuple[int, ...], size: tuple[float, ...]) -> np.ndarray:
    """Return the lattice of `rectangle` at height 0 : (nx * ny, 3) float64, metres, x fastest."""
    flat = rectangle(shape, size)
    return np.column_stack([flat, np.zeros(len(flat))])


WALL_DISTANCE_M = 0.1  # of a source from every wall at least: half the depth of a small loudspeaker
DRAWS = 500  # before a room is taken to have no place


def random_source(
    size: Any,
    microphones: np.ndarray,
    clearance: float,
    rng: np.random.Generator,
    allowed: Callable[[np.ndarray], bool],
) -> np.ndarray | None:
    """Return a place drawn evenly over a room of lengths `size`, rounded to a millimetre; None where none was found.

    It is `clearance` away from all microphones (N, 2 or 3), horizontally where these have no heights, and `allowed`.
    """
    lengths = np.asarray(size, float)
    for _ in range(DRAWS):
        place = np.round(WALL_DISTANCE_M + rng.random(len(lengths)) * (lengths - 2 * WALL_DISTANCE_M), 3)
        away = np.linalg.norm(microphones - place[: microphones.shape[1]], axis=1).min()
        if away > clearance and allowed(place):
            return place
    return None
