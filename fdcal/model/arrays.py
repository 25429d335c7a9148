"""Where the microphones stand: array geometries, snapped to the cells of the simulation.

A simulated microphone records one FDTD cell. Cell i spans i h to (i + 1) h along an axis, counted from the
origin of the room's coordinates, so its centre is (i + 0.5) h; the snapped position is the truth. Arrays in a room of
three dimensions, which has no cells, are of `fdcal.model.arrays_3d`.

    positions_of    the array of a scene, with every check a scene needs
    circle, rectangle, rectangle_plus_random    the pure geometries, before the checks
    snap, inside, encloses    cell centres, point in polygon, point in convex hull
    hull, crosses    corners of the convex hull, and whether a wall crosses it
"""

from __future__ import annotations

import numpy as np

from .array_layout import Array
from .arrays_3d import positions_3d
from .gauge import fixes_gauge
from .scene import Scene
from .validation import InputError, frozen_array

REMEDY = {
    2: "three microphones known that are not on one line",
    3: "four microphones known that are not in one plane",
}
ROUNDING = 1e-9  # of a cell: decides on which side of a cell edge a coordinate falls in spite of float rounding


def positions_of(scene: Scene) -> np.ndarray:
    """Positions of a scene's microphones.

    Returns
    -------
    (N, D) float64 array, read-only, metres; on cell centres, or in a room of three dimensions where they are. D is 2 in
    a plane, whose height is left out then.

    Raises
    ------
    InputError
        Two microphones in one cell or place, one outside the room or the search domain, the source outside the room or
        inside the array, a wall between microphones, known microphones that do not fix translation, rotation and
        mirror.
    """
    positions = positions_3d(scene)[:, : scene.array.dimension] if scene.room.dimension == 3 else _on_cells(scene)
    _check_gauge(positions, scene)
    if scene.search is not None:
        _check_search(positions, scene)
    return frozen_array(positions, float)


def _on_cells(scene: Scene) -> np.ndarray:
    """(N, 2) metres, on cell centres, in a room that is simulated."""
    rng = np.random.default_rng([scene.seed, 0])
    positions = snap(_geometry(scene.array, scene.room.cell, rng), scene.room.cell)
    _check_apart(positions, scene)
    _check_in_room(positions, scene)
    _check_walls(positions, scene)
    _check_source(positions, scene)
    return positions


def circle(count: int, radius: float) -> np.ndarray:
    """`count` points evenly spaced on a circle round the origin : (count, 2) float64, metres."""
    angles = 2 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def rectangle(shape: tuple[int, ...], size: tuple[float, ...]) -> np.ndarray:
    """Regular lattice of outer lengths `size` round the origin : (nx * ny, 2) float64, metres, x fastest.

    An axis with a single point has it at 0.
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
    """A rectangle and `extra` points drawn without replacement from the free cells inside it.

    The lattice comes first. Unlike the other geometries this one knows its `center`: which cells are free
    depends on it.

    Returns
    -------
    (nx * ny + extra, 2) float64 array, metres, on cell centres

    Raises
    ------
    InputError
        Fewer free cells than `extra`.
    """
    regular = _cells(rectangle(shape, size) + center, cell)
    low, high = regular.min(axis=0), regular.max(axis=0)
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    taken = {tuple(index) for index in regular.tolist()}
    free = [index for index in zip(x.ravel().tolist(), y.ravel().tolist(), strict=True) if index not in taken]
    if extra > len(free):
        raise InputError(
            f"array.random = {extra} is more than the {len(free)} free cells of room.cell = {cell:g} m inside"
            f" array.size = {list(size)} m; use at most {len(free)}"
        )
    drawn = np.array(free)[rng.choice(len(free), extra, replace=False)]
    return (np.concatenate([regular, drawn]) + 0.5) * cell


def snap(points: np.ndarray, cell: float) -> np.ndarray:
    """Centres of the cells that hold `points` : (..., 2) float64, metres."""
    return (_cells(points, cell) + 0.5) * cell


def in_polygon(points: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Which points lie inside a polygon, by the even-odd rule.

    Parameters
    ----------
    points : (..., 2) array, metres
    vertices : (V, 2) array, metres, corners in order; the last joins the first

    Returns
    -------
    (...) bool array; a point on the outline itself may fall on either side
    """
    x, y = np.moveaxis(np.asarray(points, dtype=float), -1, 0)
    crossings = np.zeros(x.shape, dtype=bool)
    for (xa, ya), (xb, yb) in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
        if ya != yb:  # a horizontal edge is never crossed by the horizontal ray
            spans = (ya > y) != (yb > y)
            crossings ^= spans & (x < xa + (y - ya) * (xb - xa) / (yb - ya))
    return crossings


def encloses(points: np.ndarray, point: np.ndarray) -> bool:
    """Whether the convex hull of `points` (N, 2) holds `point` (2,), its edge included.

    Seen from inside, the points leave no gap of more than half a turn. Holds for points on one line, too.
    """
    seen = np.asarray(points, dtype=float) - point
    if np.any(np.all(np.abs(seen) < ROUNDING, axis=1)):
        return True
    angles = np.sort(np.arctan2(seen[:, 1], seen[:, 0]))
    gaps = np.diff(angles, append=angles[0] + 2 * np.pi)
    return bool(gaps.max() <= np.pi + ROUNDING)


