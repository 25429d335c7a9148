"""Surfaces and slices in space as viser's scene nodes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import viser.transforms

from ...graphics.primitives import Plate, Surface

if TYPE_CHECKING:
    import trimesh


def trimesh_of(surface: Surface) -> trimesh.Trimesh:
    """Return a surface with its texture, whose material neither reflects its surroundings nor shines."""
    import trimesh  # here, for it takes long to load and few pages need it
    from PIL import Image
    from trimesh.visual import TextureVisuals, material

    matt = material.PBRMaterial(
        baseColorTexture=Image.fromarray(np.ascontiguousarray(surface.texture[::-1])),
        alphaMode="BLEND", metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True,
    )  # fmt: skip
    visual = TextureVisuals(uv=surface.places, material=matt)
    return trimesh.Trimesh(surface.vertices, surface.faces, visual=visual, process=False)


def orientation(plate: Plate) -> tuple[float, float, float, float]:
    """Return the rotation of an image whose columns and rows follow the axes of the slice: w, x, y, z."""
    columns, rows = np.eye(3)[plate.across]
    rotation = viser.transforms.SO3.from_matrix(np.column_stack([columns, rows, np.cross(columns, rows)]))
    w, x, y, z = rotation.wxyz.tolist()
    return w, x, y, z


def same_frame(one: Plate, other: Plate) -> bool:
    """Return whether two slices lie across the same axis and have the same extent."""
    return (one.axis, one.origin, one.size) == (other.axis, other.origin, other.size)
