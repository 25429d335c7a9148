"""Where each page's camera stands: placed so that the picture fills what the panels leave free, and kept there.

viser replaces all that it knows of a camera whenever its page tells of it, between two of our own orders, too. What is
then the same as what is ordered is not sent, though another order may have gone before it: now and then a page ends up
with a new place and an old direction. So it is believed only once it tells the camera that was ordered.
"""

from __future__ import annotations

import collections
import logging
import math
from dataclasses import dataclass

import numpy as np
import viser

from ...graphics.camera import Camera, camera_for
from ...graphics.primitives import Picture
from ..server.client_values import bounded

log = logging.getLogger(__name__)

FLAT = 0.06  # rad, opening of the top view: from far away, so that it looks like a plan
MOST_PIXELS = 16384  # of a canvas
DOUBTS = (1, 2, 4, 8, 16)  # looks after a camera was placed at which its page is made to tell its canvas's size anew
MOST_EYES = 6  # last places of a camera that are kept
DEPTH = 40.0  # times nearer and farther than what is looked at: nothing is drawn beyond
AIMED = 4e-6  # of its distance: how far beside what it should look at a page's camera may look
NEAR = 1e-3  # relative, of places of a camera that are the same
PROD = 1e-4  # relative change of a camera's opening that makes the page tell
MARGINS = (76, 44, 34, 40)  # pixels left, bottom, right and top of the search domain, for its rulers
NARROW, COVERED = 440, 0.62  # pixels across of a telephone's canvas, and the share of its height that its panel covers


@dataclass(frozen=True)
class Placed:
    """What a page was told: its view, the canvas's size then, the camera, and the last places of it."""

    view: str = "top"
    size: tuple[int, int] | None = None
    camera: Camera | None = None
    eyes: tuple = ()


class Cameras:
    """Owns what was last told to each page. `picture` is what there is to be seen."""

    def __init__(self, server: viser.ViserServer):
        self._server = server
        self.picture: Picture | None = None
        self._placed: dict[int, Placed] = {}
        self._looks: dict[int, int] = {}  # page to looks since its camera was placed
        self._asked: collections.deque[tuple] = collections.deque()  # pages to be placed, with the view or None

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
        if self.picture is None:
            return
        camera = client.camera
        size = _canvas(camera)
        seen = camera_for(self.picture, size, view, _margins(size), fov=FLAT if view == "top" else None)
        eyes = self._placed.get(client.client_id, Placed(eyes=(self._server.initial_camera.position,))).eyes
        eyes = *(eye for eye in eyes if not np.allclose(eye, seen.position, rtol=NEAR)), seen.position
        self._placed[client.client_id] = Placed(view, size, seen, eyes[-MOST_EYES:])
        self._looks[client.client_id] = 0
        with client.atomic():
            camera.near, camera.far = _planes(seen)
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
        placed, camera = self._placed.get(client.client_id, Placed()), client.camera
        if placed.camera is None:
            self.place(client, placed.view)
            return
        settled = _canvas(camera) == placed.size and _is_at(camera, placed.camera)
        if not settled and any(_stands_at(camera, eye) for eye in placed.eyes):
            self.place(client, placed.view)

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
        first.near, first.far = _planes(seen)
        first.fov, first.up, first.position, first.look_at = seen.fov, seen.up, seen.position, seen.look_at


def _canvas(camera) -> tuple[int, int]:
    """Width and height, pixels, that a page tells; bounded, for it may tell anything."""
    return tuple(bounded(getattr(camera, name), 1, MOST_PIXELS, 720) for name in ("image_width", "image_height"))


def _margins(size: tuple[int, int]) -> tuple[int, int, int, int]:
    """Pixels left, bottom, right and top of what is looked at."""
    return MARGINS if size[0] > NARROW or size[1] < 1.6 * size[0] else (48, round(COVERED * size[1]), 24, 34)


def _stands_at(camera, eye) -> bool:
    return bool(np.allclose(camera.position, eye, rtol=NEAR))


def _planes(seen: Camera) -> tuple[float, float]:
    """Distances from the eye, metres, between which things are drawn."""
    distance = math.dist(seen.position, seen.look_at)
    return distance / DEPTH, distance * DEPTH


def _is_at(camera, seen: Camera) -> bool:
    """Whether a page's camera is the one that was ordered: its place, its direction, its opening, its planes.

    The direction counts to AIMED: from the top, a hair beside straight down tells which way is up.
    """
    off = np.subtract(camera.look_at, camera.position) - np.subtract(seen.look_at, seen.position)
    aimed = np.abs(off[:2]).max() <= AIMED * math.dist(seen.position, seen.look_at)
    same = _stands_at(camera, seen.position) and np.allclose(camera.look_at, seen.look_at, rtol=NEAR, atol=NEAR)
    deep = np.allclose((camera.near, camera.far), _planes(seen), rtol=NEAR, atol=0)
    return bool(same and aimed and deep and abs(camera.fov - seen.fov) <= NEAR * seen.fov)
