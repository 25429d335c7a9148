"""Positions of the microphones of a scene, checked; in a simulated room snapped to the cells of the simulation.

A simulated microphone records one FDTD cell. Cell i spans i h to (i + 1) h along an axis, counted from the origin of
the room's coordinates, so its centre is (i + 0.5) h; the snapped position is the true one. In a room of three
dimensions the field has a closed form at any point, so nothing is snapped.
"""

import numpy as np

from . import geometry
from .array_layout import Array
from .gauge import fixes_gauge
from .scene import Scene
from .validation import InputError, frozen_array, point_text

INSIDE = "inside the array, where the field must have no source"
OUTSIDE = "move it outside the convex hull of the microphones"
MIN_KNOWN = {
    2: "three microphones known that are not on one line",
    3: "four microphones known that are not in one plane",
}


def positions_of(scene: Scene) -> np.ndarray:
    """Return the positions of a scene's microphones : (N, D) float64, read-only, metres.

    In a simulated room on cell centres; D is 2 in a plane, whose height is left out. Raises InputError for positions,
    walls, a source or known microphones that cannot be.
    """
    if scene.room.dimension == 3:
        positions = positions_3d(scene)[:, : scene.array.dimension]
    else:
        cell = scene.room.cell_size
        positions = geometry.snap(_geometry(scene.array, cell, np.random.default_rng([scene.seed, 0])), cell)
        for check in (_check_distinct, _check_in_room, _check_walls, _check_source):
            check(positions, scene)
    _check_gauge(positions, scene)
    _check_search(positions, scene)
    return frozen_array(positions, float)


def _geometry(array: Array, cell: float, rng: np.random.Generator) -> np.ndarray:
    """Return the positions before they are snapped : (N, 2), metres."""
    center, shape, size = array.center or (0.0, 0.0), array.shape or (), array.size or ()
    if array.geometry == "circle":
        return geometry.circle(array.count or 0, array.radius or 0.0) + center
    if array.geometry == "rectangle":
        return geometry.rectangle(shape, size) + center
    if array.geometry == "rectangle+random":
        return geometry.rectangle_plus_random(shape, size, array.random, cell, rng, center)
    return np.array(array.positions, dtype=float) + center


def _check_distinct(positions: np.ndarray, scene: Scene) -> None:
    _, first, inverse = np.unique(positions, axis=0, return_index=True, return_inverse=True)
    twins = np.flatnonzero(first[inverse.ravel()] != np.arange(len(positions)))
    if len(twins):
        raise InputError(
            f"array puts microphones {first[inverse.ravel()][twins[0]]} and {twins[0]} in one cell at"
            f" {point_text(positions[twins[0]])}",
            f"use fewer microphones, a larger array or a room.cell below {scene.room.cell:g} m",
            key="array",
        )


def _check_in_room(positions: np.ndarray, scene: Scene) -> None:
    outside = np.flatnonzero(~geometry.in_polygon(positions, scene.room.vertices))
    if len(outside):
        key = "array.positions" if scene.array.geometry == "positions" else "array.center"
        problem = f"array puts microphone {outside[0]} at {point_text(positions[outside[0]])}, outside the room"
        raise InputError(f"{problem} or in a wall", f"change {key} or the room", key=key)


def _check_walls(positions: np.ndarray, scene: Scene) -> None:
    corners = geometry.convex_hull(positions)
    vertices = scene.room.vertices
    for a, b in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
        if geometry.crosses_polygon(a, b, corners):
            key = "room.size" if scene.room.size else "room.outline"
            raise InputError(
                f"{key} has a wall from {point_text(a)} to {point_text(b)} between the microphones, where nothing may"
                " obstruct the sound",
                "move the array (array.center) so that their convex hull is free of walls",
                key=key,
            )


def _check_source(positions: np.ndarray, scene: Scene) -> None:
    for key, position in zip(scene.emitter.keys, scene.emitter.places, strict=True):
        place, cell = f"{key} = {list(position)} m lies", geometry.snap(np.array(position), scene.room.cell_size)
        if not geometry.in_polygon(cell, scene.room.vertices):
            raise InputError(f"{place} outside the room or in a wall", "move it inside the room", key=key)
        if geometry.encloses(positions, cell):
            raise InputError(f"{place} {INSIDE}", OUTSIDE, key=key)


