"""A map on the floor as an image, or as a surface with its relief."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...graphics.primitives import Floor

if TYPE_CHECKING:
    import trimesh


def place_of(floor: Floor) -> tuple:
    return floor.origin, floor.size, floor.height


def see_through(floor: Floor) -> np.ndarray:
    """The map's image, with its opacity where it has one : (ny, nx, 3 or 4) uint8."""
    if floor.opacity >= 1:
        return floor.rgb
    alpha = np.full((*floor.rgb.shape[:2], 1), round(255 * floor.opacity), np.uint8)
    return np.concatenate([floor.rgb, alpha], axis=2)


def relief(floor: Floor) -> trimesh.Trimesh:
    """A map with heights as a surface through the middles of its pixels, the map's image on it.

    Neither a metal, which would show surroundings that are not there, nor shiny: its colours are those of the map.
    """
    import trimesh  # here, for it takes long to load and few pages need it
    from PIL import Image
    from trimesh.visual import material

    ny, nx = floor.heights.shape
    u, v = np.meshgrid(*((np.arange(count) + 0.5) / count for count in (nx, ny)))
    across = [o + size * share.ravel() for o, size, share in zip(floor.origin, floor.size, (u, v), strict=True)]
    corner = (nx * np.arange(ny - 1)[:, None] + np.arange(nx - 1)).ravel()[:, None]
    faces = np.concatenate([corner + [0, 1, nx + 1], corner + [0, nx + 1, nx]])
    image = Image.fromarray(np.ascontiguousarray(floor.rgb[::-1]))
    matt = material.PBRMaterial(baseColorTexture=image, metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True)
    visual = trimesh.visual.TextureVisuals(uv=np.column_stack([u.ravel(), v.ravel()]), material=matt)
    return trimesh.Trimesh(
        np.column_stack([*across, floor.height + floor.heights.ravel()]), faces, visual=visual, process=False
    )
