"""A `Picture` as viser's scene nodes. Only what has changed is sent."""

from __future__ import annotations

import math

import numpy as np
import viser

from ...graphics.primitives import Floor, Label, Lines, Picture, Solid
from .cameras import Cameras
from .heatmap_node import place_of, relief, see_through

LETTERS = 1.5  # height of a ruler's numbers, in radii of a marker


class Stage:
    """Owns the nodes of one scene, shared by all pages."""

    def __init__(self, server: viser.ViserServer):
        self._server = server
        server.scene.configure_default_lights(False)
        server.scene.configure_environment_map(None)
        server.scene.add_light_ambient("/light", intensity=math.pi)  # alone, it leaves colours as they are
        self._nodes: dict[str, tuple] = {}  # name to (primitive, node)
        self._picture: Picture | None = None
        self.cameras = Cameras(server)

    @property
    def bare(self) -> bool:
        """Whether nothing has been shown yet."""
        return self._picture is None

    def show(self, picture: Picture) -> None:
        """Make the scene look like `picture`."""
        parts = {part.name: part for part in (*picture.lines, *picture.solids, *picture.labels)}
        if picture.floor is not None:
            # No other name may lie below it: viser would move that node along. And a page keeps the place of a name for
            # what comes under it next, so a relief, which has none, needs a name of its own.
            parts["floor" if picture.floor.heights is None else "relief"] = picture.floor
        rescaled = self._picture is not None and self._picture.marker != picture.marker
        self._picture = self.cameras.picture = picture
        with self._server.atomic():
            for name in sorted(self._nodes.keys() - parts.keys(), reverse=True):  # a child before its parent
                self._nodes.pop(name)[1].remove()
            for name, part in parts.items():
                old, node = self._nodes.get(name, (None, None))
                stays = old is part or (node is not None and _same(old, part))
                if not stays or (rescaled and isinstance(part, Label)):
                    self._nodes[name] = part, self._send(name, old, node, part)

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
        if floor.heights is not None:
            return self._server.scene.add_mesh_trimesh(name, relief(floor), cast_shadow=False, receive_shadow=False)
        if node is not None and place_of(old) == place_of(floor):
            node.image = see_through(floor)
            return node
        (x, y), (width, depth) = floor.origin, floor.size
        return self._server.scene.add_image(
            name, see_through(floor), width, depth, format="png", cast_shadow=False, receive_shadow=False,
            wxyz=(1.0, 0.0, 0.0, 0.0), position=(x + width / 2, y + depth / 2, floor.height),
        )  # fmt: skip

    def _send_label(self, name: str, node, label: Label):
        if node is None:
            ruler = label.name.startswith("frame/")  # as large as its room, so that numbers do not collide from afar
            return self._server.scene.add_label(
                name, label.text, position=label.position, anchor=label.anchor,
                font_size_mode="scene" if ruler else "screen", font_scene_height=LETTERS * self._picture.marker,
            )  # fmt: skip
        node.text, node.position, node.anchor = label.text, label.position, label.anchor
        if node.font_scene_height != (height := LETTERS * self._picture.marker):  # another scene, another size
            node.font_scene_height = height
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
