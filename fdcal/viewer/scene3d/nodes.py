"""A `Picture` as viser's scene nodes, and its texts as HTML over the canvas. Only what has changed is sent.

viser draws a text in black on a white box, and the numbers of a ruler as large as the room makes them. `server/page.js`
draws them in the type of the page, outlined, and leaves out those that would cover one that comes before.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import viser
import viser.transforms

from ...acoustics.measure import load_cached_measurement
from ...graphics.heatmap import relief_grid
from ...graphics.picture import static_picture
from ...graphics.primitives import Floor, Label, Lines, Mesh, Picture, Plate, Surface, Theme, by_rank, halo_of
from ...model.measurement import Measurement
from ...model.scene import MeasuredScene
from ...session.sources import OpenRequest, as_given
from ..server import content
from .cameras import Cameras

if TYPE_CHECKING:
    import trimesh


def labels_html(labels: Iterable[Label], theme: Theme) -> str:
    """Return the texts as elements with place and lift in `data-at`, metres; what comes first covers the others."""
    elements = []
    for label in by_rank(labels):
        place = ",".join(f"{x:.4f}" for x in (*label.position, label.lift))
        colours = f"color:rgb{label.colour};--halo:rgb{halo_of(label.colour, theme)}".replace(" ", "")
        kind, axis = "name", ""
        if label.name.startswith("frame/"):
            kind, axis = "number", label.name.partition("/")[2][:1]
        elements.append(
            f"<span class='{kind}' data-at='{place}' data-anchor='{label.anchor}' data-axis='{axis}' style='{colours}'>"
            f"{escape(label.text)}</span>"
        )
    return "".join(elements)


def image_of(part: Floor | Plate) -> np.ndarray:
    """Return the image of a map or slice, (ny, nx, 3) uint8, with its opacity as a fourth channel if not opaque."""
    if part.opacity >= 1:
        return part.rgb
    alpha = np.full((*part.rgb.shape[:2], 1), round(255 * part.opacity), np.uint8)
    return np.concatenate([part.rgb, alpha], axis=2)


def relief_of(floor: Floor, heights: np.ndarray) -> trimesh.Trimesh:
    """Return a map in relief as a surface through the middles of its pixels and to the edges of the map.

    `heights` (ny, nx) float32, metres above the map's own height.
    """
    grid = relief_grid(floor.origin, floor.size, heights)
    ny, nx = grid.heights.shape
    x, y = (places.ravel() for places in np.meshgrid(grid.x, grid.y))
    u, v = (
        np.clip((places - low) / size, 0.5 / count, 1 - 0.5 / count)  # beyond, the other edge of the texture mixes in
        for places, low, size, count in zip((x, y), floor.origin, floor.size, heights.shape[::-1], strict=True)
    )
    corner = (nx * np.arange(ny - 1)[:, None] + np.arange(nx - 1)).ravel()[:, None]
    faces = np.concatenate([corner + [0, 1, nx + 1], corner + [0, nx + 1, nx]])
    vertices = np.column_stack([x, y, floor.height + grid.heights.ravel()])
    return textured(vertices, faces, np.column_stack([u, v]), floor.rgb)


def textured(vertices, faces, places, image: np.ndarray, **material: Any) -> trimesh.Trimesh:
    """Return a surface whose material neither reflects its surroundings nor shines: its colours are those of `image`.

    `places` (V, 2): of the vertices in the image, from 0 to 1.
    """
    import trimesh  # here, for it takes long to load and few pages need it
    from PIL import Image
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    texture = Image.fromarray(np.ascontiguousarray(image[::-1]))
    matt = PBRMaterial(baseColorTexture=texture, metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True, **material)
    return trimesh.Trimesh(vertices, faces, visual=TextureVisuals(uv=places, material=matt), process=False)


REPLACING_TIME = 3.0  # s that a surface stays beside the one that replaces it; `server/page.js` shows one of them

Part = Lines | Mesh | Floor | Surface | Plate


class SceneNodes:
    """Owns the nodes of one scene, which all pages share.

    `cameras`: of the pages; `parts`: the primitives in the scene, by name; `is_empty`: whether nothing has been shown.
    """

    def __init__(self, server: viser.ViserServer):
        self._server = server
        server.scene.configure_default_lights(False)
        server.scene.configure_environment_map(None)
        server.scene.add_light_ambient("/light", intensity=math.pi)  # alone, it leaves colours as they are
        self.parts: dict[str, Part] = {}
        self._handles: dict[str, Any] = {}
        self._labels = server.gui.add_html(content("labels"), visible=False)
        self.is_empty = True
        self._numbers = itertools.count()
        self._replaced: list[tuple[str, float | None, Any]] = []  # name, since when, s, and node that another replaces
        self.cameras = Cameras(server)

    def show(self, picture: Picture) -> None:
        """Make the scene look like `picture`."""
        parts: dict[str, Part] = {part.name: part for part in (*picture.lines, *picture.meshes)}
        parts |= {part.name: part for part in (*picture.surfaces, *picture.plates)}
        if picture.floor is not None:
            # No other name may lie below it: viser would move that node along. And a page keeps the position of a name
            # for the next node of that name, so a relief, which has none, needs a name of its own.
            parts["floor" if picture.floor.heights is None else "relief"] = picture.floor
        self.is_empty, self.cameras.picture = False, picture
        texts = content("labels", labels_html(picture.labels, picture.theme))
        with self._server.atomic():
            for name in sorted(self._handles.keys() - parts.keys(), reverse=True):  # a child before its parent
                self._handles.pop(name).remove()
            self._remove_replaced(lambda name, since: name not in parts)  # nothing replaces these
            for name, part in parts.items():
                old = self.parts.get(name)
                if old is not part:
                    self._handles[name] = self._send(f"/{name}", old, self._handles.get(name), part)
            if self._labels.content != texts:
                self._labels.content = texts
        self.parts = parts

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

    def _send(self, name: str, old: Part | None, handle: Any, part: Part) -> Any:
        """Create the node of `part`, or update the one that shows `old`, and return its handle."""
        scene = self._server.scene
        if isinstance(part, Lines):
            if not isinstance(old, Lines) or (old.colour, old.width) != (part.colour, part.width):
                return scene.add_line_segments(
                    name, part.segments, part.colour, thickness=part.width, thickness_units="screen"
                )
            if not np.array_equal(old.segments, part.segments):
                handle.points = part.segments
            return handle
        if isinstance(part, Surface):
            vertices, faces, places = part.vertices, part.faces, part.places
            return self._send_late(name, handle, textured(vertices, faces, places, part.texture, alphaMode="BLEND"))
        if isinstance(part, Floor):
            if part.heights is not None:
                return self._send_late(name, handle, relief_of(part, part.heights))
            if isinstance(old, Floor) and (old.origin, old.size, old.height) == (part.origin, part.size, part.height):
                handle.image = image_of(part)
                return handle
            middle = np.add(part.origin, np.divide(part.size, 2))
            return self._send_image(name, part, (*middle.tolist(), part.height), (1.0, 0.0, 0.0, 0.0))
        if isinstance(part, Plate):
            middle = tuple(part.corners.mean(axis=0).tolist())
            if isinstance(old, Plate) and (old.axis, old.origin, old.size) == (part.axis, part.origin, part.size):
                if old.rgb is not part.rgb:
                    handle.image = image_of(part)
                handle.position = middle
                return handle
            columns, rows = np.eye(3)[part.across]
            turned = viser.transforms.SO3.from_matrix(np.column_stack([columns, rows, np.cross(columns, rows)]))
            return self._send_image(name, part, middle, tuple(turned.wxyz.tolist()))
        same_style = isinstance(old, Mesh) and (old.colour, old.opacity) == (part.colour, part.opacity)
        if isinstance(old, Mesh) and same_style and np.array_equal(old.faces, part.faces):
            if not np.array_equal(old.vertices, part.vertices):
                handle.vertices = part.vertices
            return handle
        return scene.add_mesh_simple(
            name, part.vertices, part.faces, color=part.colour, opacity=part.opacity if part.opacity < 1 else None,
            side="double", cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def _send_image(self, name: str, part: Floor | Plate, middle: Any, turned: Any) -> Any:
        """Create the node of a map or a slice, around `middle`, metres, and rotated by the quaternion `turned`."""
        return self._server.scene.add_image(
            name, image_of(part), *part.size, format="png", cast_shadow=False, receive_shadow=False,
            wxyz=turned, position=middle,
        )  # fmt: skip

    def _send_late(self, name: str, handle: Any, surface: trimesh.Trimesh) -> Any:
        """Create the node of a surface, which a page draws late, beside the one that it replaces."""
        if handle is not None:
            self._replaced.append((name.removeprefix("/"), None, handle))
        name = f"{name}/{next(self._numbers)}"
        return self._server.scene.add_mesh_trimesh(name, surface, cast_shadow=False, receive_shadow=False)

    # Before the first session is ready. This module is imported before the solvers, so that the page has a picture
    # within the second that their import takes.

    def show_cached(self, request: OpenRequest) -> None:
        """Show a request that needs no simulation; show nothing where the scene has to be simulated first."""
        measurement = request.measurement or load_cached_measurement(request.scene)
        if measurement is not None:
            self.show_room(request, as_given(request.scene, measurement))

    def show_room(self, request: OpenRequest, measurement: Measurement) -> None:
        """Show the room and the microphones of a `measurement`; the microphones alone where the room is not known."""
        known_scene = None if isinstance(request.scene, MeasuredScene) else request.scene
        picture = static_picture(known_scene, measurement, request.choices.get("dark") is True)
        self.cameras.set_initial(picture)
        self.show(picture)
