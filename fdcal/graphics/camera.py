"""Where a picture is looked at from, and the pixel at which a point of it appears."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..model.validation import require_choice
from .primitives import Picture

VIEWS = ("top", "3d", "close")
AROUND = {"3d": 1.06, "close": 1.3}  # of its size: what is shown around the room, and around the search domain
BIRD = (-0.42, -0.88, 0.78)  # direction from what is looked at to the eye of the 3-D views


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
    view : "top" (north up, the search domain fills the image), "3d" (the whole room) or "close" (the array alone)
    margins : left, bottom, right, top pixels to be left free
    fov : radians; by default parallel from the top and 35 degrees in 3-D
    """
    require_choice("view", view, VIEWS)
    width, height = (max(int(length), 1) for length in size)
    left, bottom, right, top = margins
    free = max(width - left - right, 0.2 * width), max(height - bottom - top, 0.2 * height)
    (x0, y0, x1, y1), heights = picture.focus, picture.z_range
    centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, sum(heights) / 2])
    if view == "top":
        scale = max((x1 - x0) / free[0], (y1 - y0) / free[1])  # metres a pixel
        centre[:2] += scale / 2 * np.array([right - left, top - bottom])
        # A hair south of straight down: turning the view from here keeps z upright.
        return _looking(centre, (0.0, -1e-4, 1.0), scale * height, 0.0 if fov is None else fov)
    fov = math.radians(35) if fov is None else fov
    corners = _corners(picture, view)
    centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
    camera = _looking(centre, BIRD, float(np.ptp(corners, axis=0).max()), fov)
    middle = np.array([(left + width - right) / 2, (top + height - bottom) / 2])
    for _ in range(6):  # perspective makes size and place on the image no simple function of the distance
        seen = project(camera, (width, height), corners)
        taken = np.ptp(seen, axis=0) / free
        off = ((seen.min(axis=0) + seen.max(axis=0)) / 2 - middle) * camera.height / height
        centre = centre + off @ _image_axes(camera)
        camera = _looking(centre, BIRD, AROUND[view] * camera.height * float(taken.max()), fov)
    return camera


def _corners(picture: Picture, view: str) -> np.ndarray:
    """Corners (8, 3), metres, of the box that a 3-D view shows."""
    x0, y0, x1, y1 = picture.bounds if view == "3d" else picture.focus
    low, high = (0.0, picture.z_range[1]) if view == "3d" else picture.z_range
    if view == "3d":
        room = [
            part.segments[..., 2].max() for part in picture.lines if part.name.startswith("room") and part.segments.size
        ]
        high = float(max([*room, high]))
    if picture.floor is not None and picture.floor.heights is not None:
        high = max(high, picture.floor.height + float(picture.floor.heights.max()))
    return np.array([(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (low, high)])


def _image_axes(camera: Camera) -> np.ndarray:
    """Directions (2, 3) in the room that lead right and down in the image."""
    forward = np.subtract(camera.look_at, camera.position)
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    return np.stack([right, down / np.linalg.norm(down)])


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
