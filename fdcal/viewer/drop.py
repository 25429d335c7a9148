"""Microphones that a user selects or drags over their map; a released microphone rolls downhill.

An invisible disc, the handle, lies over every estimated position. viser reports the handle that is dragged and the
position of the pointer on a plane that faces the camera. `MicrophonePicker` continues the line of sight through this
position to the height of the microphone. The handles are discs because a busy page sometimes reports NaN for the
pointer on a solid.

While a microphone is dragged, the session does not change. The scene shows the microphone at the pointer, the cost
there and the path downhill, which a thread computes. When the microphone is released, it rolls along the path into the
local minimum, and the session gets one new state at the end. If the map shows no cost, the microphone follows the
pointer in the session.

MicrophonePicker   the handles of the microphones
Drop               the microphone that is dragged or rolls
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from html import escape

import numpy as np
import viser

from ..assessment.words import counted
from ..cost.basins import OUTSIDE, DescentPath, basins_of, descent_path
from ..cost.maps import cost_maps, lattice_of
from ..graphics.glyphs import annuli, lift
from ..graphics.marks import drape
from ..graphics.picture import along, ball_centre
from ..graphics.primitives import Floor, Picture
from ..model.validation import Reals
from ..session.session import SessionView
from ..session.worker import Memo
from .cost_maps import CostMap
from .html import Overlay
from .state import Binding

HANDLE_RADIUS = 1.7  # radius of a handle, in radii of a marker
# Sizes of handles relative to HANDLE_RADIUS:
FIXED = 0.9  # of microphones that cannot be dragged, so that a finger hits the others more easily
BALL = 1.6  # of the ball, which users drag more often than other microphones
SPECK = 1e-3  # of handles that the pointer must not hit: those in the corners of the domain, and all handles at first
HANDLE_HEIGHT = 14 / 24  # height of a handle's centre over the floor, in radii of a marker


ROLL_TIME = 1.4  # time, s, in which a released microphone rolls to its minimum
PATIENCE = 4.0  # time, s, that a released microphone waits for its path; then it stays where it is
CONTINUE = "continue"  # command of the button that runs the solver from where a microphone has come to rest


@dataclass(frozen=True)
class Drag:
    """A microphone that is dragged or was released."""

    microphone: int
    place: tuple[float, ...]  # (D,), metres
    gesture: int
    released: bool = False


@dataclass(frozen=True)
class Descent:
    """The path of a dragged microphone downhill on its map."""

    path: DescentPath
    drawn: CostMap
    reaches_truth: bool | None = None  # whether it ends in the basin of the true position; None: unknown
    distance: float = math.nan  # from the end of the path to the true position, metres; NaN if unknown

    def cost_text(self, index: int) -> str:
        """Return the cost at a point of the path, as a text."""
        return self.drawn.text_of(float(self.path.costs[index]))

    @property
    def text(self) -> str:
        """Where the path ends, in words."""
        edge = "At the edge of the map" if self.path.basin == OUTSIDE else ""
        if self.reaches_truth is None:
            return f"{edge or 'At rest'}, misfit {self.cost_text(-1)}"
        if self.reaches_truth:
            return f"Reached the true position within {math.ceil(1e3 * self.distance)} mm"
        off = f"{1e3 * self.distance:.0f} mm" if self.distance < 0.0995 else f"{1e2 * self.distance:.0f} cm"
        return f"{edge or 'Trapped'}, {off} off"


@dataclass(frozen=True, eq=False)
class MovingMicrophone:
    """A microphone in the scene that is dragged or moves by itself."""

    microphone: int
    place: tuple[float, ...]  # (D,), metres
    text: str  # text beside the microphone
    path: Reals | None = None  # (P, D) float64, metres, its path downhill


class Drop:
    """Owns the drag and the thread of the paths; counts the tries, and those that reached the true position.

    `overlay` shows texts on the canvas.
    """

    def __init__(self, binding: Binding, overlay: Overlay):
        self._binding, self._overlay = binding, overlay
        self._drag: Drag | None = None
        self._droppable = False  # whether the map shows a cost
        self._requested: tuple[Drag, CostMap] | None = None
        self._gesture = -1  # the gesture to which the times below belong
        self._released = self._rolls = math.nan  # time at which the microphone was released, and began to roll, s
        self._placed: tuple[SessionView, float] | None = None  # view of the session, and time, s, when it was placed
        self._ended: object = None  # the state of the session in which the microphone has come to rest
        self._count = 0  # number of states at the last tick
        self._cost = Memo()  # cost of the map, lattice and basins; used by the thread only
        self.tries = self.reached = 0
        self.worker = binding.threads.worker(self._compute, quick=True)
        overlay.acts[CONTINUE] = lambda client, value: binding.tabs.run_bar.toggle()
        overlay.acts["dismiss"] = lambda client, value: overlay.show("words", "")

    def move(self, microphone: int, place, gesture: int, released: bool) -> None:
        """Drag a microphone to a position, (2,) or (3,), metres, or release it there; on viser's event loop."""
        binding = self._binding
        current = self._drag if self._drag is not None and self._drag.gesture == gesture else None
        if current is None and not self._droppable:
            self.place(microphone, place, gesture, released)
            return
        if current is None:
            binding.session.pause()
            if binding.choices.follow or binding.choices.microphone != microphone:
                binding.tabs.map.pick(microphone)
        at = tuple(float(x) for x in place)
        here = current.place if current else binding.frame.positions(binding.session.view.state.positions)[microphone]
        at += tuple(float(x) for x in here[len(at) :])  # the height stays if the pointer gives none
        self._drag = Drag(microphone, at, gesture, released)
        binding.choose()

    def place(self, microphone: int, place, gesture: int, released: bool) -> None:
        """Move a microphone in the session at once, and end a drag in progress."""
        self._drag = None
        self._binding.place(microphone, place, gesture)

    @property
    def inviting(self) -> bool:
        """Whether the microphone of the map can be dragged, and nothing has moved in the session."""
        binding, view = self._binding, self._binding.session.view
        free = binding.choices.microphone not in binding.measurement.known
        return free and self._droppable and self._drag is None and view.count == 1 and not view.running

    # The main loop calls the methods below.

    def tick(self, view: SessionView, drawn: CostMap | None, now: float) -> MovingMicrophone | None:
        """Return the microphone that is dragged or rolls, at the time `now`, s; None if there is none."""
        self._droppable = drawn is not None and drawn.request.style.kind != "shape"
        if view.count == 1 and self._count > 1:
            self.tries = self.reached = 0
            self._say("")
        elif view.running or (self._drag is None and self._ended is not None and view.state is not self._ended):
            self._ended = None
            self._say("")  # removes the words, but not the counts
        self._count, drag = view.count, self._drag
        if drag is None:
            return None
        if drawn is not None and self._droppable and drawn.request.microphone == drag.microphone:
            if self._requested is None or self._requested[0] is not drag:
                self._requested = drag, drawn
                self.worker.request(drag, drawn)
        if drag.gesture != self._gesture:
            self._gesture, self._placed = drag.gesture, None
            self._released = self._rolls = math.nan
        latest = self.worker.latest
        of_drag = latest is not None and latest.request[0].gesture == drag.gesture
        descent: Descent | None = latest.result if latest is not None and of_drag else None
        if drag.released:  # the microphone rolls along the path that begins where it was released
            final = latest is not None and latest.request[0] is drag
            return self._rolling(view, drag, descent if final else None, now)
        text = "" if descent is None else descent.cost_text(0)
        self._say(f"Misfit {text}" if text else "")
        return MovingMicrophone(drag.microphone, drag.place, text, None if descent is None else descent.path.points)

    def _rolling(self, view: SessionView, drag: Drag, descent: Descent | None, now: float) -> MovingMicrophone:
        """Return a released microphone as it is shown at the time `now`; end the drag when it has come to rest."""
        if math.isnan(self._released):
            self._released = now
        if descent is None:
            if now - self._released > PATIENCE:
                self._rest(view, drag, np.asarray(drag.place), now)
            return MovingMicrophone(drag.microphone, drag.place, "")
        self._rolls = now if math.isnan(self._rolls) else self._rolls
        fraction, height = min((now - self._rolls) / ROLL_TIME, 1.0), drag.place[len(descent.path.points[0]) :]
        end = np.append(descent.path.points[-1], height)
        if fraction < 1:
            place = along(descent.path.points, fraction)
            self._say("Misfit " + descent.cost_text(int(np.linalg.norm(descent.path.points - place, axis=1).argmin())))
            return MovingMicrophone(drag.microphone, (*place.tolist(), *height), "", descent.path.points)
        if self._rest(view, drag, end, now):
            if descent.reaches_truth is not None:
                self.tries, self.reached = self.tries + 1, self.reached + descent.reaches_truth
            self._say(descent.text, ended=True)
        return MovingMicrophone(drag.microphone, tuple(end.tolist()), descent.text)

    def _rest(self, view: SessionView, drag: Drag, end: np.ndarray, now: float) -> bool:
        """Move the microphone in the session to where it has come to rest; return whether this was the first call.

        The drag ends with the next view of the session, unless another one has begun.
        """
        if self._placed is None:
            self._placed = view, now
            self._binding.place(drag.microphone, end)
            return True
        before, since = self._placed
        if self._drag is drag and (view is not before or now - since > PATIENCE):
            # An answer of the session after PATIENCE must not count as another change, which would remove the words.
            self._drag, self._ended = None, view.state if view is not before else None
        return False

    def _say(self, words: str, ended: bool = False) -> None:
        """Show words on the canvas, with the number of tries below, and a button to continue if the drag has ended."""
        text, kind = f"<div>{escape(words)}</div>" if words else "", ""
        if self.tries:
            kind = 'class="first"'
            text += f"<p>{self.reached} of {counted(self.tries, 'drop')} reached the true position</p>"
        text += f'<button {kind} data-do="{CONTINUE}">Continue from here</button>' if ended else ""
        self._overlay.show("words", text)

    def _compute(self, drag: Drag, drawn: CostMap) -> Descent:
        """Return the path of a microphone downhill from its position, by the cost of the map; on the thread."""
        run, request = self._binding.run, drawn.request
        if (found := self._cost.get(request, drawn.fine)) is None:
            if drawn.sampled is not None:
                cost, search = drawn.sampled.cost, drawn.sampled.search
            else:
                n, modes, order = request.microphone, request.modes, request.order_offset
                search = lattice_of(run.problem, modes)  # fine enough for the minima of the map
                cost = cost_maps(run.problem, run.solver, request.state, n, modes, order, search).sum(axis=0)
            found = self._cost.keep((cost, search, basins_of(cost)), request, drawn.fine)
        cost, search, basins = found
        path = descent_path(cost, search, basins, np.asarray(drag.place)[: cost.ndim])
        truth = run.measurement.positions
        if truth is None or run.measurement.nominal:
            return Descent(path, drawn)
        place, end = truth[drag.microphone], np.append(path.points[-1], drag.place[cost.ndim :])
        reaches_truth = path.basin >= 0 and basins.at(search, place[: cost.ndim]) == path.basin
        # On the map of a layer the height must agree as well.
        reaches_truth = reaches_truth and np.abs(end - place)[cost.ndim :].max(initial=0.0) <= search.step
        return Descent(path, drawn, bool(reaches_truth), float(np.linalg.norm(end - place)))


