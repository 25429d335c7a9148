"""The shadow of a map in relief on the ground, as an image with opacities.

No renderer computes it, so that it costs a browser without a graphics card one small image. Lengths are metres.
"""

import numpy as np

from ..model.validation import frozen_array
from .heatmap import TOWARDS_LIGHT, relief_grid
from .primitives import Floor, Plate

PIXELS = 96  # along the longer edge of the image
MARGIN = 0.32  # around the box, of its longer edge
LENGTH = 0.55  # of the shadow, of that by the light of the relief: the light of the shadow stands higher
SOFTNESS = 0.022  # of the shadow's edge, of the longer edge of the image
OPACITY = 0.34  # where no light comes
LEVELS = 10  # heights of the sides of a block whose shadow is drawn
DEPTH = 2e-3  # below the ground, of the longer edge of the box: lines on the ground stay whole


def relief_shadow(floor: Floor) -> Plate:
    """Return the shadow of the block that a map in relief makes."""
    if floor.heights is None:
        raise ValueError("a flat map has no shadow")
    grid = relief_grid(floor.origin, floor.size, floor.heights)
    rows, columns = (np.linspace(0, count - 1, min(count, PIXELS)).astype(int) for count in grid.heights.shape)
    x, y = np.meshgrid(grid.x[columns], grid.y[rows])
    heights = np.linspace(0.0, 1.0, LEVELS)[:, None, None] * grid.heights[np.ix_(rows, columns)]
    points = np.stack(np.broadcast_arrays(x, y, floor.height + heights), axis=-1).reshape(-1, 3)
    return shadow_of(points, floor.origin, floor.size, floor.height)


def shadow_of(points: np.ndarray, origin, size, ground: float) -> Plate:
    """Return the shadow on the ground, at a height, of points (P, 3) above it, which are denser than its pixels.

    `origin`, `size`: of the box (x, y) in which the points lie. Two shadows of one box have the same extent.
    """
    longer = max(size)
    low = np.array(origin, float) - MARGIN * longer
    extent = np.array(size, float) + 2 * MARGIN * longer
    pixel = float(extent.max()) / PIXELS
    columns, rows = np.maximum(np.ceil(extent / pixel).astype(int), 1).tolist()
    away = -LENGTH * TOWARDS_LIGHT[:2] / TOWARDS_LIGHT[2]
    height = np.clip(points[:, 2:3] - ground, 0.0, 0.7 * MARGIN * longer / np.abs(away).max())
    column, row = np.floor((points[:, :2] + height * away - low) / pixel).astype(int).T
    covered = np.zeros((rows, columns))
    covered[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)] = 1.0
    image = np.zeros((rows, columns, 4), np.uint8)
    image[..., 3] = np.rint(255 * OPACITY * _softened(covered, SOFTNESS * PIXELS))
    place = (float(low[0]), float(low[1])), (columns * pixel, rows * pixel)
    return Plate("shadow", frozen_array(image, np.uint8), 2, ground - DEPTH * longer, *place)


def _softened(image: np.ndarray, width: float) -> np.ndarray:
    """Return an image (h, w) with edges of a width, pixels."""
    across, along = (np.exp(-0.5 * (np.subtract.outer(np.arange(n), np.arange(n)) / width) ** 2) for n in image.shape)
    return across @ image @ along / (2 * np.pi * width**2)
