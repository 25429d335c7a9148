"""Where a picture is looked at from, and the pixel at which a point of it appears."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .checks import require_choice
from .primitives import Picture

VIEWS = ("top", "3d")
AROUND = 1.35  # of the search domain's size is what the 3-D view shows
BIRD = (-0.42, -0.88, 0.78)  # direction from what is looked at to the eye of the 3-D view


@dataclass(frozen=True)
class Camera:
    """An eye at `position` that sees `height` metres from bottom to top of the image at `look_at`.

    `fov` is the vertical opening, radians; 0 is parallel projection, and a small one from afar looks like it.
    """

    position: tuple[float, float, float]
    look_at: tuple[float, float, float]
    up: tuple[float, float, float]
    fov: float
    height: float


def camera_for(picture: Picture, size, view: str, margins=(0, 0, 0, 0), fov: float | None = None) -> Camera:
    """Camera that fills an image with what matters.

    Parameters
    ----------
    size : (width, height), pixels
    view : "top" (north up, the search domain fills the image) or "3d" (the array within its room)
    margins : left, bottom, right, top pixels to be left free
    fov : radians; by default parallel from the top and 35 degrees in 3-D
    """
    require_choice("view", view, VIEWS)
    width, height = (max(int(length), 1) for length in size)
    left, bottom, right, top = margins
    free = max(width - left - right, 0.2 * width), max(height - bottom - top, 0.2 * height)
    (x0, y0, x1, y1), heights = picture.focus, picture.heights
    centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, sum(heights) / 2])
    if view == "top":
        scale = max((x1 - x0) / free[0], (y1 - y0) / free[1])  # metres a pixel
        centre[:2] += scale / 2 * np.array([right - left, top - bottom])
        # A hair south of straight down: turning the view from here keeps z upright.
        return _looking(centre, (0.0, -1e-4, 1.0), scale * height, 0.0 if fov is None else fov)
    fov = math.radians(35) if fov is None else fov
    corners = [(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in heights]
    camera = _looking(centre, BIRD, math.hypot(x1 - x0, y1 - y0), fov)
    for _ in range(4):  # perspective makes the size on the image no simple function of the distance
        taken = np.ptp(project(camera, (width, height), corners), axis=0) / free
        camera = _looking(centre, BIRD, AROUND * camera.height * float(taken.max()), fov)
    return camera


def _looking(centre: np.ndarray, direction, height: float, fov: float) -> Camera:
    distance = height / 2 / math.tan(fov / 2) if fov else 2 * height
    towards = np.array(direction) / np.linalg.norm(direction)
    return Camera(
        tuple(map(float, centre + distance * towards)), tuple(map(float, centre)), (0.0, 0.0, 1.0), fov, height
    )


def project(camera: Camera, size, points) -> np.ndarray:
    """Pixels (column, row), counted from the upper left corner of the image, of points (P, 3), metres : (P, 2)."""
    width, height = size
    eye, look_at = np.array(camera.position), np.array(camera.look_at)
    forward = (look_at - eye) / np.linalg.norm(look_at - eye)
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    offset = np.atleast_2d(np.asarray(points, float)) - eye
    across, upward, depth = offset @ right, offset @ np.cross(right, forward), offset @ forward
    seen = camera.height if not camera.fov else 2 * depth * math.tan(camera.fov / 2)
    pixels = height / seen
    return np.stack([width / 2 + across * pixels, height / 2 - upward * pixels], axis=1)
