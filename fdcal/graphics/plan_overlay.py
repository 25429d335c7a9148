"""A planned array over a picture: its microphones, and the ellipses or ellipsoids of the least error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .markers import ELLIPSE, Layer, lines, on_layer
from .overlays import ELLIPSE_SIDES, NO_ELLIPSE, ellipse_scale
from .primitives import Picture

BOUND_TEXT = "least error (95 %)"  # in the legend
SECTIONS = ((-1, -2), (-1, 0), (-2, 0))  # pairs of half axes: the principal sections of an ellipsoid


def with_bound(picture: Picture, positions, axes) -> Picture:
    """Return the picture with the least error of each microphone: an ellipse, in space the sections of an ellipsoid.

    The legend says by how much they are enlarged.

    `picture`: from `fdcal.graphics.picture.static_picture` of the planned array; `positions` (N, D) float64, metres;
    `axes` (N, D, D) float64, metres, half axes in rows, the longest last; zeros of a microphone that is given.
    """
    axes, positions = np.asarray(axes, float), np.asarray(positions, float)
    captions = (*picture.captions, ("microphones/true", "planned microphone"))
    picture = replace(picture, captions=captions)
    seen = np.flatnonzero(np.linalg.norm(axes[:, -1], axis=1) > NO_ELLIPSE)
    if not len(seen):
        return picture
    x0, y0, x1, y1 = picture.focus
    scale = ellipse_scale(axes, max(x1 - x0, y1 - y0))
    D = axes.shape[2]
    half = np.pad(scale * axes[seen], ((0, 0), (0, 0), (0, 3 - D)))
    centres = on_layer(positions[seen], picture.z_range[0], picture.marker_radius, Layer.ELLIPSE)
    angles = np.linspace(0, 2 * np.pi, ELLIPSE_SIDES + 1)[:, None, None]
    pieces = []
    for a, b in SECTIONS[: 1 if D == 2 else 3]:
        rim = np.cos(angles) * half[:, a] + np.sin(angles) * half[:, b] + centres
        pieces.append(np.stack([rim[:-1], rim[1:]], axis=2).reshape(-1, 2, 3))
    text = BOUND_TEXT + (f", drawn {scale:g} times larger" if scale > 1 else "")
    drawn = lines("ellipses", np.concatenate(pieces), ELLIPSE, 2.0)
    return replace(picture, lines=(*picture.lines, drawn), captions=(*captions, ("ellipses", text)))
