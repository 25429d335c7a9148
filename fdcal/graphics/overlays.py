"""What can be drawn over a picture: the paths of the estimates, error ellipses, the estimates of compared solvers.

Each function takes a picture of `fdcal.graphics.picture` and returns it with more in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from . import glyphs
from .markers import ELLIPSE, ODD, TRAIL, Layer, drape, lines, on_layer, solver_mark, strokes
from .primitives import Floor, Picture

ELLIPSE_SIDES = 36  # of the polygon that is drawn for an ellipse
ODD_RADIUS, ODD_SIDES = 2.4, 24  # of the circle around an odd channel, radii of a marker


def with_trails(picture: Picture, paths, floor: Floor | None = None) -> Picture:
    """Return the picture with the path of each estimate; a microphone that does not move has none.

    Parameters
    ----------
    paths : (T, N, D) float64, metres, oldest first
    floor : a map in relief, on which the paths lie, or None
    """
    paths = np.asarray(paths, float)
    if len(paths) < 2:
        return picture
    draped = drape(paths.reshape(-1, paths.shape[2]), floor)
    points = on_layer(draped, picture.z_range[0], picture.marker_radius, Layer.TRAIL).reshape(*paths.shape[:2], 3)
    pieces = np.stack([points[:-1], points[1:]], axis=2).reshape(-1, 2, 3)
    pieces = pieces[np.abs(pieces[:, 1] - pieces[:, 0]).max(axis=1) > 1e-9]
    if not len(pieces):
        return picture
    return replace(picture, lines=(*picture.lines, lines("trails", pieces, TRAIL, 2.0)))


def with_ellipses(picture: Picture, positions, axes, floor: Floor | None = None) -> Picture:
    """Return the picture with an error ellipse around each microphone, none where it is no larger than a dot.

    Parameters
    ----------
    positions : (N, D) float64, metres
    axes : (N, D, D) float64, metres, half axes in rows, the longest last; the largest section of an ellipsoid is drawn
    floor : a map in relief, on which the microphones stand, or None
    """
    axes, positions = np.asarray(axes, float), np.asarray(positions, float)
    long, middle = axes[:, -1], axes[:, -2]
    seen = np.flatnonzero(np.linalg.norm(long, axis=1) > 1e-6)
    if not len(seen):
        return picture
    centres = on_layer(drape(positions[seen], floor), picture.z_range[0], picture.marker_radius, Layer.ELLIPSE)
    pad = ((0, 0), (0, 3 - axes.shape[2]))
    long, middle = np.pad(long[seen], pad), np.pad(middle[seen], pad)
    angles = np.linspace(0, 2 * np.pi, ELLIPSE_SIDES + 1)
    rim = np.cos(angles)[:, None, None] * long + np.sin(angles)[:, None, None] * middle + centres
    pieces = np.stack([rim[:-1], rim[1:]], axis=2).reshape(-1, 2, 3)
    return replace(picture, lines=(*picture.lines, lines("ellipses", pieces, ELLIPSE, 2.5)))


def with_odd_channels(picture: Picture, positions, odd, floor: Floor | None = None) -> Picture:
    """Return the picture with a barred circle around each microphone whose channel, or given position, is odd.

    Parameters
    ----------
    positions : (N, D) float64, metres
    odd : sequence of int, numbers of the microphones
    floor : a map in relief, on which the microphones stand, or None
    """
    if not len(odd):
        return picture
    radius = picture.marker_radius
    places = drape(np.asarray(positions, float)[list(odd)], floor)
    centres = on_layer(places, picture.z_range[0], radius, Layer.ODD)
    reach = ODD_RADIUS * radius * np.sqrt(0.5) * np.array([1.0, -1.0, 0.0])
    bars = np.stack([centres - reach, centres + reach], axis=1)
    segments = np.concatenate([glyphs.polygons(centres, ODD_RADIUS * radius, ODD_SIDES), bars])
    return replace(picture, meshes=picture.meshes + strokes("microphones/odd", segments, radius, ODD, 0.34))


def with_comparison(
    picture: Picture, positions: Mapping[str, np.ndarray], free: np.ndarray, floor: Floor | None = None
) -> Picture:
    """Return the picture with a mark at each position that the solvers of a comparison have estimated.

    Parameters
    ----------
    positions : by the name of the solver: (N, D) float64, metres
    free : (F,) numbers of the microphones to be marked
    floor : a map in relief, on which the microphones stand, or None
    """
    radius, base, meshes = picture.marker_radius, picture.z_range[0], picture.meshes
    for i, (name, estimate) in enumerate(positions.items()):
        mark = solver_mark(name)
        centres = on_layer(drape(np.asarray(estimate)[free], floor), base, radius, Layer.COMPARISON + 2 * i)
        if mark.corners:
            segments = glyphs.polygons(centres, mark.radius * radius, mark.corners)
        else:
            segments = glyphs.stars(centres, mark.radius * radius, turn=0.0)
        meshes += strokes(f"comparison/{name.replace('+', '_')}", segments, radius, mark.rgb, 0.3, halo=0.14)
    return replace(picture, meshes=meshes)
