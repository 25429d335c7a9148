"""Points, polygons and convex hulls in the plane. Coordinates are metres."""

from __future__ import annotations

import numpy as np

ROUNDING = 1e-9  # of a coordinate, metres, and of an angle, radians: differences this small are none


def in_polygon(points: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Return which points lie inside a polygon, by the even-odd rule.

    `points` (..., 2) float64, metres; `vertices` (V, 2) float64, corners in order, metres; the last joins the first.
    Returns (...) bool, a point on the outline itself may fall on either side.
    """
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
