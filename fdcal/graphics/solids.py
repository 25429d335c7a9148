"""Primitives in space: triangles with a texture, and an image parallel to two axes. Lengths are metres.

Everything is frozen, the arrays included, and independent of a renderer, which adds no light of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Surface:
    """Triangles coloured by a texture.

    Attributes
    ----------
    name : unique in a picture
    vertices : (V, 3) float32, metres
    faces : (F, 3) int32, indices of vertices, in the order in which they are to be drawn
    places : (V, 2) float32, column and row in the texture, 0 to 1
    texture : (h, w, 4) uint8, RGB and opacity
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    places: np.ndarray
    texture: np.ndarray


@dataclass(frozen=True)
class Plate:
    """An image in space, parallel to two axes.

    Attributes
    ----------
    name : unique in a picture
    rgb : (h, w, 3) uint8
    axis : 0, 1 or 2, of x, y and z: across the image
    position : along that axis, metres
    origin, size : lowest corner and extent along the other axes, in their order, metres; row 0 is at the low end
    opacity : 0 to 1
    """

    name: str
    rgb: np.ndarray
    axis: int
    position: float
    origin: tuple[float, float]
    size: tuple[float, float]
    opacity: float = 1.0

    @property
    def corners(self) -> np.ndarray:
        """The corners at (low, low), (high, low), (high, high), (low, high) : (4, 3) float64, metres."""
        (a, b), (width, height) = self.origin, self.size
        corners = np.full((4, 3), self.position)
        corners[:, self.across] = [(a, b), (a + width, b), (a + width, b + height), (a, b + height)]
        return corners

    @property
    def across(self) -> list[int]:
        """The axes of columns and rows."""
        return [axis for axis in range(3) if axis != self.axis]