def _check_gauge(positions: np.ndarray, scene: Scene) -> None:
    known = scene.gauge.indices(len(positions))
    if len(known) == len(positions):
        remedy = "remove at least one from gauge.known"
        raise InputError("gauge leaves no microphone to be found", remedy, key="gauge.known")
    if scene.room.dimension == 3 and not known:  # a blind array: solver "joint" needs no known microphone
        return
    if not fixes_gauge(positions[list(known)]):
        key, value = ("gauge.known", known) if scene.gauge.free is None else ("gauge.free", scene.gauge.free)
        problem = f"{key} = {list(value)} does not fix translation, rotation and mirror image"
        raise InputError(problem, f"leave at least {MIN_KNOWN[positions.shape[1]]}", key=key, value=value)


def _check_search(positions: np.ndarray, scene: Scene) -> None:
    if scene.search is None:
        return
    low = np.array(scene.search.origin)
    high = low + scene.search.step * (np.array(scene.search.shape) - 1)
    known = scene.gauge.indices(len(positions))
    beyond = np.any((positions < low - geometry.ROUNDING) | (positions > high + geometry.ROUNDING), axis=1)
    beyond[list(known)] = False  # a known microphone is never searched for
    if beyond.any():
        n = int(np.argmax(beyond))
        problem = (
            f"microphone {n} at {point_text(positions[n])} lies outside the search domain {point_text(low)} to"
            f" {point_text(high)} and could never be found"
        )
        raise InputError(problem, "change search.origin or search.size", key="search.origin")


CLEARANCE = 1e-6  # metres: microphones closer than this count as one


def positions_3d(scene: Scene) -> np.ndarray:
    """Return the positions of a scene's microphones in space : (N, 3) float64, metres; InputError as `positions_of`."""
    positions = _geometry_3d(scene.array, np.random.default_rng([scene.seed, 0])) + (scene.array.center or 0.0)
    distance = np.linalg.norm(positions[:, None] - positions[None], axis=-1) + np.eye(len(positions))
    first, second = divmod(int(distance.argmin()), len(distance))
    if distance[first, second] < CLEARANCE:
        problem = f"array puts microphones {first} and {second} in one place"
        raise InputError(problem, "move one of them", key="array")
    if scene.room.response is None:
        _check_room_3d(scene, positions)
    return positions


def _check_room_3d(scene: Scene, positions: np.ndarray) -> None:
    """Raise InputError for a microphone or a source outside the room, or a source inside the array."""
    size = np.array(scene.room.size)
    outside = np.flatnonzero(np.any((positions <= 0) | (positions >= size), axis=1))
    if len(outside):
        problem = f"array puts microphone {outside[0]} at {point_text(positions[outside[0]])}, outside the room"
        raise InputError(problem, "change array.center, the array or room.size", key="array.center")
    for key, source in zip(scene.emitter.keys, scene.emitter.places, strict=True):
        place = f"{key} = {list(source)} m lies"
        if np.any((np.array(source) < 0) | (source > size)):
            raise InputError(f"{place} outside the room", "move it inside", key=key, value=list(source))
        if encloses_3d(positions, np.array(source)):
            raise InputError(f"{place} {INSIDE}", OUTSIDE, key=key, value=list(source))


def encloses_3d(points: np.ndarray, point: np.ndarray) -> bool:
    """Return whether `point` (D,) is a weighted mean of `points` (N, D): in their convex hull, which may be flat."""
    from scipy.optimize import linprog  # takes a second to load, which reading a cached measurement does not need

    equations = np.vstack([np.asarray(points, float).T, np.ones(len(points))])
    return linprog(np.zeros(len(points)), A_eq=equations, b_eq=np.append(point, 1.0)).status == 0


def _geometry_3d(array: Array, rng: np.random.Generator) -> np.ndarray:
    """Return the positions about the array's centre : (N, 3), metres."""
    if array.geometry == "ball":
        return geometry.ball(array.count or 0, array.radius or 0.0, rng)
    if array.geometry == "box":
        return geometry.box(array.count or 0, array.size, rng)
    if array.geometry == "plane":
        return geometry.plane(array.shape or (), array.size or ())
    return np.array(array.positions, dtype=float)
