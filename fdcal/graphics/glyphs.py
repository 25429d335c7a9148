"""Shapes of markers, walls and rulers as plain arrays of triangles and line segments.

Segments are (S, 2, 3) float64, metres: S pieces from [:, 0] to [:, 1]. Triangles are a pair: vertices (V, 3) float64,
metres, and faces (F, 3) int, indices of vertices. Markers are flat and parallel to the floor.
"""

import numpy as np
from matplotlib.ticker import MaxNLocator

Triangles = tuple[np.ndarray, np.ndarray]


def lift(points, z: float) -> np.ndarray:
    """Return points (P, 2) or (P, 3) raised by `z` : (P, 3), metres; points of a plane are at height 0."""
    points = np.atleast_2d(np.asarray(points, float))
    return np.column_stack([points[:, :2], z + (points[:, 2] if points.shape[1] == 3 else np.zeros(len(points)))])


def annuli(centres: np.ndarray, radius: float, width: float, corners: int = 40) -> Triangles:
    """Return a flat ring around each centre (P, 3), with `corners` inner and `corners` outer vertices in turn."""
    angles = np.repeat(2 * np.pi * np.arange(corners) / corners, 2)
    reach = np.tile([radius - width / 2, radius + width / 2], corners)
    circle = np.stack([reach * np.cos(angles), reach * np.sin(angles), 0 * angles], axis=1)
    inner = 2 * np.arange(corners)
    following = (inner + 2) % (2 * corners)
    faces = np.stack([inner, inner + 1, following + 1, inner, following + 1, following], axis=1).reshape(-1, 3)
    return (centres[:, None, :] + circle).reshape(-1, 3), _copies(faces, 2 * corners, len(centres))


def strokes(segments: np.ndarray, width: float, extension: float = 0.0) -> Triangles:
    """Return a flat bar along each segment (S, 2, 3), four vertices each, `extension` metres longer at each end."""
    along = _unit(segments[:, 1] - segments[:, 0])
    across = _unit(along * [1.0, 1.0, 0.0])
    side = width / 2 * np.stack([-across[:, 1], across[:, 0], 0 * across[:, 0]], axis=1)
    start, end = segments[:, 0] - extension * along, segments[:, 1] + extension * along
    vertices = np.stack([start - side, end - side, end + side, start + side], axis=1)
    return vertices.reshape(-1, 3), _copies(QUAD, 4, len(segments))


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (S, 3) scaled to length 1; those of length 0 point along x."""
    length = np.linalg.norm(vectors, axis=1)[:, None]
    return np.divide(vectors, length, out=np.tile([1.0, 0.0, 0.0], (len(vectors), 1)), where=length > 0)


def squares(centres: np.ndarray, edge: float) -> Triangles:
    """Return a filled square of side `edge`, metres, around each of the (P, 3) `centres`, four vertices each."""
    square = edge / 2 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return (centres[:, None, :] + square).reshape(-1, 3), _copies(QUAD, 4, len(centres))


QUAD = np.array([[0, 1, 2], [0, 2, 3]])  # faces of a quadrilateral


def _copies(faces: np.ndarray, corners: int, count: int) -> np.ndarray:
    """Return the faces of `count` copies of a shape that has `corners` vertices."""
    return (corners * np.arange(count)[:, None, None] + faces).reshape(-1, 3)


def loop(vertices, z: float) -> np.ndarray:
    """Return the closed line (V, 2, 3) through `vertices` (V, 2) or (V, 3), raised by `z`, metres."""
    vertices = lift(vertices, z)
    return np.stack([vertices, np.roll(vertices, -1, axis=0)], axis=1)


def stems(points: np.ndarray, z: float) -> np.ndarray:
    """Return vertical segments (P, 2, 3) from the (P, 3) `points` down, or up, to height `z`, metres."""
    feet = np.array(points, float)
    feet[:, 2] = z
    return np.stack([points, feet], axis=1)


def walls(vertices, height: float) -> Triangles:
    """Return the outline (V, 2), metres, extruded upwards to `height`, metres, two triangles for each wall."""
    around = np.concatenate([vertices, vertices[:1]])
    return np.concatenate([lift(around, 0.0), lift(around, height)]), grid_faces(2, len(around))


def grid_faces(rows: int, columns: int) -> np.ndarray:
    """Return the faces of a surface through a grid of points, row by row: two triangles in each cell."""
    corner = (columns * np.arange(rows - 1)[:, None] + np.arange(columns - 1)).ravel()[:, None]
    return np.concatenate([corner + [0, 1, columns + 1], corner + [0, columns + 1, columns]])


def floor_grid(vertices, spacing: float, z: float) -> np.ndarray:
    """Return grid lines (S, 2, 3) at height `z` clipped to an outline (V, 2), metres."""
    vertices = np.asarray(vertices, float)
    following, pieces = np.roll(vertices, -1, axis=0), []
    for axis in (0, 1):
        low, high = vertices[:, axis].min(), vertices[:, axis].max()
        for level in np.arange(np.floor(low / spacing) + 1, np.ceil(high / spacing)) * spacing:
            crossing = (vertices[:, axis] > level) != (following[:, axis] > level)
            a, b = vertices[crossing], following[crossing]
            fraction = (level - a[:, axis]) / (b[:, axis] - a[:, axis])
            crossings = np.sort(a[:, 1 - axis] + fraction * (b[:, 1 - axis] - a[:, 1 - axis]))
            ends = np.full((len(crossings) // 2, 2, 3), z)  # a line is inside between crossings 0 and 1, 2 and 3, ...
            ends[..., axis], ends[..., 1 - axis] = level, crossings.reshape(-1, 2)
            pieces.append(ends)
    return np.concatenate(pieces) if pieces else np.zeros((0, 2, 3))


def round_ticks(low: float, high: float, count: int) -> np.ndarray:
    """Return about `count` round numbers from `low` to `high`, ascending."""
    values = np.asarray(MaxNLocator(nbins=count, steps=[1, 2, 5, 10]).tick_values(low, high))
    slack = 1e-9 * (high - low)
    return values[(values >= low - slack) & (values <= high + slack)]


def tick_texts(values: np.ndarray) -> tuple[str, ...]:
    """Return evenly spaced numbers with the fewest decimals that distinguish them, such as "1.2"."""
    decimals = max(0, -int(np.floor(np.log10(values[1] - values[0])))) if len(values) > 1 else 2
    return tuple(f"{value:z.{decimals}f}" for value in values)
