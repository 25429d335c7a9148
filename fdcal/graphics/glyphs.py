"""Markers, walls and rulers as plain arrays of triangles and line segments.

Segments are (S, 2, 3) float64, metres: S pieces from [:, 0] to [:, 1]. Markers are flat and parallel to the floor.
"""

from __future__ import annotations

import numpy as np
from matplotlib.ticker import MaxNLocator


def lift(points, z: float) -> np.ndarray:
    """Points of the plane at height `z`, raised above their own height where they have one : (P, 3), metres."""
    points = np.atleast_2d(np.asarray(points, float))
    heights = points[:, 2] if points.shape[1] == 3 else np.zeros(len(points))
    return np.column_stack([points[:, :2], heights + z])


def annuli(centres: np.ndarray, radius: float, width: float, corners: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """A flat ring about each of the (P, 3) `centres` : (2 corners P, 3) vertices, metres, and int triangles.

    The middle of its `width` lies at `radius`. The vertices of one ring follow one another, inside and outside in turn.
    """
    angles = np.repeat(2 * np.pi * np.arange(corners) / corners, 2)
    reach = np.tile([radius - width / 2, radius + width / 2], corners)
    circle = np.stack([reach * np.cos(angles), reach * np.sin(angles), 0 * angles], axis=1)
    inner = 2 * np.arange(corners)
    further = (inner + 2) % (2 * corners)
    faces = np.stack([inner, inner + 1, further + 1, inner, further + 1, further], axis=1).reshape(-1, 3)
    return _each(centres, circle, faces)


def strokes(segments: np.ndarray, width: float, longer: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Flat bars along segments (S, 2, 3) : (4 S, 3) vertices, metres, and (2 S, 3) int triangles.

    Each is `width` wide, horizontally, and extends by `longer` beyond both ends.
    """
    along = _unit(segments[:, 1] - segments[:, 0])
    level = _unit(along * [1.0, 1.0, 0.0])
    side = width / 2 * np.stack([-level[:, 1], level[:, 0], 0 * level[:, 0]], axis=1)
    start, end = segments[:, 0] - longer * along, segments[:, 1] + longer * along
    vertices = np.stack([start - side, end - side, end + side, start + side], axis=1)
    return vertices.reshape(-1, 3), _quads(len(segments))


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (S, 3) at length 1; that of none points along x."""
    length = np.linalg.norm(vectors, axis=1)[:, None]
    return np.divide(vectors, length, out=np.tile([1.0, 0.0, 0.0], (len(vectors), 1)), where=length > 0)


def stars(centres: np.ndarray, radius: float, arms: int = 2, turn: float = np.pi / 4) -> np.ndarray:
    """`arms` strokes through each of the (P, 3) `centres`; two of them, turned by 45 degrees, are a cross."""
    angles = turn + np.pi * np.arange(arms) / arms
    arm = radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    return (centres[:, None, None, :] + np.stack([-arm, arm], axis=1)).reshape(-1, 2, 3)


def polygons(centres: np.ndarray, radius: float, corners: int) -> np.ndarray:
    """The sides of a regular polygon about each of the (P, 3) `centres`, one side level below : (corners P, 2, 3)."""
    angles = -np.pi / 2 + np.pi / corners + 2 * np.pi * np.arange(corners) / corners
    rim = radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    sides = np.stack([rim, np.roll(rim, -1, axis=0)], axis=1)
    return (centres[:, None, None, :] + sides).reshape(-1, 2, 3)


def squares(centres: np.ndarray, edge: float) -> tuple[np.ndarray, np.ndarray]:
    """A filled square about each of the (P, 3) `centres` : (4 P, 3) vertices, metres, and (2 P, 3) int triangles."""
    corner = edge / 2 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return _each(centres, corner, _quads(1))


def _each(centres: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One shape repeated about every centre."""
    first = len(vertices) * np.arange(len(centres))[:, None, None]
    return (centres[:, None, :] + vertices).reshape(-1, 3), (first + faces).reshape(-1, 3)


def _quads(count: int) -> np.ndarray:
    return (4 * np.arange(count)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)


def loop(vertices, z: float) -> np.ndarray:
    """Closed line through (V, 2) `vertices` at height `z`, metres."""
    vertices = lift(vertices, z)
    return np.stack([vertices, np.roll(vertices, -1, axis=0)], axis=1)


def stems(points: np.ndarray, z: float) -> np.ndarray:
    """Vertical segments from the (P, 3) `points` down, or up, to height `z` : (P, 2, 3), metres."""
    feet = np.array(points, float)
    feet[:, 2] = z
    return np.stack([points, feet], axis=1)


def walls(vertices, height: float) -> tuple[np.ndarray, np.ndarray]:
    """The outline (V, 2), metres, extruded upwards, two triangles a wall: (2 V, 3), metres, and (2 V, 3) int."""
    count = len(vertices)
    here, there = np.arange(count), np.roll(np.arange(count), -1)
    faces = np.concatenate(
        [np.stack([here, there, there + count], axis=1), np.stack([here, there + count, here + count], axis=1)]
    )
    return np.concatenate([lift(vertices, 0.0), lift(vertices, height)]), faces


def floor_grid(vertices, spacing: float, z: float) -> np.ndarray:
    """Lines every `spacing` metres, clipped to the outline (V, 2); a line that meets a corner is clipped too."""
    vertices = np.asarray(vertices, float)
    pieces = []
    for axis in (0, 1):
        low, high = vertices[:, axis].min(), vertices[:, axis].max()
        for level in np.arange(np.floor(low / spacing) + 1, np.ceil(high / spacing)) * spacing:
            for start, end in _inside(vertices, axis, level):
                ends = np.full((2, 3), z)
                ends[:, axis], ends[:, 1 - axis] = level, (start, end)
                pieces.append(ends)
    return np.array(pieces).reshape(-1, 2, 3)


def _inside(vertices: np.ndarray, axis: int, level: float) -> list[tuple[float, float]]:
    """Stretches of the line `coordinate[axis] = level` inside the outline."""
    a, b = vertices, np.roll(vertices, -1, axis=0)
    crossing = (a[:, axis] > level) != (b[:, axis] > level)
    a, b = a[crossing], b[crossing]
    share = (level - a[:, axis]) / (b[:, axis] - a[:, axis])
    met = np.sort(a[:, 1 - axis] + share * (b[:, 1 - axis] - a[:, 1 - axis]))
    return list(zip(met[::2], met[1::2], strict=True))


def round_ticks(low: float, high: float, count: int) -> np.ndarray:
    """About `count` round numbers from `low` to `high`."""
    values = MaxNLocator(nbins=count, steps=[1, 2, 5, 10]).tick_values(low, high)
    slack = 1e-9 * (high - low)
    return values[(values >= low - slack) & (values <= high + slack)]


def ruler(low: float, high: float, across: float, axis: int, length: float, z: float):
    """Ticks along an edge of a box: their segments (T, 2, 3), label positions (T, 3) and texts ("1.2")."""
    values = round_ticks(low, high, 8)
    ends = np.full((len(values), 2, 3), z)
    ends[:, :, axis] = values[:, None]
    ends[:, 0, 1 - axis], ends[:, 1, 1 - axis] = across, across - length
    places = ends[:, 1].copy()
    places[:, 1 - axis] -= 0.6 * length
    decimals = max(0, -int(np.floor(np.log10(values[1] - values[0])))) if len(values) > 1 else 2
    return ends, places, tuple(f"{value:.{decimals}f}" for value in values)
