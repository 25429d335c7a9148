"""Arrays in a room of three dimensions: their geometries, and what they are refused for.

    places_of    where the microphones of a scene stand, (N, 3)
    ball, box    random points, evenly in the volume
    plane        a regular lattice in a horizontal plane
    holds        point in convex hull

The field is known in closed form at any point, so nothing is snapped to cells.
"""

from __future__ import annotations

import numpy as np

from .array_layout import Array
from .scene import Scene
from .validation import InputError

CLEARANCE = 1e-6  # metres: microphones closer than this are one


def positions_3d(scene: Scene) -> np.ndarray:
    """Where the microphones stand : (N, 3) float64, metres; the height of a plane array included.

    Raises InputError for two microphones in one place, one outside the room, the source outside the room or inside the
    array.
    """
    places = _geometry(scene.array, np.random.default_rng([scene.seed, 0])) + scene.array.center
    size, source = np.array(scene.room.size), np.array(scene.source.position)
    distance = np.linalg.norm(places[:, None] - places[None], axis=-1) + np.eye(len(places))
    first, second = np.unravel_index(distance.argmin(), distance.shape)
    if distance[first, second] < CLEARANCE:
        raise InputError(f"array puts microphones {first} and {second} in one place; move one of them")
    outside = np.flatnonzero(np.any((places <= 0) | (places >= size), axis=1))
    if len(outside):
        raise InputError(
            f"array puts microphone {outside[0]} at {_text(places[outside[0]])}, outside the room; change array.center,"
            " the array or room.size"
        )
    if np.any((source < 0) | (source > size)):
        raise InputError(f"source.position = {source.tolist()} m lies outside the room; move it inside")
    if encloses_3d(places, source):
        raise InputError(
            f"source.position = {source.tolist()} m lies inside the array, where the field must have no source; move it"
            " outside the convex hull of the microphones"
        )
    return places


def ball(count: int, radius: float, rng: np.random.Generator) -> np.ndarray:
    """`count` random points in a ball round the origin, evenly in its volume : (count, 3) float64, metres."""
    directions = rng.standard_normal((count, 3))
    reach = radius * rng.random(count) ** (1 / 3)
    return directions * (reach / np.linalg.norm(directions, axis=1))[:, None]


def box(count: int, size, rng: np.random.Generator) -> np.ndarray:
    """`count` random points in a box of edges `size`, metres, round the origin : (count, 3) float64, metres."""
    return np.array(size) * (rng.random((count, 3)) - 0.5)


def plane(shape, size) -> np.ndarray:
    """Regular lattice of outer lengths `size`, metres, round the origin at height 0 : (nx * ny, 3), x fastest."""
    x, y = (np.linspace(-s / 2, s / 2, n) if n > 1 else np.zeros(1) for n, s in zip(shape, size, strict=True))
    x, y = np.meshgrid(x, y)
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def encloses_3d(points: np.ndarray, point: np.ndarray) -> bool:
    """Whether the convex hull of `points` (N, D), which may be flat, holds `point` (D,): a linear programme."""
    from scipy.optimize import linprog  # a second to load, which a measurement out of the cache does without

    equations = np.vstack([np.asarray(points, float).T, np.ones(len(points))])
    return linprog(np.zeros(len(points)), A_eq=equations, b_eq=np.append(point, 1.0)).status == 0


def _geometry(array: Array, rng: np.random.Generator) -> np.ndarray:
    """(N, 3) metres, about the array's centre."""
    if array.geometry == "ball":
        return ball(array.count, array.radius, rng)
    if array.geometry == "box":
        return box(array.count, array.size, rng)
    if array.geometry == "plane":
        return plane(array.shape, array.size)
    return np.array(array.positions, dtype=float)


def _text(point: np.ndarray) -> str:
    return f"({', '.join(f'{coordinate:.4g}' for coordinate in point)}) m"
