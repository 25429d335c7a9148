"""Primitives in space: triangles with a texture, and an image parallel to two axes. Lengths are metres.

Everything is frozen, the arrays included, and independent of a renderer, which adds no light of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Surface:
    """Triangles coloured by a texture."""

    name: str  # unique in a picture
    vertices: np.ndarray  # (V, 3) float32, metres
    faces: np.ndarray  # (F, 3) int32, indices of vertices, in the order in which they are to be drawn
    places: np.ndarray  # (V, 2) float32, column and row in the texture, 0 to 1
    texture: np.ndarray  # (h, w, 4) uint8, RGB and opacity


@dataclass(frozen=True)
class Plate:
    """An image in space, parallel to two axes."""

    name: str  # unique in a picture
    rgb: np.ndarray  # (h, w, 3) uint8
    axis: int  # 0, 1 or 2, of x, y and z: across the image
    position: float  # along that axis, metres
    # origin, size: lowest corner and extent along the other axes, in their order, metres; row 0 is at the low end
    origin: tuple[float, float]
    size: tuple[float, float]
    opacity: float = 1.0  # 0 to 1

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
