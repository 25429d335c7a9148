"""Positions of the microphones of a scene in a room of three dimensions, and their checks.

    positions_3d    the array of a scene, its height included
    encloses_3d     whether a convex hull contains a point

The field has a closed form at any point, so nothing is snapped to cells.
"""

from __future__ import annotations

import numpy as np

from .array_layout import Array
from .geometries import ball, box, plane
from .scene import Scene
from .validation import InputError, point_text

CLEARANCE = 1e-6  # metres: microphones closer than this count as one


def positions_3d(scene: Scene) -> np.ndarray:
    """Return the positions of a scene's microphones in space.

    Returns (N, 3) float64, metres; the height of a plane array included. Raises InputError: two microphones at one
    position, one outside the room, the source outside the room or inside the array. Where the walls and the source of a
    measured room are is unknown.
    """
    positions = _geometry(scene.array, np.random.default_rng([scene.seed, 0])) + (scene.array.center or 0.0)
    distance = np.linalg.norm(positions[:, None] - positions[None], axis=-1) + np.eye(len(positions))
    first, second = np.unravel_index(distance.argmin(), distance.shape)
    if distance[first, second] < CLEARANCE:
        problem = f"array puts microphones {first} and {second} in one place"
        raise InputError(problem, "move one of them", key="array")
    if scene.room.response is None:
        _check_room(scene, positions)
    return positions


def _check_room(scene: Scene, positions: np.ndarray) -> None:
    """Raise InputError for a microphone or a source outside the room, or a source inside the array."""
    size = np.array(scene.room.size)
    outside = np.flatnonzero(np.any((positions <= 0) | (positions >= size), axis=1))
    if len(outside):
        raise InputError(
            f"array puts microphone {outside[0]} at {point_text(positions[outside[0]])}, outside the room",
            "change array.center, the array or room.size",
            key="array.center",
        )
    for key, place in zip(scene.emitter.keys, scene.emitter.places, strict=True):
        _check_source(key, np.array(place), positions, size)


def _check_source(key: str, source: np.ndarray, positions: np.ndarray, size: np.ndarray) -> None:
    place = f"{key} = {source.tolist()} m lies"
    if np.any((source < 0) | (source > size)):
        raise InputError(f"{place} outside the room", "move it inside", key=key, value=source.tolist())
    if encloses_3d(positions, source):
        raise InputError(
            f"{place} inside the array, where the field must have no source",
            "move it outside the convex hull of the microphones",
            key=key,
            value=source.tolist(),
        )


def encloses_3d(points: np.ndarray, point: np.ndarray) -> bool:
    """Return whether the convex hull of `points` (N, D), which may be flat, contains `point` (D,).

    A linear programme: whether `point` is a weighted mean of the points.
    """
    from scipy.optimize import linprog  # takes a second to load, which reading a cached measurement does not need

    equations = np.vstack([np.asarray(points, float).T, np.ones(len(points))])
    return linprog(np.zeros(len(points)), A_eq=equations, b_eq=np.append(point, 1.0)).status == 0


def _geometry(array: Array, rng: np.random.Generator) -> np.ndarray:
    """Return the positions about the array's centre : (N, 3), metres."""
    if array.geometry == "ball":
        return ball(array.count or 0, array.radius or 0.0, rng)
    if array.geometry == "box":
        return box(array.count or 0, array.size, rng)
    if array.geometry == "plane":
        return plane(array.shape or (), array.size or ())
    return np.array(array.positions, dtype=float)
