"""Geometries of points in the plane and in space, metres, and the checked positions of a scene's microphones.

A simulated microphone records one FDTD cell. Cell i extends from i h to (i + 1) h along an axis, from the origin of the
room's coordinates, so its centre is (i + 0.5) h, which is the true position of the microphone. In a room of three
dimensions the field has a closed form at any point, and positions are not moved to cell centres.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from .gauge import MIN_KNOWN, fixes_gauge
from .scene import Array, Scene
from .validation import InputError, Reals, frozen_array, point_text, refusal


def positions_of(scene: Scene) -> np.ndarray:
    """Return the positions of a scene's microphones : (N, D) float64, read-only, metres.

    In a room of two dimensions they are cell centres. D is 2 for a plane array, whose height is left out. Raises
    InputError for impossible positions, walls, source or known microphones.
    """
    if scene.room.dimension == 3:
        positions = positions_3d(scene)[:, : scene.array.dimension]
    else:
        cell = scene.room.cell_size
        positions = snap(geometry(scene.array, np.random.default_rng([scene.seed, 0]), cell), cell)
        _require_apart(positions, f"use fewer microphones, a larger array or a room.cell below {scene.room.cell:g} m")
        vertices = scene.room.vertices
        key = "array.positions" if scene.array.geometry == "positions" else "array.center"
        _require_clear(positions, scene, lambda x: in_polygon(x, vertices), key)
        for a, b in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
            if hull_meets(positions, np.array([a, b])):
                key = "room.size" if scene.room.size else "room.outline"
                wall = f"{key} has a wall from {point_text(a)} to {point_text(b)} between the microphones"
                raise InputError(f"{wall}, where nothing may obstruct sound", "move the array (array.center)", key=key)
    known = scene.gauge.indices(len(positions))
    if len(known) == len(positions):
        raise InputError("gauge leaves no microphone to be found", "remove one from gauge.known", key="gauge.known")
    blind = scene.room.dimension == 3 and not known  # solver "joint" needs no known microphone
    if not blind and not fixes_gauge(positions[list(known)]):
        key, value = ("gauge.known", known) if scene.gauge.free is None else ("gauge.free", scene.gauge.free)
        problem = f"{key} = {list(value)} does not fix translation, rotation and mirror image"
        raise InputError(problem, f"leave at least {MIN_KNOWN[positions.shape[1]]}", key=key)
    if scene.search is not None:
        low = np.array(scene.search.origin)
        high = low + scene.search.step * (np.array(scene.search.shape) - 1)
        beyond = np.any((positions < low - ROUNDING) | (positions > high + ROUNDING), axis=1)
        beyond[list(known)] = False  # a known microphone is never searched for
        if beyond.any():
            n = int(np.argmax(beyond))
            problem = f"microphone {n} at {point_text(positions[n])} lies outside the search domain"
            problem += f" {point_text(low)} to {point_text(high)} and could never be found"
            raise InputError(problem, "change search.origin or search.size", key="search.origin")
    return frozen_array(positions, float)


def geometry(array: Array, rng: np.random.Generator, cell: float = 0.0) -> np.ndarray:
    """Return the positions before they are snapped to cells : (N, 2) or (N, 3), metres."""
    center, count, radius = array.center or (0.0, 0.0), array.count or 0, array.radius or 0.0
    shape, size = array.shape or (), array.size or ()
    if array.geometry == "rectangle+random":
        return rectangle_plus_random(shape, size, array.random, cell, rng, center)
    if array.geometry == "circle":
        points = circle(count, radius)
    elif array.geometry in ("rectangle", "plane"):  # a "plane" in space lies at the height of its centre
        points = np.pad(rectangle(shape, size), ((0, 0), (0, len(center) - 2)))
    elif array.geometry == "ball":
        points = ball(count, radius, rng)
    elif array.geometry == "box":
        points = np.array(size) * (rng.random((count, 3)) - 0.5)
    else:
        points = np.array(array.positions, dtype=float)
    return points + center


CLEARANCE = 1e-6  # metres: microphones closer than this are at the same position


def _require_apart(positions: np.ndarray, remedy: str) -> None:
    """Raise InputError for two microphones at the same position."""
    _, first, inverse = np.unique(np.round(positions / CLEARANCE), axis=0, return_index=True, return_inverse=True)
    twins = np.flatnonzero(first[inverse.ravel()] != np.arange(len(positions)))
    if len(twins):
        both, where = f"{first[inverse.ravel()][twins[0]]} and {twins[0]}", point_text(positions[twins[0]])
        raise InputError(f"array puts microphones {both} at the same position, {where}", remedy, key="array")


def _require_clear(positions: np.ndarray, scene: Scene, inside: Callable[[np.ndarray], np.ndarray], key: str) -> None:
    """Raise InputError for a microphone outside the room, or a source outside the room or inside the array.

    `inside` returns which points are in the room; `key` is the key to change if a microphone is outside.
    """
    outside = np.flatnonzero(~inside(positions))
    if len(outside):
        problem = f"array puts microphone {outside[0]} at {point_text(positions[outside[0]])}, outside the room"
        raise InputError(f"{problem} or in a wall", f"change {key}, the array or the room", key=key)
    for name, place in zip(scene.emitter.keys, scene.emitter.places, strict=True):
        point = np.array([place]) if scene.room.cell is None else snap(np.array([place]), scene.room.cell)
        if not inside(point).all():
            raise InputError(f"{name} = {list(place)} m lies outside the room or in a wall", "move it inside", key=name)
        if hull_meets(positions, point):
            problem = f"{name} = {list(place)} m lies inside the array, where the field must have no source"
            raise InputError(problem, "move it outside the convex hull of the microphones", key=name)


def positions_3d(scene: Scene) -> np.ndarray:
    """Return the positions of a scene's microphones in space : (N, 3) float64, metres.

    Raises InputError for impossible positions.
    """
    positions = geometry(scene.array, np.random.default_rng([scene.seed, 0]))
    _require_apart(positions, "move one of them")
    if scene.room.response is None:
        size = np.array(scene.room.size)
        _require_clear(positions, scene, lambda x: np.all((x >= 0) & (x <= size), axis=1), "array.center")
    return positions


def hull_meets(points: np.ndarray, others: np.ndarray) -> bool:
    """Return whether the convex hulls of two sets of points (N, D) have a point in common.

    `others` may be a single point, or the two ends of a wall.
    """
    from scipy.optimize import linprog  # imported here: it loads in 1 s; a cached measurement does not need it

    points, others = np.asarray(points, float), np.asarray(others, float)
    # The hulls meet if both sets have weights, each with the sum 1, whose weighted means are equal.
    first = np.repeat([1.0, 0.0], [len(points), len(others)])
    equations = np.vstack([np.hstack([points.T, -others.T]), first, 1 - first])
    target = np.append(np.zeros(points.shape[1]), [1.0, 1.0])
    return linprog(np.zeros(equations.shape[1]), A_eq=equations, b_eq=target).status == 0


ROUNDING = 1e-9  # metres: a smaller difference of coordinates is due to rounding


def in_polygon(points: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Return which points lie inside a polygon, by the even-odd rule : (...) bool.

    points : (..., 2), metres; vertices : (V, 2), metres, in order. A point on an edge may count as inside or outside.
    """
    x, y = np.moveaxis(np.asarray(points, dtype=float), -1, 0)
    crossings = np.zeros(x.shape, dtype=bool)
    for (xa, ya), (xb, yb) in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
        if ya != yb:  # a horizontal edge is never crossed by the horizontal ray
            spans = (ya > y) != (yb > y)
            crossings ^= spans & (x < xa + (y - ya) * (xb - xa) / (yb - ya))
    return crossings


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

    Unlike the other geometries this one needs its `center`, since the free cells depend on it.
    """
    regular = np.floor((rectangle(shape, size) + center) / cell + ROUNDING)  # indices of cells
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
    return (np.floor(np.asarray(points, dtype=float) / cell + ROUNDING) + 0.5) * cell


def ball(count: int, radius: float, rng: np.random.Generator) -> np.ndarray:
    """Return `count` random points in a ball, uniform in its volume : (count, 3) float64, metres."""
    directions = rng.standard_normal((count, 3))
    return directions * (radius * rng.random(count) ** (1 / 3) / np.linalg.norm(directions, axis=1))[:, None]


WALL_DISTANCE_M = 0.1  # least distance of a source from every wall: half the depth of a small loudspeaker
DRAWS = 500  # number of random positions after which the room counts as too small


def random_source(
    size: Any, microphones: Reals, clearance: float, rng: np.random.Generator, allowed: Callable[[Reals], bool]
) -> Reals | None:
    """Return a random position of a source in a room of lengths `size`, rounded to a millimetre; None if none is found.

    It is at least `clearance` away from all microphones (N, 2 or 3), horizontally if these have no heights, and
    `allowed` returns true for it.
    """
    lengths = np.asarray(size, float)
    for _ in range(DRAWS):
        position = np.round(WALL_DISTANCE_M + rng.random(len(lengths)) * (lengths - 2 * WALL_DISTANCE_M), 3)
        away = np.linalg.norm(microphones - position[: microphones.shape[1]], axis=1).min()
        if away > clearance and allowed(position):
            return position
    return None
