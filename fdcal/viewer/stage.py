"""A `Picture` as viser's scene nodes. Only what has changed is sent."""

from __future__ import annotations

import math

import numpy as np
import viser

from ..camera import camera_for
from ..primitives import Floor, Label, Lines, Picture, Solid

FLAT = 0.06  # rad, opening of the top view: from far away, so that it looks like a plan
MARGINS = (76, 44, 34, 40)  # pixels left, bottom, right and top of the search domain, for its rulers


class Stage:
    """Owns the nodes of one scene, shared by all pages."""

    def __init__(self, server: viser.ViserServer):
        self._server = server
        server.scene.configure_default_lights(False)
        server.scene.configure_environment_map(None)
        server.scene.add_light_ambient("/light", intensity=math.pi)  # alone, it leaves colours as they are
        self._nodes: dict[str, tuple] = {}  # name to (primitive, node)
        self._picture: Picture | None = None
        self._placed: dict[int, tuple] = {}  # page to its view, the canvas's size, and the eye given to it

    def show(self, picture: Picture) -> None:
        """Make the scene look like `picture`."""
        parts = {part.name: part for part in (*picture.lines, *picture.solids, *picture.labels)}
        if picture.floor is not None:
            parts["floor"] = picture.floor  # no other name may lie below it: viser would move that node along
        self._picture = picture
        with self._server.atomic():
            for name in sorted(self._nodes.keys() - parts.keys(), reverse=True):  # a child before its parent
                self._nodes.pop(name)[1].remove()
            for name, part in parts.items():
                old, node = self._nodes.get(name, (None, None))
                if old is not part and not (node is not None and _same(old, part)):
                    self._nodes[name] = part, self._send(name, old, node, part)

    def place(self, client: viser.ClientHandle, view: str) -> None:
        """Put one page's camera where the search domain fills what the panels leave free."""
        if self._picture is None:
            return
        camera = client.camera
        size = (max(camera.image_width, 1), max(camera.image_height, 1))
        seen = camera_for(self._picture, size, view, MARGINS, fov=FLAT if view == "top" else None)
        distance = math.dist(seen.position, seen.look_at)
        self._placed[client.client_id] = view, size, seen.position
        with client.atomic():
            camera.near, camera.far = distance / 40, distance * 40
            camera.fov, camera.up_direction = seen.fov, seen.up
            camera.position, camera.look_at = seen.position, seen.look_at

    def keep_placed(self, client: viser.ClientHandle) -> None:
        """Follow a canvas that changes its size, as long as nobody has moved its camera."""
        view, size, eye = self._placed.get(client.client_id, ("top", None, None))
        camera = client.camera
        if size is None or (
            (camera.image_width, camera.image_height) != size and np.allclose(camera.position, eye, rtol=1e-3)
        ):
            self.place(client, view)

    def forget(self, client: viser.ClientHandle) -> None:
        """A page has closed."""
        self._placed.pop(client.client_id, None)

    def open_at(self, picture: Picture, size=(680, 720)) -> None:
        """Where the camera of a page that opens stands until its size is known."""
        seen, first = camera_for(picture, size, "top", MARGINS, fov=FLAT), self._server.initial_camera
        first.near, first.far = math.dist(seen.position, seen.look_at) / 40, math.dist(seen.position, seen.look_at) * 40
        first.fov, first.up, first.position, first.look_at = seen.fov, seen.up, seen.position, seen.look_at

    def _send(self, name: str, old, node, part):
        """The node for `part`, made or brought up to date."""
        if isinstance(part, Lines):
            return self._send_lines(f"/{name}", old, node, part)
        if isinstance(part, Floor):
            return self._send_floor(f"/{name}", old, node, part)
        if isinstance(part, Label):
            return self._send_label(f"/{name}", node, part)
        return self._send_solid(f"/{name}", old, node, part)

    def _send_lines(self, name: str, old: Lines | None, node, lines: Lines):
        if node is None or (old.colour, old.width) != (lines.colour, lines.width):
            return self._server.scene.add_line_segments(
                name, lines.segments, lines.colour, thickness=lines.width, thickness_units="screen"
            )
        node.points = lines.segments
        return node

    def _send_floor(self, name: str, old: Floor | None, node, floor: Floor):
        if node is not None and (old.origin, old.size, old.height) == (floor.origin, floor.size, floor.height):
            node.image = floor.rgb
            return node
        (x, y), (width, depth) = floor.origin, floor.size
        return self._server.scene.add_image(
            name, floor.rgb, width, depth, format="png", cast_shadow=False, receive_shadow=False,
            wxyz=(1.0, 0.0, 0.0, 0.0), position=(x + width / 2, y + depth / 2, floor.height),
        )  # fmt: skip

    def _send_label(self, name: str, node, label: Label):
        if node is None:
            return self._server.scene.add_label(name, label.text, position=label.position, anchor=label.anchor)
        node.text, node.position, node.anchor = label.text, label.position, label.anchor
        return node

    def _send_solid(self, name: str, old: Solid | None, node, solid: Solid):
        if node is not None and old.colour == solid.colour and np.array_equal(old.faces, solid.faces):
            node.vertices = solid.vertices
            return node
        opacity = solid.opacity if solid.opacity < 1 else None
        return self._server.scene.add_mesh_simple(
            name, solid.vertices, solid.faces, color=solid.colour, opacity=opacity,
            side="double", cast_shadow=False, receive_shadow=False,
        )  # fmt: skip


def _same(old, new) -> bool:
    """Whether two primitives look alike though they are not one object."""
    if isinstance(new, Lines):
        return (old.colour, old.width) == (new.colour, new.width) and np.array_equal(old.segments, new.segments)
    if isinstance(new, Solid):
        alike = (old.colour, old.opacity) == (new.colour, new.opacity) and np.array_equal(old.vertices, new.vertices)
        return alike and np.array_equal(old.faces, new.faces)
    return isinstance(new, Label) and old == new
