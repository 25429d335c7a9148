"""A map on the floor as an image, or as a surface in relief."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

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
    """Return a map in relief as a textured surface through the centres of its pixels.

    The material neither reflects its surroundings nor shines, so that the colours are those of the map.

    Parameters
    ----------
    floor : Floor
    heights : (ny, nx) float32, metres above the map's own height
    """
    import trimesh  # here, for it takes long to load and few pages need it
    from PIL import Image
    from trimesh.visual import TextureVisuals, material

    ny, nx = heights.shape
    u, v = np.meshgrid(*((np.arange(count) + 0.5) / count for count in (nx, ny)))
    x, y = (o + size * share.ravel() for o, size, share in zip(floor.origin, floor.size, (u, v), strict=True))
    corner = (nx * np.arange(ny - 1)[:, None] + np.arange(nx - 1)).ravel()[:, None]
    faces = np.concatenate([corner + [0, 1, nx + 1], corner + [0, nx + 1, nx]])
    image = Image.fromarray(np.ascontiguousarray(floor.rgb[::-1]))
    matt = material.PBRMaterial(baseColorTexture=image, metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True)
    visual = TextureVisuals(uv=np.column_stack([u.ravel(), v.ravel()]), material=matt)
    vertices = np.column_stack([x, y, floor.height + heights.ravel()])
    return trimesh.Trimesh(vertices, faces, visual=visual, process=False)
