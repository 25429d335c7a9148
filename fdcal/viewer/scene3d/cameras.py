"""The camera of each page: placed so that the picture fills what the panels leave free, and kept there.

viser replaces all that it knows of a page's camera whenever the page reports it, even between two of our own commands.
A value that equals the last command is not sent, although another command may have been sent before it, so now and then
a page ends up with a new position and an old direction. A camera therefore counts as placed only once the page reports
the camera that was commanded.
"""

from __future__ import annotations

import collections
import contextlib
import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import viser

from ...graphics.camera import Camera, camera_for
from ...graphics.primitives import Picture
from ..server.client_values import bounded

log = logging.getLogger(__name__)

TOP_FOV = 0.06  # rad, of the top view: from far away, so that it looks like a plan
MAX_PIXELS = 16384  # of a canvas
CHECKS = (1, 2, 4, 8, 16)  # looks after a placement at which the page is made to report the size of its canvas again
KEPT_POSITIONS = 6  # last positions of a camera that are remembered
DEPTH_RANGE = 40.0  # times nearer and farther than what is looked at: nothing is drawn beyond
AIM_TOLERANCE = 4e-6  # of its distance: how far from its target a page's camera may aim
TOLERANCE = 1e-3  # relative, of camera positions that count as equal
FOV_NUDGE = 1e-4  # relative change of a field of view that makes the page report its camera
MARGINS = (76, 44, 34, 40)  # pixels left, bottom, right and top of the search domain, for its rulers
PHONE_WIDTH = 440  # pixels, of the widest canvas of a telephone
PHONE_PANEL = 0.62  # of the height of its canvas, which the panel covers
PHONE_MARGINS = (48, 24, 34)  # pixels left, right and top there
ASSUMED_SIZE = 720  # pixels, of a canvas whose size is not reported


@dataclass(frozen=True)
class Placement:
    """The last command to a page.

    Attributes
    ----------
    view : as in graphics.camera.VIEWS
    size : (width, height) of the canvas at that time, pixels, or None
    camera : that was commanded, or None
    positions : the last ones of the camera, metres
    """

    view: str = "top"
    size: tuple[int, int] | None = None
    camera: Camera | None = None
    positions: tuple[tuple[float, float, float], ...] = ()


