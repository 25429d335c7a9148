"""Markers, walls and rulers as plain arrays of line segments and triangles.

Segments are (S, 2, 3) float64, metres: S pieces from [:, 0] to [:, 1].
"""

from __future__ import annotations

import numpy as np
import trimesh
from matplotlib.ticker import MaxNLocator


def lift(points, z: float) -> np.ndarray:
    """Points of the plane at height `z`, raised above their own height where they have one : (P, 3), metres."""
    points = np.atleast_2d(np.asarray(points, float))
    heights = points[:, 2] if points.shape[1] == 3 else np.zeros(len(points))
    return np.column_stack([points[:, :2], heights + z])


def rings(centres: np.ndarray, radius: float, corners: int = 28) -> np.ndarray:
    """A circle of `corners` segments about each of the (P, 3) `centres`, parallel to the floor."""
    angles = 2 * np.pi * np.arange(corners + 1) / corners
    circle = radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    pieces = np.stack([circle[:-1], circle[1:]], axis=1)
    return (centres[:, None, None, :] + pieces).reshape(-1, 2, 3)


def stars(centres: np.ndarray, radius: float, arms: int = 2, turn: float = np.pi / 4) -> np.ndarray:
    """`arms` strokes through each of the (P, 3) `centres`; two of them, turned by 45 degrees, are a cross."""
    angles = turn + np.pi * np.arange(arms) / arms
    arm = radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    return (centres[:, None, None, :] + np.stack([-arm, arm], axis=1)).reshape(-1, 2, 3)


def squares(centres: np.ndarray, edge: float) -> tuple[np.ndarray, np.ndarray]:
    """A filled square about each of the (P, 3) `centres` : (4 P, 3) corners, metres, and (2 P, 3) int triangles."""
    corner = edge / 2 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    first = 4 * np.arange(len(centres))[:, None, None]
    triangles = first + np.array([[0, 1, 2], [0, 2, 3]])
    return (centres[:, None, :] + corner).reshape(-1, 3), triangles.reshape(-1, 3)


def loop(vertices, z: float) -> np.ndarray:
    """Closed line through (V, 2) `vertices` at height `z`, metres."""
    vertices = lift(vertices, z)
    return np.stack([vertices, np.roll(vertices, -1, axis=0)], axis=1)


def walls(vertices, height: float) -> trimesh.Trimesh:
    """The outline (V, 2), metres, extruded upwards: two triangles a wall, neither floor nor ceiling."""
    count = len(vertices)
    here, there = np.arange(count), np.roll(np.arange(count), -1)
    faces = np.concatenate(
        [np.stack([here, there, there + count], axis=1), np.stack([here, there + count, here + count], axis=1)]
    )
    points = np.concatenate([lift(vertices, 0.0), lift(vertices, height)])
    return trimesh.Trimesh(vertices=points, faces=faces, process=False)


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


def round_values(low: float, high: float, count: int) -> np.ndarray:
    """About `count` round numbers from `low` to `high`."""
    values = MaxNLocator(nbins=count, steps=[1, 2, 5, 10]).tick_values(low, high)
    slack = 1e-9 * (high - low)
    return values[(values >= low - slack) & (values <= high + slack)]


def ruler(low: float, high: float, across: float, axis: int, length: float, z: float):
    """Ticks along an edge of a box: their segments (T, 2, 3), label positions (T, 3) and texts ("1.2")."""
    values = round_values(low, high, 8)
    ends = np.full((len(values), 2, 3), z)
    ends[:, :, axis] = values[:, None]
    ends[:, 0, 1 - axis], ends[:, 1, 1 - axis] = across, across - length
    places = ends[:, 1].copy()
    places[:, 1 - axis] -= 0.6 * length
    decimals = max(0, -int(np.floor(np.log10(values[1] - values[0])))) if len(values) > 1 else 2
    return ends, places, tuple(f"{value:.{decimals}f}" for value in values)