NUMBERS = itertools.count()  # for the names of the handles' nodes, which must differ
Move = Callable[[int, np.ndarray, int, bool], None]  # gets microphone, position, gesture, and whether it ends


class MicrophonePicker:
    """Owns the handles. With Shift a microphone stays where it is released.

    `picture` determines the extent of the search domain and the size of the markers. `drop` gets each microphone that
    is dragged.
    """

    def __init__(self, server: viser.ViserServer, binding: Binding, picture: Picture, drop: Drop):
        self._binding, self._picture = binding, picture
        self._count, self._marker = binding.measurement.count, picture.marker_radius
        self._movable = ~np.isin(np.arange(self._count), binding.run.problem.known)  # a known microphone stays
        self._gestures = itertools.count()
        self._gesture: dict[int, int] = {}  # number of the gesture of each page on which a microphone is dragged
        self._last: dict[int, tuple[Move, int, np.ndarray]] = {}  # the last move of each of these pages
        x0, y0, x1, y1 = picture.focus
        edge = 0.0 if binding.measurement.search is None else binding.measurement.search.step / 2
        z0, z1 = picture.z_range
        self._low, self._high = np.array([x0 + edge, y0 + edge, z0]), np.array([x1 - edge, y1 - edge, z1])
        # The browser looks for handles only inside the box that they spanned at first. Handles in the corners of the
        # search domain make this box large enough.
        corners = np.array([(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in picture.z_range])
        self._shown = np.concatenate([np.tile(corners[0], (self._count, 1)), corners])
        vertices, faces = annuli(np.zeros((1, 3)), HANDLE_RADIUS * self._marker / 2, HANDLE_RADIUS * self._marker, 12)
        self.handles = handles = server.scene.add_batched_meshes_simple(
            f"/picking/{next(NUMBERS)}", vertices, faces,
            np.tile([1.0, 0.0, 0.0, 0.0], (len(self._shown), 1)), self._shown,
            batched_scales=np.full(len(self._shown), SPECK), opacity=0.0, side="double", lod="off",
            cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

        @handles.on_click
        async def _(event) -> None:
            if event.instance_index in range(self._count):
                binding.tabs.map.pick(event.instance_index)

        handles.on_drag("left")(partial(self._drag, drop.move))
        handles.on_drag("left", modifier="shift")(partial(self._drag, drop.place))

    async def _drag(self, move: Move, event) -> None:
        """Move a microphone to the point of the line of sight at its height, within the search domain."""
        if event.phase == "start":
            self._gesture[event.client_id] = next(self._gestures)
        index, gesture = event.instance_index, self._gesture.get(event.client_id)
        if gesture is None or index not in range(self._count) or not self._movable[index]:
            return
        eye, point = (np.asarray(at, float) for at in (event.client.camera.position, event.end_position))
        level, sight = float(self._shown[index, 2]), point - eye
        # A line of sight meets the height of the microphone only if it goes down. NaN from a busy page fails this, too.
        if level < eye[2] and sight[2] < -1e-9 * np.linalg.norm(sight):
            place = (eye + sight * ((level - eye[2]) / sight[2]))[:2]
            place = np.clip(place, self._low[:2], self._high[:2])
            self._last[event.client_id] = move, index, place
            if event.phase != "end":
                move(index, place, gesture, False)
        if event.phase == "end":
            self.forget(event.client_id)

    def forget(self, client_id: int) -> None:
        """Release the microphone that a page drags, when the pointer is released or the page is closed."""
        gesture, last = self._gesture.pop(client_id, None), self._last.pop(client_id, None)
        if gesture is not None and last is not None:
            move, index, place = last
            move(index, place, gesture, True)

    def show(self, positions, floor: Floor | None, ball: int | None = None) -> None:
        """Move the handles to the estimated positions; called by the main loop.

        `positions` (N, D) float64, metres; `floor`: the map, or None; `ball`: the microphone that is drawn as a ball,
        or None.
        """
        places, sizes = self._shown.copy(), np.full(len(self._shown), SPECK)
        points = drape(positions, floor, self._marker)
        points = points if points.shape[1] == 3 else lift(points, self._picture.z_range[0])
        places[: self._count] = points + [0.0, 0.0, HANDLE_HEIGHT * self._marker]
        sizes[: self._count] = np.where(self._movable, 1.0, FIXED)
        if ball is not None:
            places[ball], sizes[ball] = ball_centre(self._picture, positions[ball], floor), BALL
        self._shown = places
        self.handles.batched_scales, self.handles.batched_positions = (
            sizes.astype(np.float32),
            places.astype(np.float32),
        )