class Cameras:
    """Owns the last commands to the pages' cameras.

    Attributes
    ----------
    picture : what there is to be seen, or None
    """

    def __init__(self, server: viser.ViserServer):
        self._server = server
        self.picture: Picture | None = None
        self._placements: dict[int, Placement] = {}
        self._looks: dict[int, int] = {}  # by page: looks since its camera was placed
        self._requests: collections.deque[tuple[viser.ClientHandle, str | None]] = collections.deque()

    def request(self, client: viser.ClientHandle, view: str | None = None) -> None:
        """Have the main loop place a page's camera or, without a view, check whether its canvas has changed.

        For any thread. Two threads that place one camera could each send what the other takes for the last command.
        """
        self._requests.append((client, view))

    def process_requests(self, clients) -> None:
        """Carry out the requests of the `clients` that are still connected; called by the main loop alone."""
        while self._requests:
            client, view = self._requests.popleft()
            if client not in clients:
                continue
            if view is None:
                self.follow(client)
            else:
                self.place(client, view)

    def place(self, client: viser.ClientHandle, view: str) -> None:
        """Place one page's camera so that the search domain fills what the panels leave free.

        A page that reports an impossible camera is left alone; the others go on.

        Parameters
        ----------
        client : the page
        view : as in graphics.camera.VIEWS
        """
        with self._guarded(client):
            self._place(client, view)

    @contextlib.contextmanager
    def _guarded(self, client: viser.ClientHandle) -> Iterator[None]:
        """Keep an exception that a page's camera causes from the main loop."""
        try:
            yield
        except Exception:
            log.debug("a page reports an impossible camera", exc_info=True)
            self.forget(client)

    def _place(self, client: viser.ClientHandle, view: str) -> None:
        if self.picture is None:
            return
        camera = client.camera
        size = _canvas(camera)
        wanted = camera_for(self.picture, size, view, _margins(size), fov=TOP_FOV if view == "top" else None)
        x, y, z = self._server.initial_camera.position
        before = self._placements.get(client.client_id, Placement(positions=((x, y, z),))).positions
        before = tuple(p for p in before if not np.allclose(p, wanted.position, rtol=TOLERANCE))
        positions = (*before, wanted.position)[-KEPT_POSITIONS:]
        self._placements[client.client_id] = Placement(view, size, wanted, positions)
        self._looks[client.client_id] = 0
        with client.atomic():
            camera.near, camera.far = _planes(wanted)
            camera.fov, camera.up_direction = wanted.fov, wanted.up
            camera.position, camera.look_at = wanted.position, wanted.look_at

    def request_all(self, view: str) -> None:
        """`request` a view for every page."""
        for client in self._server.get_clients().values():
            self.request(client, view)

    def follow(self, client: viser.ClientHandle, check: int | None = None) -> None:
        """Follow a canvas that changes its size as long as the user has not moved the camera.

        A camera that is where it was placed before the last time was not moved by the user: the report is older, or the
        page has gone back there, as a page does that learns late where its camera starts. A page that reports an
        impossible camera is left alone; the others go on.

        Parameters
        ----------
        client : the page
        check : number of the check at which the page is made to report its canvas, or None
        """
        with self._guarded(client):
            self._place_if_changed(client)
            if check is not None:
                self._nudge(client, 1 + FOV_NUDGE if check % 2 else 1 / (1 + FOV_NUDGE))

    def _place_if_changed(self, client: viser.ClientHandle) -> None:
        placement, camera = self._placements.get(client.client_id, Placement()), client.camera
        if placement.camera is None:
            self._place(client, placement.view)
            return
        placed = _canvas(camera) == placement.size and _is_at(camera, placement.camera)
        if not placed and any(_stands_at(camera, position) for position in placement.positions):
            self._place(client, placement.view)

    def follow_all(self, clients) -> None:
        """`follow` pages whose canvas has changed without a report; called by the main loop now and then."""
        for client in clients:
            if client.client_id in self._placements:
                self._looks[client.client_id] = looks = self._looks.get(client.client_id, 0) + 1
                self.follow(client, CHECKS.index(looks) if looks in CHECKS else None)

    def _nudge(self, client: viser.ClientHandle, factor: float) -> None:
        """Make a page report the size of its canvas by an invisible change of its camera.

        By itself it reports the size while the panels move, when the canvas may still have the size before: the picture
        then fits a canvas that does not exist, and clicks miss what they aim at.
        """
        client.camera.fov *= factor

    def forget(self, client: viser.ClientHandle) -> None:
        """Drop what belongs to a page that has closed."""
        self._placements.pop(client.client_id, None)
        self._looks.pop(client.client_id, None)

    def set_initial(self, picture: Picture, size: tuple[int, int] = (680, 720)) -> None:
        """Set the camera of a page that opens, until its size is known.

        Parameters
        ----------
        picture : what there is to be seen
        size : (width, height) that is assumed, pixels
        """
        wanted, first = camera_for(picture, size, "top", MARGINS, fov=TOP_FOV), self._server.initial_camera
        first.near, first.far = _planes(wanted)
        first.fov, first.up, first.position, first.look_at = wanted.fov, wanted.up, wanted.position, wanted.look_at


def _canvas(camera) -> tuple[int, int]:
    """Width and height, pixels, that a page reports; bounded, for it may report anything."""
    width, height = camera.image_width, camera.image_height
    return bounded(width, 1, MAX_PIXELS, ASSUMED_SIZE), bounded(height, 1, MAX_PIXELS, ASSUMED_SIZE)


def _margins(size: tuple[int, int]) -> tuple[int, int, int, int]:
    """Pixels left, bottom, right and top of what is looked at."""
    if size[0] > PHONE_WIDTH or size[1] < 1.6 * size[0]:
        return MARGINS
    left, right, top = PHONE_MARGINS
    return left, round(PHONE_PANEL * size[1]), right, top


def _stands_at(camera, position) -> bool:
    return bool(np.allclose(camera.position, position, rtol=TOLERANCE))


def _planes(wanted: Camera) -> tuple[float, float]:
    """Distances from the eye, metres, between which things are drawn."""
    distance = math.dist(wanted.position, wanted.look_at)
    return distance / DEPTH_RANGE, distance * DEPTH_RANGE


def _is_at(camera, wanted: Camera) -> bool:
    """Whether a page's camera is the one that was commanded: position, direction, field of view, clipping planes.

    The direction counts to AIM_TOLERANCE: from the top, the hair's breadth from straight down decides which way is up.
    """
    off = np.subtract(camera.look_at, camera.position) - np.subtract(wanted.look_at, wanted.position)
    aimed = np.abs(off[:2]).max() <= AIM_TOLERANCE * math.dist(wanted.position, wanted.look_at)
    at = _stands_at(camera, wanted.position)
    at = at and np.allclose(camera.look_at, wanted.look_at, rtol=TOLERANCE, atol=TOLERANCE)
    clipped = np.allclose((camera.near, camera.far), _planes(wanted), rtol=TOLERANCE, atol=0)
    return bool(at and aimed and clipped and abs(camera.fov - wanted.fov) <= TOLERANCE * wanted.fov)
