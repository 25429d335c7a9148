"""A `Picture` as viser's scene nodes. Only what has changed is sent."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import viser
import viser.transforms

from ...graphics.heatmap import relief_grid
from ...graphics.primitives import Floor, Lines, Mesh, Picture, Plate, Surface
from ..server import content
from .cameras import Cameras
from .labels import labels_html

if TYPE_CHECKING:
    import trimesh


def same_extent(one: Floor, other: Floor) -> bool:
    """Return whether two maps cover the same area at the same height."""
    return (one.origin, one.size, one.height) == (other.origin, other.size, other.height)


def image_of(part: Floor | Plate) -> np.ndarray:
    """Return the image of a map or slice, (ny, nx, 3) uint8, with its opacity as a fourth channel if not opaque."""
    if part.opacity >= 1:
        return part.rgb
    alpha = np.full((*part.rgb.shape[:2], 1), round(255 * part.opacity), np.uint8)
    return np.concatenate([part.rgb, alpha], axis=2)


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


REPLACING_TIME = 3.0  # s that a surface stays beside the one that replaces it; `server/page.js` shows one of them

Part = Lines | Mesh | Floor | Surface | Plate


class SceneNodes:
    """Owns the nodes of one scene, which all pages share.

    `cameras`: of the pages.
    """

    def __init__(self, server: viser.ViserServer):
        self._server = server
        server.scene.configure_default_lights(False)
        server.scene.configure_environment_map(None)
        server.scene.add_light_ambient("/light", intensity=math.pi)  # alone, it leaves colours as they are
        self._parts: dict[str, Part] = {}
        self._handles: dict[str, Any] = {}
        self._labels = server.gui.add_html(content("labels"), visible=False)
        self._empty = True
        self._numbers = itertools.count()
        self._replaced: list[tuple[str, float | None, Any]] = []  # name, since when, s, and node that another replaces
        self.cameras = Cameras(server)

    @property
    def parts(self) -> Mapping[str, Part]:
        """The primitives in the scene, by name."""
        return self._parts

    @property
    def is_empty(self) -> bool:
        """Whether nothing has been shown yet."""
        return self._empty

    def show(self, picture: Picture) -> None:
        """Make the scene look like `picture`."""
        parts: dict[str, Part] = {part.name: part for part in (*picture.lines, *picture.meshes)}
        parts |= {part.name: part for part in (*picture.surfaces, *picture.plates)}
        if picture.floor is not None:
            # No other name may lie below it: viser would move that node along. And a page keeps the position of a name
            # for the next node of that name, so a relief, which has none, needs a name of its own.
            parts["floor" if picture.floor.heights is None else "relief"] = picture.floor
        self._empty, self.cameras.picture = False, picture
        texts = content("labels", labels_html(picture.labels, picture.theme))
        with self._server.atomic():
            for name in sorted(self._handles.keys() - parts.keys(), reverse=True):  # a child before its parent
                self._handles.pop(name).remove()
            self._remove_replaced(lambda name, since: name not in parts)  # nothing replaces these
            for name, part in parts.items():
                old = self._parts.get(name)
                if old is None or not (old is part or _looks_same(old, part)):
                    self._handles[name] = self._send(f"/{name}", old, self._handles.get(name), part)
            if self._labels.content != texts:
                self._labels.content = texts
        self._parts = parts

    def settle(self, now: float) -> None:
        """Remove surfaces once every page has drawn those that replace them; called by the main loop at the time `now`.

        A page takes a moment to read a surface, and shows none meanwhile.
        """
        self._replaced = [(name, now if since is None else since, handle) for name, since, handle in self._replaced]
        self._remove_replaced(lambda name, since: since is not None and since < now - REPLACING_TIME)

    def _remove_replaced(self, outdated: Callable[[str, float | None], bool]) -> None:
        """Remove the replaced surfaces of which `outdated(name, since)` is true."""
        for name, since, handle in self._replaced:
            if outdated(name, since):
                handle.remove()
        self._replaced = [entry for entry in self._replaced if not outdated(*entry[:2])]

    def _send(self, name: str, old: Part | None, handle, part: Part):
        """Create the node of `part`, or update the one that shows `old`, and return its handle."""
        if isinstance(part, Lines):
            return self._send_lines(name, old, handle, part)
        if isinstance(part, Floor):
            return self._send_floor(name, old, handle, part)
        if isinstance(part, Plate):
            return self._send_plate(name, old, handle, part)
        if isinstance(part, Surface):
            return self._send_late(name, handle, trimesh_of(part))
        return self._send_solid(name, old, handle, part)

    def _send_lines(self, name: str, old: Part | None, handle, lines: Lines):
        if isinstance(old, Lines) and (old.colour, old.width) == (lines.colour, lines.width):
            handle.points = lines.segments
            return handle
        return self._server.scene.add_line_segments(
            name, lines.segments, lines.colour, thickness=lines.width, thickness_units="screen"
        )

    def _send_floor(self, name: str, old: Part | None, handle, floor: Floor):
        if floor.heights is not None:
            return self._send_late(name, handle, surface_of(floor, floor.heights))
        if isinstance(old, Floor) and same_extent(old, floor):
            handle.image = image_of(floor)
            return handle
        (x, y), (width, depth) = floor.origin, floor.size
        return self._server.scene.add_image(
            name, image_of(floor), width, depth, format="png", cast_shadow=False, receive_shadow=False,
            wxyz=(1.0, 0.0, 0.0, 0.0), position=(x + width / 2, y + depth / 2, floor.height),
        )  # fmt: skip

    def _send_late(self, name: str, handle, surface: trimesh.Trimesh):
        """Create the node of a surface, which a page draws late, beside the one that it replaces."""
        if handle is not None:
            self._replaced.append((name.removeprefix("/"), None, handle))
        name = f"{name}/{next(self._numbers)}"
        return self._server.scene.add_mesh_trimesh(name, surface, cast_shadow=False, receive_shadow=False)

    def _send_plate(self, name: str, old: Part | None, handle, plate: Plate):
        place = tuple(plate.corners.mean(axis=0).tolist())
        if isinstance(old, Plate) and same_frame(old, plate):
            if old.rgb is not plate.rgb:
                handle.image = image_of(plate)
            handle.position = place
            return handle
        return self._server.scene.add_image(
            name, image_of(plate), *plate.size, format="png", cast_shadow=False, receive_shadow=False,
            wxyz=orientation(plate), position=place,
        )  # fmt: skip

    def _send_solid(self, name: str, old: Part | None, handle, solid: Mesh):
        if isinstance(old, Mesh) and old.colour == solid.colour and np.array_equal(old.faces, solid.faces):
            handle.vertices = solid.vertices
            return handle
        opacity = solid.opacity if solid.opacity < 1 else None
        return self._server.scene.add_mesh_simple(
            name, solid.vertices, solid.faces, color=solid.colour, opacity=opacity,
            side="double", cast_shadow=False, receive_shadow=False,
        )  # fmt: skip


def _looks_same(old: Part, new: Part) -> bool:
    """Whether two primitives look the same though they are not one object."""
    if isinstance(new, Lines) and isinstance(old, Lines):
        return (old.colour, old.width) == (new.colour, new.width) and np.array_equal(old.segments, new.segments)
    if isinstance(new, Mesh) and isinstance(old, Mesh):
        same_style = (old.colour, old.opacity) == (new.colour, new.opacity)
        return same_style and np.array_equal(old.vertices, new.vertices) and np.array_equal(old.faces, new.faces)
    return False
