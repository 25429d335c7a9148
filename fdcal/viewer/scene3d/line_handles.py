"""The two ends of the line of a cut, which a pointer drags over the map."""

from __future__ import annotations

import itertools

import numpy as np
import viser

from ...graphics.glyphs import lift
from ...graphics.markers import drape
from ...graphics.overlays import CUT_RADIUS
from ...graphics.primitives import Floor, Picture
from ..gui.binding import Binding
from ..gui.choices import Line
from .picking import DISC_HEIGHT, add_discs, ground_point

DISC_RADIUS = 1.8 * CUT_RADIUS  # in radii of a marker


class LineHandles:
    """Owns the discs at the ends of the line, as long as there is one.

    `binding`: whose `choices.cut` is the line; `picture`: as drawn, for the extent of the search domain and the size of
    the markers; `name`: begins the names of the discs' nodes, a new one for each instance.
    """

    def __init__(self, server: viser.ViserServer, binding: Binding, picture: Picture, name: str = "/cut_ends"):
        self._server, self._binding, self._name = server, binding, name
        self._marker, self._base = picture.marker_radius, picture.z_range[0]
        x0, y0, x1, y1 = picture.focus
        self._low, self._high = np.array([x0, y0]), np.array([x1, y1])
        self._corners = np.array([(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in picture.z_range])
        self._numbers, self._discs, self._shown = itertools.count(), None, np.zeros((0, 3))

    def show(self, line: Line | None, floor: Floor | None) -> None:
        """Put the discs at the ends of a line, or remove them; called by the main loop.

        `line`: its ends, metres, or None; `floor`: the map, on the relief of which they lie, or None.
        """
        if line is None:
            self.remove()
            return
        ends = drape(np.array(line), floor)
        ends = ends if ends.shape[1] == 3 else lift(ends, self._base)
        ends = ends + [0.0, 0.0, 2 * DISC_HEIGHT * self._marker]  # over the discs of the microphones
        if self._discs is None:
            self._add(ends)
        elif not np.array_equal(ends, self._shown):
            self._discs.batched_positions = np.concatenate([ends, self._corners]).astype(np.float32)
        self._shown = ends

    def _add(self, ends: np.ndarray) -> None:
        name = f"{self._name}/{next(self._numbers)}"
        self._discs = add_discs(self._server, name, ends, DISC_RADIUS * self._marker, self._corners)

        @self._discs.on_drag("left")
        async def _(event) -> None:
            self._binding.touch()
            self._drag(event)

    def _drag(self, event) -> None:
        """Move one end to where the line of sight meets the map, inside the search domain."""
        line, end = self._binding.choices.cut, event.instance_index
        if line is None or not isinstance(end, int) or end not in (0, 1) or len(self._shown) != 2:
            return
        eye, point = (np.asarray(at, float) for at in (event.client.camera.position, event.end_position))
        place = ground_point(eye, point, self._shown[end, 2])
        if place is not None:
            x, y = np.clip(place, self._low, self._high).tolist()
            self._binding.choose(cut=((x, y), line[1]) if end == 0 else (line[0], (x, y)))

    def remove(self) -> None:
        """Remove the discs from the scene."""
        if self._discs is not None:
            self._discs.remove()
            self._discs = None
