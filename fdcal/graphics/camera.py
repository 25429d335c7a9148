"""The camera of a picture, and the pixel at which a point of the picture appears."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np

from ..model.address import View
from ..model.validation import require_choice
from .primitives import Picture

VIEWS = get_args(View)
MARGIN = {"3d": 1.06, "close": 1.06}  # ratio of the view's size to that of the room, or of the domain with rulers
OBLIQUE = (-0.38, -0.8, 1.05)  # direction from the centre to the eye of the 3-D views
FOV_3D = 35.0  # degrees
REFINEMENTS = 6  # iterations for the 3-D view, in which the size in the image is nonlinear in the distance


@dataclass(frozen=True)
class Camera:
    """An eye at a position that looks at a point."""

    # position, look_at: (3,), metres
    position: tuple[float, float, float]
    look_at: tuple[float, float, float]
    up: tuple[float, float, float]  # (3,)
    fov: float  # vertical field of view, radians; 0 for parallel projection
    height: float  # height of the visible part of the scene at `look_at`, metres


def camera_for(
    picture: Picture, size: tuple[int, int], view: str, margins=(0, 0, 0, 0), fov: float | None = None
) -> Camera:
    """Return the camera that fills an image with a picture.

    `view`: "top" (north up, the search domain fills the image), "3d" (the whole room) or "close" (the array alone);
    `margins`: pixels to be left free at the left, bottom, right and top; `fov`: field of view, radians; by default the
    projection from the top is parallel.
    """
    require_choice("view", view, VIEWS)
    width, height = (max(int(length), 1) for length in size)
    left, bottom, right, top = margins
    free = max(width - left - right, 0.2 * width), max(height - bottom - top, 0.2 * height)
    if view == "top":
        (x0, y0, x1, y1), z_range = picture.focus, picture.z_range
        centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, sum(z_range) / 2])
        scale = max((x1 - x0) / free[0], (y1 - y0) / free[1])  # metres per pixel
        centre[:2] += scale / 2 * np.array([right - left, top - bottom])
        # The eye is slightly south of the centre, so that z stays upright when the view is turned.
        return _camera(centre, (0.0, -1e-4, 1.0), scale * height, 0.0 if fov is None else fov)
    middle = np.array([(left + width - right) / 2, (top + height - bottom) / 2])
    fov = math.radians(FOV_3D) if fov is None else fov
    # The view shows the corners of a box; the view "close" shows the numbers of the rulers, too.
    (x0, y0, x1, y1), (low, high) = picture.bounds if view == "3d" else picture.focus, picture.z_range
    heights = [one.segments[..., 2].max() for one in picture.lines if one.name.startswith("room") and one.segments.size]
    if view == "3d" and heights:  # a room stands on a floor at z = 0; the room of a measurement is unknown
        low, high = 0.0, float(max([*heights, high]))
    if picture.floor is not None and picture.floor.heights is not None:
        high = max(high, picture.floor.height + float(picture.floor.heights.max()))
    box = [(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (low, high)]
    numbers = [label.position for label in picture.labels if label.name.startswith("frame/")]
    corners = np.array([*box, *numbers] if view == "close" else box)
    centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
    camera = _camera(centre, OBLIQUE, float(np.ptp(corners, axis=0).max()), fov)
    for _ in range(REFINEMENTS):
        pixels = project(camera, (width, height), corners)
        fill = np.ptp(pixels, axis=0) / free
        offset = ((pixels.min(axis=0) + pixels.max(axis=0)) / 2 - middle) * camera.height / height
        right_axis, up, _ = _axes(camera)
        centre = centre + offset @ np.stack([right_axis, -up])
        camera = _camera(centre, OBLIQUE, MARGIN[view] * camera.height * float(fill.max()), fov)
    return camera


def _axes(camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the unit vectors (3,) in the room that point right, up and away in the image."""
    forward = np.subtract(camera.look_at, camera.position)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    return right, np.cross(right, forward), forward


def _camera(centre: np.ndarray, direction, height: float, fov: float) -> Camera:
    """Return a camera that looks at `centre` (3,) from `direction` (3,) and sees `height` metres there."""
    distance = height / 2 / math.tan(fov / 2) if fov else 2 * height
    x, y, z = (centre + distance * (np.array(direction) / np.linalg.norm(direction))).tolist()
    return Camera((x, y, z), (float(centre[0]), float(centre[1]), float(centre[2])), (0.0, 0.0, 1.0), fov, height)


def project(camera: Camera, size: tuple[int, int], points, lifts: Sequence[float] | float = 0.0) -> np.ndarray:
    """Return the pixels (P, 2), column and row from the upper left corner, at which points (P, 3), metres, appear.

    `lifts`: distance by which each point is moved up in the image, metres.
    """
    width, height = size
    offset = np.atleast_2d(np.asarray(points, float)) - camera.position
    across, upward, depth = (offset @ axis for axis in _axes(camera))
    visible = camera.height if not camera.fov else 2 * depth * math.tan(camera.fov / 2)  # metres in the image's height
    pixels = height / visible
    return np.stack([width / 2 + across * pixels, height / 2 - (upward + lifts) * pixels], axis=1)
