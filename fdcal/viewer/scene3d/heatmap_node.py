"""A map on the floor as an image, or as a surface in relief."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...graphics.heatmap import relief_grid
from ...graphics.primitives import Floor

if TYPE_CHECKING:
    import trimesh


def same_extent(one: Floor, other: Floor) -> bool:
    """Return whether two maps cover the same area at the same height."""
    return (one.origin, one.size, one.height) == (other.origin, other.size, other.height)


def image_of(floor: Floor) -> np.ndarray:
    """Return the map's image, (ny, nx, 3) uint8, with its opacity as a fourth channel where it is not opaque."""
    if floor.opacity >= 1:
        return floor.rgb
    alpha = np.full((*floor.rgb.shape[:2], 1), round(255 * floor.opacity), np.uint8)
    return np.concatenate([floor.rgb, alpha], axis=2)


def surface_of(floor: Floor, heights: np.ndarray) -> trimesh.Trimesh:
    """Return a map in relief as a textured surface through the middles of its pixels and to the edges of the map.

    The material neither reflects its surroundings nor shines, so that the colours are those of the map.

    `heights` (ny, nx) float32, metres above the map's own height.
    """
    import trimesh  # here, for it takes long to load and few pages need it
    from PIL import Image
    from trimesh.visual import TextureVisuals, material

    grid = relief_grid(floor.origin, floor.size, heights)
    ny, nx = grid.heights.shape
    x, y = (places.ravel() for places in np.meshgrid(grid.x, grid.y))
    u, v = (
        np.clip((places - low) / size, 0.5 / count, 1 - 0.5 / count)  # beyond, the other edge of the texture mixes in
        for places, low, size, count in zip((x, y), floor.origin, floor.size, heights.shape[::-1], strict=True)
    )
    corner = (nx * np.arange(ny - 1)[:, None] + np.arange(nx - 1)).ravel()[:, None]
    faces = np.concatenate([corner + [0, 1, nx + 1], corner + [0, nx + 1, nx]])
    image = Image.fromarray(np.ascontiguousarray(floor.rgb[::-1]))
    matt = material.PBRMaterial(baseColorTexture=image, metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True)
    visual = TextureVisuals(uv=np.column_stack([u, v]), material=matt)
    vertices = np.column_stack([x, y, floor.height + grid.heights.ravel()])
    return trimesh.Trimesh(vertices, faces, visual=visual, process=False)
