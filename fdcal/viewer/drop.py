"""A microphone that is dragged over its map, and let go: it rolls downhill into the local minimum below it.

While it is dragged, nothing of the session changes: the scene shows the microphone at the pointer, the cost there and
the path downhill, which a thread computes. When it is let go it rolls along the path, and the session gets one new
state at its end. Where no cost is shown, the microphone follows the pointer in the session.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..cost.basins import OUTSIDE, Basins, DescentPath, basins_of, descent_path
from ..cost.maps import cost_maps, lattice_of
from ..graphics.overlays import along
from ..model.settings import Search
from ..model.validation import Reals
from ..session.session import SessionView
from .cost_maps import CostMap
from .gui.binding import Binding
from .gui.overlay import NO_BUTTONS, CanvasWords
from .prepare import Last

ROLL_TIME = 1.4  # s from where the microphone is let go to its minimum
PATIENCE = 4.0  # s that a microphone waits for its path; after that it stays where it was let go
CONTINUE = "Continue from here"


@dataclass(frozen=True)
class Drag:
    """A microphone in somebody's hand, or let go."""

    microphone: int
    place: tuple[float, ...]  # (D,), metres
    gesture: int
    released: bool = False


@dataclass(frozen=True)
class Fall:
    """Where a dragged microphone falls."""

    path: DescentPath
    decibels: bool  # whether the cost has them
    home: bool | None = None  # whether the path ends in the basin of the true position; None where that is unknown
    distance: float = math.nan  # from its end to the true position, metres; NaN likewise

    def cost_text(self, index: int) -> str:
        """The cost at a point of the path, as a text."""
        cost = float(self.path.costs[index])
        return f"{10 * math.log10(max(cost, 1e-16)):.1f} dB" if self.decibels else f"{cost:.4g}"

    @property
    def text(self) -> str:
        """Where it has come to rest, in words."""
        edge = "at the edge of the map" if self.path.basin == OUTSIDE else ""
        if self.home is None:
            return f"{edge or 'rest'}, cost {self.cost_text(-1)}"
        off = f"{1e3 * self.distance:.0f} mm" if self.distance < 0.0995 else f"{1e2 * self.distance:.0f} cm"
        return f"{edge or ('home' if self.home else 'trapped')}, {off} off"


@dataclass(frozen=True, eq=False)
class Dropped:
    """What the scene shows of a microphone that is dragged or rolls."""

    microphone: int
    place: tuple[float, ...]  # (D,), metres
    text: str  # beside it
    path: Reals | None = None  # (P, D) float64, metres, downhill

    def among(self, positions) -> np.ndarray:
        """Return positions (N, D), metres, with the microphone at its place."""
        placed = np.array(positions, float)
        placed[self.microphone, : len(self.place)] = self.place
        return placed


