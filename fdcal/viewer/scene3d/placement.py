"""Where a page's camera stands, and where it was placed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...graphics.camera import Camera
from ..server.client_values import bounded

TOLERANCE = 1e-3  # relative, of camera positions that count as equal
AIM_TOLERANCE = 4e-6  # of its distance: how far from its target a page's camera may aim
DEPTH_RANGE = 40.0  # times nearer and farther than what is looked at: nothing is drawn beyond
MAX_PIXELS = 16384  # of a canvas
ASSUMED_SIZE = 720  # pixels, of a canvas whose size is not reported


@dataclass(frozen=True)
class Placement:
    """The last command to a page."""

    view: str = "top"  # as in graphics.camera.VIEWS
    size: tuple[int, int] | None = None  # (width, height) of the canvas at that time, pixels, or None
    beside: bool = False  # whether the legend stood beside the scene at that time
    camera: Camera | None = None  # that was commanded, or None
    positions: tuple[tuple[float, float, float], ...] = ()  # the last ones of the camera, metres


@dataclass(frozen=True)
class KeptView:
    """How one page looks at the scene: a view that it was placed to, or where its user has moved the camera."""

    view: str = ""  # as in graphics.camera.VIEWS, or "" for a camera of the user
    camera: Camera | None = None  # Camera of the user, or None


def kept_view(camera, placement: Placement) -> KeptView:
    """Return how a page with this camera, placed so the last time, looks at the scene."""
    if placement.camera is None or is_at(camera, placement.camera):
        return KeptView(placement.view, None if placement.view else placement.camera)
    place = [tuple(float(x) for x in vector) for vector in (camera.position, camera.look_at, camera.up_direction)]
    (x, y, z), (u, v, w), up = place
    return KeptView("", Camera((x, y, z), (u, v, w), (up[0], up[1], up[2]), float(camera.fov), 1.0))


def canvas(camera) -> tuple[int, int]:
    """Width and height, pixels, that a page reports; bounded, for it may report anything."""
    width, height = camera.image_width, camera.image_height
    return bounded(width, 1, MAX_PIXELS, ASSUMED_SIZE), bounded(height, 1, MAX_PIXELS, ASSUMED_SIZE)


def stands_at(camera, position) -> bool:
    """Whether a page's camera is at a position, metres."""
    return bool(np.allclose(camera.position, position, rtol=TOLERANCE))


def planes(wanted: Camera) -> tuple[float, float]:
    """Distances from the eye, metres, between which things are drawn."""
    distance = math.dist(wanted.position, wanted.look_at)
    return distance / DEPTH_RANGE, distance * DEPTH_RANGE


def is_at(camera, wanted: Camera) -> bool:
    """Whether a page's camera is the one that was commanded: position, direction, field of view, clipping planes.

    The direction counts to AIM_TOLERANCE: from the top, the hair's breadth from straight down decides which way is up.
    """
    off = np.subtract(camera.look_at, camera.position) - np.subtract(wanted.look_at, wanted.position)
    aimed = np.abs(off[:2]).max() <= AIM_TOLERANCE * math.dist(wanted.position, wanted.look_at)
    at = stands_at(camera, wanted.position)
    at = at and np.allclose(camera.look_at, wanted.look_at, rtol=TOLERANCE, atol=TOLERANCE)
    clipped = np.allclose((camera.near, camera.far), planes(wanted), rtol=TOLERANCE, atol=0)
    return bool(at and aimed and clipped and abs(camera.fov - wanted.fov) <= TOLERANCE * wanted.fov)
