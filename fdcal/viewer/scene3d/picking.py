"""Microphones picked and dragged in the scene: a click looks at one, a drag moves its supposed position.

An unseen disc lies over every supposed position. viser tells which one the pointer took and where it leads, on a plane
that faces the camera; here that becomes a place at the height where the microphone is.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import viser

from ...graphics.glyphs import annuli
from ...graphics.picture import drape
from ...graphics.primitives import Floor, Picture
from ..gui.binding import Binding

REACH = 1.7  # radius of a disc, in radii of a marker
ABOVE = 14 / 24  # height of the discs over the floor, in radii of a marker: over all that is drawn


class Hands:
    """Owns the discs."""

    def __init__(
        self,
        server: viser.ViserServer,
        binding: Binding,
        picture: Picture,
        choose: Callable[[int], None],
        name: str = "/hands",
    ):
        self._binding, self._choose, self._marker, self._base = binding, choose, picture.marker, picture.heights[0]
        self._shown: np.ndarray | None = None
        self._gestures = itertools.count()
        self._gesture: dict[int, int] = {}  # of each page that drags
        x0, y0, x1, y1 = picture.focus
        edge = 0.0 if binding.measurement.search is None else binding.measurement.search.step / 2
        self._low, self._high = np.array([x0 + edge, y0 + edge]), np.array([x1 - edge, y1 - edge])
        corners = np.array([(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in picture.heights])
        self._corners = corners
        self._discs = self._add_discs(server, name)

    def _add_discs(self, server: viser.ViserServer, name: str):
        """One disc a microphone, and specks in the corners: the browser looks for discs only inside of what they all
        spanned when it first did, so they must span the whole search domain from the start, each time under a new
        name."""
        radius, count, specks = REACH * self._marker, self._binding.measurement.count, len(self._corners)
        vertices, faces = annuli(np.zeros((1, 3)), radius / 2, radius, corners=12)
        places = np.concatenate([np.tile(self._corners[0], (count, 1)), self._corners])
        discs = server.scene.add_batched_meshes_simple(
            name, vertices, faces, np.tile([1.0, 0.0, 0.0, 0.0], (count + specks, 1)), places,
            batched_scales=np.repeat([1.0, 1e-3], [count, specks]),
            opacity=0.0, side="double", lod="off", cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

        @discs.on_click
        async def _(event) -> None:
            if self._is_there(event.instance_index):
                self._choose(event.instance_index)

        @discs.on_drag("left")
        async def _(event) -> None:
            self._drag(event)

        return discs

    def _is_there(self, index) -> bool:
        return isinstance(index, int) and 0 <= index < self._binding.measurement.count

    def _drag(self, event) -> None:
        """Put the microphone where the pointer meets the floor, inside the search domain."""
        if event.phase == "start":
            self._gesture[event.client_id] = next(self._gestures)
        if not self._is_there(event.instance_index) or event.client_id not in self._gesture:
            return
        level = self._base if self._shown is None else self._shown[event.instance_index, 2]
        eye, point = (np.asarray(at, float) for at in (event.client.camera.position, event.end_position))
        place = self._on_level(eye, point, level)
        if place is not None:
            self._binding.session.place(
                event.instance_index, np.clip(place, self._low, self._high), self._gesture[event.client_id]
            )
        if event.phase == "end":
            self._gesture.pop(event.client_id, None)

    def _on_level(self, eye: np.ndarray, point: np.ndarray, level: float) -> np.ndarray | None:
        """Where the ray from the eye through `point` comes down to a height : (2,), metres; None where it does not."""
        if point.shape != (3,):
            return None
        along = point - eye
        if not np.isfinite(along).all() or along[2] >= -1e-9 * np.linalg.norm(along):
            return None
        place = (eye + along * ((eye[2] - level) / -along[2]))[:2]
        return place if eye[2] > level and np.isfinite(place).all() else None

    def forget(self, client_id: int) -> None:
        """A page has closed, perhaps in the middle of a drag."""
        self._gesture.pop(client_id, None)

    def remove(self) -> None:
        """Take the discs away."""
        self._discs.remove()

    def show(self, positions, ground: Floor | None) -> None:
        """Bring the discs to the supposed positions (N, D), metres; called by the main loop."""
        points = drape(positions, ground)
        heights = points[:, 2] if points.shape[1] == 3 else np.full(len(points), self._base)
        places = np.column_stack([points[:, :2], heights + ABOVE * self._marker])
        if self._shown is None or not np.array_equal(self._shown, places):
            self._shown = places
            self._discs.batched_positions = np.concatenate([places, self._corners]).astype(np.float32)