class Drop:
    """Owns the drag, the thread of the paths, and the counts of tries and of those that ended at home.

    `select`: shows the map of a microphone; `follow`: that of the modes that the solver uses; `words`: on the canvas,
    or None.
    """

    def __init__(
        self,
        binding: Binding,
        select: Callable[[int], None],
        follow: Callable[[], None],
        words: CanvasWords | None = None,
    ):
        self._binding, self._select, self._follow, self._words = binding, select, follow, words
        self._drag: Drag | None = None
        self._droppable = False  # whether the map shows a cost
        self._asked: tuple[Drag, CostMap] | None = None
        self._gesture = -1  # whose times follow
        self._released = self._rolls = math.nan  # when the microphone was let go, and began to roll, s
        self._placed: tuple[SessionView, float] | None = None  # when the session was sent the end: its view, and s
        self._count = 0  # states of the history at the last tick
        self._cost = Last()  # of the map; of the thread alone
        self.tries = self.home = 0
        self.worker = binding.threads.start(self._compute, "fdcal-drop", wakes=True)

    def move(self, microphone: int, place, gesture: int, released: bool) -> None:
        """Drag a microphone to a place, (2,) or (3,), metres, or let it go there; on viser's event loop."""
        binding = self._binding
        held = self._drag if self._drag is not None and self._drag.gesture == gesture else None
        if held is None and (not self._droppable or binding.choices.plan.shown):
            self.place(microphone, place, gesture, released)
            return
        if held is None:
            binding.session.pause()
            if binding.choices.follow or binding.choices.microphone != microphone:
                self._select(microphone)
        at = tuple(float(x) for x in place)
        here = binding.positions[microphone] if held is None else held.place
        at += tuple(float(x) for x in here[len(at) :])  # the height, where the pointer gives none
        self._drag = Drag(microphone, at, gesture, released)
        binding.choose()

    def place(self, microphone: int, place, gesture: int, released: bool) -> None:
        """Move a microphone in the session at once; what was dragged or rolls stays where the session has it."""
        self._drag = None
        self._binding.place(microphone, place, gesture)

    @property
    def inviting(self) -> bool:
        """Whether the microphone of the map can be dragged, and nothing has moved in the session."""
        binding, view = self._binding, self._binding.session.view
        free = binding.choices.release or binding.choices.microphone not in binding.measurement.known
        return free and self._droppable and self._drag is None and view.count == 1 and not view.running

    # Below: the main loop.

    def tick(self, view: SessionView, drawn: CostMap | None, now: float) -> Dropped | None:
        """Return what the scene shows of the microphone at the time `now`, s; None where nothing is dragged."""
        self._droppable = drawn is not None and not drawn.request.style.shape
        if view.count == 1 and self._count > 1:
            self.tries = self.home = 0
            self._say("")
        elif view.running and self.tries:
            self._say("")  # the counts remain
        self._count, drag = view.count, self._drag
        if drag is None:
            return None
        if drawn is not None and self._droppable and drawn.request.microphone == drag.microphone:
            if self._asked is None or self._asked[0] is not drag:
                self._asked = drag, drawn
                self.worker.request(drag, drawn)
        if drag.gesture != self._gesture:
            self._gesture, self._placed = drag.gesture, None
            self._released = self._rolls = math.nan
        fall, final = self._newest(drag)
        if drag.released:
            return self._rolling(view, drag, fall if final else None, now)
        text = "" if fall is None else fall.cost_text(0)
        self._say(text)
        return Dropped(drag.microphone, drag.place, text, None if fall is None else fall.path.points)

    def _newest(self, drag: Drag) -> tuple[Fall | None, bool]:
        """Return the newest path of a drag, and whether it begins where the microphone is now."""
        latest = self.worker.latest
        if latest is None or latest.request[0].gesture != drag.gesture or latest.result is None:
            return None, False
        return latest.result, latest.request[0] is drag

    def _rolling(self, view: SessionView, drag: Drag, fall: Fall | None, now: float) -> Dropped:
        """Return what is shown of a microphone that was let go; end the drag when it has come to rest."""
        if math.isnan(self._released):
            self._released = now
        if fall is None:
            if now - self._released > PATIENCE:
                self._rest(view, drag, np.asarray(drag.place), now)
            return Dropped(drag.microphone, drag.place, "")
        self._rolls = now if math.isnan(self._rolls) else self._rolls
        share, height = min((now - self._rolls) / ROLL_TIME, 1.0), drag.place[len(fall.path.points[0]) :]
        end = np.append(fall.path.points[-1], height)
        if share < 1:
            place = along(fall.path.points, share)
            self._say(fall.cost_text(int(np.linalg.norm(fall.path.points - place, axis=1).argmin())))
            return Dropped(drag.microphone, (*place.tolist(), *height), "", fall.path.points)
        if self._rest(view, drag, end, now):
            if fall.home is not None:
                self.tries, self.home = self.tries + 1, self.home + fall.home

            def run_on() -> None:
                """Run the solver from the present state; the map is that of the modes it uses."""
                self._say("")
                self._follow()
                self._binding.session.play()

            self._say(fall.text, {CONTINUE: run_on})
        return Dropped(drag.microphone, tuple(end.tolist()), fall.text)

    def _rest(self, view: SessionView, drag: Drag, end: np.ndarray, now: float) -> bool:
        """Tell the session once where the microphone has come to rest, and return whether this was the time.

        The drag ends with the next view of the session, unless another one has begun.
        """
        if self._placed is None:
            self._placed = view, now
            self._binding.place(drag.microphone, end)
            return True
        before, since = self._placed
        if self._drag is drag and (view is not before or now - since > PATIENCE):
            self._drag = None
        return False

    def _say(self, words: str, buttons=NO_BUTTONS) -> None:
        if self._words is not None:
            counts = "" if not self.tries else f"{self.home} of {self.tries} home"
            self._words.show(words, counts, buttons)

    def close(self) -> None:
        """Take the words away."""
        self.tries = 0
        self._say("")

    # Below: the thread.

    def _compute(self, drag: Drag, drawn: CostMap) -> Fall:
        """Return where a microphone falls from its place, by the cost that a map shows."""
        run, request = self._binding.run, drawn.request

        def make() -> tuple[np.ndarray, Search, Basins]:
            if drawn.sampled is not None:
                cost, search = drawn.sampled.cost, drawn.sampled.search
            else:
                n, modes, order = request.microphone, request.modes, request.order_offset
                search = lattice_of(run.problem, modes)  # that has the minima marked on it
                cost = cost_maps(run.problem, run.solver, request.state, n, modes, order, search).sum(axis=0)
            return cost, search, basins_of(cost)

        cost, search, basins = self._cost.of(make, request, drawn.fine)
        path = descent_path(cost, search, basins, np.asarray(drag.place)[: cost.ndim])
        decibels = request.order_offset is not None
        truth = self._binding.frame.truth(request.state.positions)
        if truth is None or run.measurement.nominal:
            return Fall(path, decibels)
        place, end = truth[drag.microphone], np.append(path.points[-1], drag.place[cost.ndim :])
        home = path.basin >= 0 and basins.at(search, place[: cost.ndim]) == path.basin
        home = home and np.abs(end - place)[cost.ndim :].max(initial=0.0) <= search.step  # at its height in a layer
        return Fall(path, decibels, bool(home), float(np.linalg.norm(end - place)))
