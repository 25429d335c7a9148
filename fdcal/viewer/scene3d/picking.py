"""Microphones selected and dragged in the scene, and the two ends of the line of a cut.

An invisible disc, a handle, lies over every estimated position and every end, that of the ball across its middle. viser
reports which one the pointer took and where the pointer is, on a plane that faces the camera; here that becomes a
position at the height of what is dragged. Solids in place of discs do not do: from these a busy page reports at times
that the pointer is nowhere (NaN).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import viser

from ...graphics.glyphs import annuli, lift
from ...graphics.marks import drape
from ...graphics.overlays import CUT_RADIUS, ball_centre
from ...graphics.primitives import Floor, Picture
from ..gui.binding import Binding, Line

HANDLE_RADIUS = 1.7  # in radii of a marker
FIXED = 0.9  # size of the handles of microphones that cannot be dragged, of the others: a finger rather takes those
BALL = 1.6  # size of the handle of the ball, likewise: it is what a pointer looks for
SPECK = 1e-3  # size of what stands in the corners of the search domain, likewise
HANDLE_HEIGHT = 14 / 24  # of its middle over the floor, in radii of a marker


Move = Callable[[int, np.ndarray, int, bool], None]  # microphone, place, number of the gesture, whether it was let go


class MicrophonePicker:
    """Owns the handles. With Shift a microphone stays where it is let go.

    `binding`: of the session; `picture`: as drawn, for the extent of the search domain and the size of the markers;
    `select`: called with the number of the microphone that was clicked; `move`: called with the number of one that is
    dragged, its place, metres, the number of the gesture, and whether it was let go; `place`: likewise, with Shift;
    `name`: of the handles' node, a new one for each instance.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        binding: Binding,
        picture: Picture,
        select: Callable[[int], None],
        move: Move,
        place: Move,
        name: str = "/picking",
    ):
        self._binding, self._picture = binding, picture
        self._select, self._move, self._place = select, move, place
        self._marker, self._base, self._across = picture.marker_radius, picture.z_range[0], 2
        self._shown: np.ndarray | None = None
        self._gestures = itertools.count()
        self._gesture: dict[int, int] = {}  # number of the gesture of each page that drags
        self._last: dict[int, tuple[Move, int, np.ndarray]] = {}  # of each of them: the last move
        x0, y0, x1, y1 = picture.focus
        edge = 0.0 if binding.measurement.search is None else binding.measurement.search.step / 2
        z0, z1 = picture.z_range
        self._low, self._high = np.array([x0 + edge, y0 + edge, z0]), np.array([x1 - edge, y1 - edge, z1])
        self._corners = np.array([(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in picture.z_range])
        start = np.tile(self._corners[0], (binding.measurement.count, 1))
        self._handles = handles = add_handles(server, name, start, HANDLE_RADIUS * self._marker, self._corners)
        self._sized: np.ndarray | None = None  # the sizes that were sent last

        @handles.on_click
        async def _(event) -> None:
            if self._exists(event.instance_index):
                self._select(event.instance_index)

        @handles.on_drag("left")
        async def _(event) -> None:
            self._drag(event, self._move)

        @handles.on_drag("left", modifier="shift")
        async def _(event) -> None:
            self._drag(event, self._place)

    def _exists(self, index) -> bool:
        return isinstance(index, int) and 0 <= index < self._binding.measurement.count

    def _movable(self, index) -> bool:
        """Whether a microphone may be dragged: a known one stays, unless it is released or only planned."""
        binding, choices = self._binding, self._binding.choices
        free = choices.release or choices.plan.shown
        return self._exists(index) and (free or index not in binding.run.problem.known)

    def _drag(self, event, move: Move) -> None:
        """Move the microphone to where the line of sight meets its height, or its slice, inside the search domain."""
        if event.phase == "start":
            self._gesture[event.client_id] = next(self._gestures)
        index, gesture = event.instance_index, self._gesture.get(event.client_id)
        if not self._movable(index) or gesture is None:
            return
        eye, point = (np.asarray(at, float) for at in (event.client.camera.position, event.end_position))
        here = self._corners[0] if self._shown is None else self._shown[index]
        place = plane_point(eye, point, float(here[self._across]), self._across)
        if place is not None:
            place = np.clip(place, self._low[: len(place)], self._high[: len(place)])
            self._last[event.client_id] = move, index, place
            if event.phase != "end":
                move(index, place, gesture, False)
        if event.phase == "end":
            self.forget(event.client_id)

    def forget(self, client_id: int) -> None:
        """Let go what a page drags, at its last place: it has let go, perhaps beside the map, or has closed."""
        gesture, last = self._gesture.pop(client_id, None), self._last.pop(client_id, None)
        if gesture is not None and last is not None:
            move, index, place = last
            move(index, place, gesture, True)

    def remove(self) -> None:
        """Remove the handles from the scene."""
        self._handles.remove()

    def show(self, positions, floor: Floor | None, across: int = 2, ball: int | None = None) -> None:
        """Move the handles to the estimated positions; called by the main loop.

        `positions` (N, D) float64, metres; `floor`: the map, on the relief of which they stand, or None; `across`: axis
        across the plane in which microphones are dragged; `ball`: the one that is drawn as a ball, or None.
        """
        self._across = across
        points = drape(positions, floor, self._marker)
        heights = points[:, 2] if points.shape[1] == 3 else np.full(len(points), self._base)
        handles = np.column_stack([points[:, :2], heights + HANDLE_HEIGHT * self._marker])
        sizes = np.array([1.0 if self._movable(n) else FIXED for n in range(len(handles))])
        if ball is not None:
            handles[ball], sizes[ball] = ball_centre(self._picture, positions[ball], floor), BALL
        if self._sized is None or not np.array_equal(self._sized, sizes):
            self._sized = sizes
            self._handles.batched_scales = np.concatenate([sizes, np.full(len(self._corners), SPECK)]).astype(
                np.float32
            )
        if self._shown is None or not np.array_equal(self._shown, handles):
            self._shown = handles
            self._handles.batched_positions = np.concatenate([handles, self._corners]).astype(np.float32)


def add_handles(server: viser.ViserServer, name: str, places: np.ndarray, radius: float, corners: np.ndarray):
    """Add an invisible handle at each of `places` (P, 3), metres, and specks in the corners of the search domain.

    The browser looks for handles only inside the box that they all spanned at first, so they span the whole search
    domain from the start, under a new name each time.

    `name`: of the node, a new one each time; `radius`: metres; `corners` (C, 3) float64, metres.
    """
    count, specks = len(places), len(corners)
    vertices, faces = annuli(np.zeros((1, 3)), radius / 2, radius, corners=12)
    return server.scene.add_batched_meshes_simple(
        name, vertices, faces, np.tile([1.0, 0.0, 0.0, 0.0], (count + specks, 1)), np.concatenate([places, corners]),
        batched_scales=np.repeat([1.0, SPECK], [count, specks]),
        opacity=0.0, side="double", lod="off", cast_shadow=False, receive_shadow=False,
    )  # fmt: skip


def plane_point(eye: np.ndarray, point: np.ndarray, level: float, axis: int = 2) -> np.ndarray | None:
    """Return where the ray from the eye through `point` meets the plane at `level` across an axis, metres; or None.

    On level ground, on which the eye looks down, (2,); in an upright plane (3,).
    """
    if point.shape != (3,) or not np.isfinite(point).all():
        return None
    along = point - eye
    length = np.linalg.norm(along)
    if along[2] >= -1e-9 * length if axis == 2 else abs(along[axis]) < GRAZING * length:
        return None
    place = eye + along * ((level - eye[axis]) / along[axis])
    place[axis] = level
    ahead = (level - eye[axis]) * along[axis] > 0 and np.isfinite(place).all()
    return (place[:2] if axis == 2 else place) if ahead else None


GRAZING = 0.05  # sine of the angle to a plane below which a pointer meets it nowhere in particular
END_RADIUS = 1.8 * CUT_RADIUS  # in radii of a marker


class LineHandles:
    """Owns the handles at the ends of the line, as long as there is one.

    `binding`: whose `choices.cut` is the line; `picture`: as drawn, for the extent of the search domain and the size of
    the markers; `name`: begins the names of the handles' nodes, a new one for each instance.
    """

    def __init__(self, server: viser.ViserServer, binding: Binding, picture: Picture, name: str = "/cut_ends"):
        self._server, self._binding, self._name = server, binding, name
        self._marker, self._base = picture.marker_radius, picture.z_range[0]
        x0, y0, x1, y1 = picture.focus
        self._low, self._high = np.array([x0, y0]), np.array([x1, y1])
        self._corners = np.array([(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in picture.z_range])
        self._numbers, self._handles, self._shown = itertools.count(), None, np.zeros((0, 3))

    def show(self, line: Line | None, floor: Floor | None) -> None:
        """Put the handles at the ends of a line, or remove them; called by the main loop.

        `line`: its ends, metres, or None; `floor`: the map, on the relief of which they lie, or None.
        """
        if line is None:
            self.remove()
            return
        ends = drape(np.array(line), floor)
        ends = ends if ends.shape[1] == 3 else lift(ends, self._base)
        ends = ends + [0.0, 0.0, 2 * HANDLE_HEIGHT * self._marker]  # over the handles of the microphones
        if self._handles is None:
            name, radius = f"{self._name}/{next(self._numbers)}", END_RADIUS * self._marker
            self._handles = add_handles(self._server, name, ends, radius, self._corners)

            @self._handles.on_drag("left")
            async def _(event) -> None:
                self._drag(event)

        elif not np.array_equal(ends, self._shown):
            self._handles.batched_positions = np.concatenate([ends, self._corners]).astype(np.float32)
        self._shown = ends

    def _drag(self, event) -> None:
        """Move one end to where the line of sight meets the map, inside the search domain."""
        line, end = self._binding.choices.cut, event.instance_index
        if line is None or not isinstance(end, int) or end not in (0, 1) or len(self._shown) != 2:
            return
        eye, point = (np.asarray(at, float) for at in (event.client.camera.position, event.end_position))
        place = plane_point(eye, point, float(self._shown[end, 2]))
        if place is not None:
            x, y = np.clip(place, self._low, self._high).tolist()
            self._binding.choose(cut=((x, y), line[1]) if end == 0 else (line[0], (x, y)))

    def remove(self) -> None:
        """Remove the handles from the scene."""
        if self._handles is not None:
            self._handles.remove()
            self._handles = None