def convex_hull(points: np.ndarray) -> np.ndarray:
    """Corners of the convex hull of `points` (N, 2), anticlockwise : (H, 2) float64; the two ends of points on a line.

    Monotone chain: the points from left to right, and of each side only those where it turns left.
    """
    ordered = np.unique(np.asarray(points, dtype=float), axis=0)
    sides = []
    for row in (ordered, ordered[::-1]):
        side: list[np.ndarray] = []
        for point in row:
            while len(side) > 1 and _turn(side[-2], side[-1], point) <= ROUNDING**2:
                side.pop()
            side.append(point)
        sides += side[:-1]
    return np.array(sides) if sides else ordered


def crosses_polygon(a: np.ndarray, b: np.ndarray, corners: np.ndarray) -> bool:
    """Whether the wall from `a` to `b` enters the convex polygon of `corners` (H, 2), or touches it."""
    if encloses(corners, a) or encloses(corners, b):
        return True
    for c, d in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        ends, sides = (_turn(a, b, c), _turn(a, b, d)), (_turn(c, d, a), _turn(c, d, b))
        if np.prod(np.sign(ends)) <= 0 and np.prod(np.sign(sides)) <= 0 and any(ends):
            return True
    return False


def _turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """Above zero where the way from `a` by `b` to `c` turns left: twice the triangle's area, m^2."""
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _cells(points: np.ndarray, cell: float) -> np.ndarray:
    """Indices of the cells that hold `points` : (..., 2) int64."""
    return np.floor(np.asarray(points, dtype=float) / cell + ROUNDING).astype(np.int64)


def _geometry(array: Array, cell: float, rng: np.random.Generator) -> np.ndarray:
    """(N, 2) metres, not yet snapped."""
    if array.geometry == "circle":
        return circle(array.count, array.radius) + array.center
    if array.geometry == "rectangle":
        return rectangle(array.shape, array.size) + array.center
    if array.geometry == "rectangle+random":
        return rectangle_plus_random(array.shape, array.size, array.random, cell, rng, array.center)
    return np.array(array.positions, dtype=float) + array.center


def _text(point: np.ndarray) -> str:
    return f"({', '.join(f'{coordinate:.4g}' for coordinate in point)}) m"


def _check_apart(positions: np.ndarray, scene: Scene) -> None:
    _, first, inverse = np.unique(positions, axis=0, return_index=True, return_inverse=True)
    twins = np.flatnonzero(first[inverse.ravel()] != np.arange(len(positions)))
    if len(twins):
        raise InputError(
            f"array puts microphones {first[inverse.ravel()][twins[0]]} and {twins[0]} in one cell at"
            f" {_text(positions[twins[0]])}; use fewer microphones, a larger array or a room.cell below"
            f" {scene.room.cell:g} m"
        )


def _check_in_room(positions: np.ndarray, scene: Scene) -> None:
    outside = np.flatnonzero(~in_polygon(positions, scene.room.vertices))
    if len(outside):
        key = "positions" if scene.array.geometry == "positions" else "center"
        raise InputError(
            f"array puts microphone {outside[0]} at {_text(positions[outside[0]])}, outside the room or in a wall;"
            f" change array.{key} or the room"
        )


def _check_walls(positions: np.ndarray, scene: Scene) -> None:
    corners = convex_hull(positions)
    vertices = scene.room.vertices
    for a, b in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
        if crosses_polygon(a, b, corners):
            key = "room.size" if scene.room.size else "room.outline"
            raise InputError(
                f"{key} has a wall from {_text(a)} to {_text(b)} between the microphones, where nothing may obstruct"
                " the sound; move the array (array.center) so that their convex hull is free of walls"
            )


def _check_source(positions: np.ndarray, scene: Scene) -> None:
    source = snap(np.array(scene.source.position), scene.room.cell)
    if not in_polygon(source, scene.room.vertices):
        raise InputError(
            f"source.position = {list(scene.source.position)} m lies outside the room or in a wall;"
            " move it inside the room"
        )
    if encloses(positions, source):
        raise InputError(
            f"source.position = {list(scene.source.position)} m lies inside the array, where the field must have no"
            " source; move it outside the convex hull of the microphones"
        )


def _check_gauge(positions: np.ndarray, scene: Scene) -> None:
    known = scene.gauge.indices(len(positions))
    if len(known) == len(positions):
        raise InputError("gauge leaves no microphone to be found; take at least one out of gauge.known")
    if scene.room.dimension == 3 and not known:  # all at once needs none
        return
    if not fixes_gauge(positions[list(known)]):
        key, value = ("known", known) if scene.gauge.free is None else ("free", scene.gauge.free)
        raise InputError(
            f"gauge.{key} = {list(value)} does not fix translation, rotation and mirror;"
            f" leave at least {REMEDY[positions.shape[1]]}"
        )


def _check_search(positions: np.ndarray, scene: Scene) -> None:
    low = np.array(scene.search.origin)
    high = low + scene.search.step * (np.array(scene.search.shape) - 1)
    known = scene.gauge.indices(len(positions))
    beyond = np.any((positions < low - ROUNDING) | (positions > high + ROUNDING), axis=1)
    beyond[list(known)] = False  # a known microphone is never searched for
    if beyond.any():
        n = int(np.argmax(beyond))
        raise InputError(
            f"microphone {n} at {_text(positions[n])} lies outside the search domain {_text(low)} to {_text(high)}"
            " and could never be found; change search.origin or search.size"
        )
