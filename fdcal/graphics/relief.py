"""A map in relief: its shading, and its surface for any renderer. Lengths are metres.

The light comes from the upper left, as on a geographic map, and is part of the colours: no renderer adds one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

TOWARDS_LIGHT = np.array([-0.55, 0.55, 0.63])
DARKEST = 0.55  # brightness of a slope that the light does not reach
BRIGHTEST = 0.3  # share of white on a slope that faces the light


@dataclass(frozen=True)
class ReliefGrid:
    """The surface of a map in relief up to the edges of its outer cells."""

    # x, y: (nx + 2,) and (ny + 2,) float64, metres: the lowest edge, the middles of the cells, the highest edge
    x: np.ndarray
    y: np.ndarray
    heights: np.ndarray  # (ny + 2, nx + 2) float64, metres above the map's own height


def shaded(rgb: np.ndarray, heights: np.ndarray, step: float) -> np.ndarray:
    """Return the colours of a map as the light makes them; level ground keeps its colour.

    `rgb` (ny, nx, 3) uint8; `heights` (ny, nx) float32, metres; `step`: between cells, metres. Returns (ny, nx, 3)
    uint8.
    """
    rise_y, rise_x = np.gradient(np.asarray(heights, float), step)
    light = TOWARDS_LIGHT / TOWARDS_LIGHT[2]  # level ground has the brightness 1
    brightness = (1.0 - rise_x * light[0] - rise_y * light[1]) / np.sqrt(1.0 + rise_x**2 + rise_y**2)
    dark = (DARKEST + (1 - DARKEST) * np.clip(brightness, 0.0, 1.0))[..., None]
    white = (BRIGHTEST * np.clip(brightness - 1.0, 0.0, 1.0))[..., None]
    return np.rint((1 - white) * dark * rgb + white * 255).astype(np.uint8)


def relief_grid(origin, size, heights: np.ndarray) -> ReliefGrid:
    """Return the surface of a map that covers the box from `origin`, (x, y), of `size`, metres.

    `heights` (ny, nx) float32, metres, in the middles of the cells.
    """
    axes = [
        low + length * np.concatenate([[0.0], (np.arange(count) + 0.5) / count, [1.0]])
        for low, length, count in zip(origin, size, heights.shape[::-1], strict=True)
    ]
    return ReliefGrid(axes[0], axes[1], np.pad(np.asarray(heights, float), 1, mode="edge"))
