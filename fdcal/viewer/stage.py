"""A `Picture` as viser's scene nodes. Only what has changed is sent."""

from __future__ import annotations

import collections
import logging
import math

import numpy as np
import viser

from ..camera import camera_for
from ..primitives import Floor, Label, Lines, Picture, Solid
from .floors import place_of, relief, see_through
from .safety import bounded

log = logging.getLogger(__name__)

FLAT = 0.06  # rad, opening of the top view: from far away, so that it looks like a plan
MOST_PIXELS = 16384  # of a canvas
LETTERS = 1.5  # height of a ruler's numbers, in radii of a marker
DOUBTS = (1, 2, 4, 8, 16)  # looks after a camera was placed at which its page is made to tell its canvas's size anew
MOST_EYES = 6  # last places of a camera that are kept
NEAR = 1e-3  # relative, of places of a camera that are the same
PROD = 1e-4  # relative change of a camera's opening that makes the page tell
MARGINS = (76, 44, 34, 40)  # pixels left, bottom, right and top of the search domain, for its rulers
NARROW, COVERED = 440, 0.62  # pixels across of a telephone's canvas, and the share of its height that its panel covers


class Stage:
    """Owns the nodes of one scene, shared by all pages."""

    def __init__(self, server: viser.ViserServer):
        self._server = server
        server.scene.configure_default_lights(False)
        server.scene.configure_environment_map(None)
        server.scene.add_light_ambient("/light", intensity=math.pi)  # alone, it leaves colours as they are
        self._nodes: dict[str, tuple] = {}  # name to (primitive, node)
        self._picture: Picture | None = None
        self._placed: dict[int, tuple] = {}  # page to its view, the canvas's size, and the eyes given to it
        self._looks: dict[int, int] = {}  # page to looks since its camera was placed
        self._asked: collections.deque[tuple] = collections.deque()  # pages to be placed, with the view or None

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

    def ask(self, client: viser.ClientHandle, view: str | None = None) -> None:
        """Have the main loop place a page's camera or, without a view, see whether its canvas has changed. Any thread.

        Two threads that place one camera could each send what the other believes to have been the last word.
        """
        self._asked.append((client, view))

    def answer(self, clients) -> None:
        """Do what was asked for those who are still connected; called by the main loop, which alone places cameras."""
        while self._asked:
            client, view = self._asked.popleft()
            if client not in clients:
                continue
            if view is None:
                self.keep_placed(client)
            else:
                self.place(client, view)

    def place(self, client: viser.ClientHandle, view: str) -> None:
        """Put one page's camera where the search domain fills what the panels leave free."""
        if self._picture is None:
            return
        camera = client.camera
        size = _canvas(camera)
        seen = camera_for(self._picture, size, view, _margins(size), fov=FLAT if view == "top" else None)
        distance = math.dist(seen.position, seen.look_at)
        eyes = self._placed.get(client.client_id, ("", None, (self._server.initial_camera.position,)))[2]
        eyes = *(eye for eye in eyes if not np.allclose(eye, seen.position, rtol=NEAR)), seen.position
        self._placed[client.client_id] = view, size, eyes[-MOST_EYES:]
        self._looks[client.client_id] = 0
        with client.atomic():
            camera.near, camera.far = distance / 40, distance * 40
            camera.fov, camera.up_direction = seen.fov, seen.up
            camera.position, camera.look_at = seen.position, seen.look_at

    def place_all(self, view: str) -> None:
        """`ask` for every page."""
        for client in self._server.get_clients().values():
            self.ask(client, view)

    def keep_placed(self, client: viser.ClientHandle, doubt: int | None = None) -> None:
        """Follow a canvas that changes its size, as long as nobody has moved its camera; where in `doubt`, ask it.

        A camera that stands where it was put before the last time was not moved by a hand either: what the page tells
        is older, or it has gone back there, as a page does that learns late where the camera is to stand at first.

        A page that tells of a camera that cannot be is left alone; the others go on.
        """
        try:
            self._follow(client)
            if doubt is not None:
                self._prod(client, 1 + PROD if doubt % 2 else 1 / (1 + PROD))
        except Exception:
            log.debug("a page tells of a camera that cannot be", exc_info=True)
            self.forget(client)

    def _follow(self, client: viser.ClientHandle) -> None:
        view, size, eyes = self._placed.get(client.client_id, ("top", None, ()))
        camera = client.camera
        if size is None:
            self.place(client, view)
            return
        settled = _canvas(camera) == size and _stands_at(camera, eyes[-1])
        if not settled and any(_stands_at(camera, eye) for eye in eyes):
            self.place(client, view)

    def keep_all_placed(self, clients) -> None:
        """`keep_placed` for pages whose canvas has changed without a word; called by the main loop now and then."""
        for client in clients:
            if client.client_id in self._placed:
                self._looks[client.client_id] = looks = self._looks.get(client.client_id, 0) + 1
                self.keep_placed(client, DOUBTS.index(looks) if looks in DOUBTS else None)

    def _prod(self, client: viser.ClientHandle, factor: float) -> None:
        """Make a page tell its canvas's size by a change of its camera that nobody sees.

        Of its own accord it tells the size at the moment when the panels move, at which the canvas may still have the
        one before: the picture then fits a canvas that is not there, and clicks land beside what they aim at.
        """
        client.camera.fov *= factor

    def forget(self, client: viser.ClientHandle) -> None:
        """A page has closed."""
        self._placed.pop(client.client_id, None)
        self._looks.pop(client.client_id, None)

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
        if floor.heights is not None:
            return self._server.scene.add_mesh_trimesh(name, relief(floor), cast_shadow=False, receive_shadow=False)
        if node is not None and old.heights is None and place_of(old) == place_of(floor):
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


def _canvas(camera) -> tuple[int, int]:
    """Width and height, pixels, that a page tells; bounded, for it may tell anything."""
    return tuple(bounded(getattr(camera, name), 1, MOST_PIXELS, 720) for name in ("image_width", "image_height"))


def _margins(size: tuple[int, int]) -> tuple[int, int, int, int]:
    """Pixels left, bottom, right and top of what is looked at."""
    return MARGINS if size[0] > NARROW or size[1] < 1.6 * size[0] else (48, round(COVERED * size[1]), 24, 34)


def _stands_at(camera, eye) -> bool:
    return bool(np.allclose(camera.position, eye, rtol=NEAR))


def _same(old, new) -> bool:
    """Whether two primitives look alike though they are not one object."""
    if isinstance(new, Lines):
        return (old.colour, old.width) == (new.colour, new.width) and np.array_equal(old.segments, new.segments)
    if isinstance(new, Solid):
        alike = (old.colour, old.opacity) == (new.colour, new.opacity) and np.array_equal(old.vertices, new.vertices)
        return alike and np.array_equal(old.faces, new.faces)
    return isinstance(new, Label) and old == new
