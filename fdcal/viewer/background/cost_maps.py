"""Cost maps, computed on threads of their own; only one that belongs to what is looked at is given out.

A quick thread makes the map over the solver's own lattice, many times a second while a hand drags a microphone; a slow
one makes the same map finely once everything stands still, and gives up as soon as something else is asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ...cost import landscapes
from ...graphics.heatmap import cost_label, paint, paint_field
from ...graphics.picture import heights_of
from ...graphics.primitives import Floor
from ...session.worker import LatestWorker
from .prepare import Work

PAUSE = 0.15  # s at least between two maps while the solver runs, which needs the processor too
FOLLOW = 0.6  # s at least that the map of a microphone stays while a running solver is followed
HELD = 1.0  # s at most that a map stays while a hand drags another microphone and the next map is under way
STILL = 0.35  # s without a change before a fine map is begun


@dataclass(frozen=True)
class Look:
    """How a map is drawn."""

    log: bool = True
    opacity: float = 1.0
    relief: bool = False
    shared: bool = False  # one scale for the maps side by side
    dark: bool = False
    shape: bool = False  # the sound field of the last of the modes instead of a cost


@dataclass(frozen=True)
class MapRequest:
    """A map to be computed. `turn` counts the states seen, which have no cheap equality of their own."""

    turn: int
    microphone: int
    modes: tuple[int, ...]  # counted from 1
    given: bool  # the modes are those that a hand has chosen, not those in use
    look: Look
    follow: bool = field(compare=False)  # any microphone will do, as long as the solver moved it lately
    state: object = field(compare=False)
    lineage: object = field(compare=False)  # of the history that the state belongs to

    def stands_for(self, wanted: MapRequest, running: bool) -> bool:
        """Whether this map may be shown where `wanted` is asked for: while running, an older state's may."""
        if self == wanted or not running:
            return self == wanted
        mine, theirs = (
            (None if wanted.follow else one.microphone, one.modes if one.given else None, one.look)
            for one in (self, wanted)
        )
        return mine == theirs and self.lineage is wanted.lineage

    def differs_in_look(self, wanted: MapRequest) -> bool:
        """Whether `wanted` is this map of costs or field, drawn in another way; its state may be a newer one."""
        alike = self.look.shape == wanted.look.shape and replace(self, look=wanted.look).stands_for(wanted, True)
        return alike and self.look != wanted.look

    def almost(self, wanted: MapRequest) -> bool:
        """Whether `wanted` is the same map but for one microphone's place, as each moment of a drag is."""
        if replace(self, turn=wanted.turn) != wanted:
            return False
        mine, theirs = (np.asarray(one.state.positions) for one in (self, wanted))
        return mine.shape == theirs.shape and np.count_nonzero((mine != theirs).any(axis=1)) <= 1


@dataclass(frozen=True)
class Map:
    """A map that is ready: the floor, what it is made of, and what is to be said of it."""

    request: MapRequest
    floor: Floor
    costs: np.ndarray | None  # (modes, ny, nx), of the single modes, which the floor shows the sum of
    minima: int
    here: float  # cost at the microphone's supposed place
    lowest: float
    fine: bool = False


class Maps:
    """Asks for maps and hands out the newest that fits; all of it on the caller's thread but `_quick` and `_fine`."""

    def __init__(self, work: Work, tell: Callable[[], None] = lambda: None):
        """`tell` is called when there is a new map."""
        self._work, self._asked, self._since = work, None, 0.0
        self._fine_asked: MapRequest | None = None
        self._costs: dict[str, tuple] = {}  # of each thread: what its last costs belong to, and them
        self._worker = LatestWorker(self._quick, "fdcal-map", notify=tell)
        self._slow = LatestWorker(self._fine, "fdcal-fine-map")

    def newest(self, wanted: MapRequest, running: bool, now: float) -> tuple[Map | None, str]:
        """The map to show and, where there is none for it, why. Asks for `wanted` where it is not there yet."""
        latest = self._worker.latest
        pause = 0.0 if latest is None else max(PAUSE, 0.5 * (latest.ended - latest.began))
        if latest is not None and wanted.follow and latest.request[0].microphone != wanted.microphone:
            pause = max(pause, FOLLOW)
        rested = not running or latest is None or now - latest.ended > pause
        rested = rested or not latest.request[0].stands_for(wanted, running)  # a hand has asked for another one
        if running and latest is not None and latest.request[0].differs_in_look(wanted):
            wanted = replace(latest.request[0], look=wanted.look)  # painted anew, of costs that are there
        if wanted != self._asked and rested and not (running and self._worker.busy):
            self._asked, self._since = wanted, now
            self._worker.request(wanted)
        if not running and wanted == self._asked and now - self._since > STILL:
            self._ask_finely(wanted)
        fine = self._slow.latest
        if fine is not None and fine.result is not None and fine.request[0] == wanted:
            return fine.result, ""
        if latest is None:
            return None, ""
        dragged = not running and now - latest.ended < HELD and latest.request[0].almost(wanted)
        if dragged or latest.request[0].stands_for(wanted, running):
            return latest.result, latest.error
        return None, ""

    def _ask_finely(self, wanted: MapRequest) -> None:
        plain = not (wanted.look.relief or wanted.look.shape)
        if plain and wanted != self._fine_asked:
            self._fine_asked = wanted
            self._slow.request(wanted)

    @property
    def busy(self) -> bool:
        """Whether a map is under way."""
        return self._worker.busy or self._slow.busy

    def close(self, timeout: float) -> bool:
        """End the threads after the maps under way."""
        self._asked = None
        return all([self._slow.close(timeout), self._worker.close(timeout)])

    def _quick(self, wanted: MapRequest) -> Map:
        """On the quick thread: a map over the solver's lattice."""
        if wanted.look.shape:
            return self._shape(wanted)
        key = (wanted.turn, wanted.microphone, wanted.modes)
        if self._costs.get("quick", (None,))[0] != key:
            maps = landscapes.each_mode(
                self._work.problem, self._work.solver, wanted.state, wanted.microphone, wanted.modes
            )
            self._costs["quick"] = key, maps, landscapes.local_minima(maps.sum(axis=0))
        _, maps, minima = self._costs["quick"]
        return self._draw(wanted, maps.sum(axis=0), minima, self._work.problem.search, maps)

    def _shape(self, wanted: MapRequest) -> Map:
        """On the quick thread: the sound field of a mode."""
        work, mode = self._work, wanted.modes[-1]
        offset = getattr(wanted.state, "order_offset", 0)
        field = landscapes.mode_shape(work.problem, wanted.state.positions, mode, offset)
        label = f"pressure of mode {mode}, {work.measurement.frequencies[mode - 1]:.1f} Hz (greatest 1)"
        height = heights_of(work.told, work.measurement)[0]
        floor = paint_field(field, work.problem.search, label, height)
        return Map(wanted, floor, None, 0, 0.0, 0.0)

    def _fine(self, wanted: MapRequest) -> Map | None:
        """On the slow thread: the same finely, mode by mode; None as soon as something else is wanted."""
        key = (wanted.turn, wanted.microphone, wanted.modes)
        search = landscapes.finer(self._work.problem.search)
        if self._costs.get("fine", (None,))[0] != key:
            total = 0.0
            work, n = self._work, wanted.microphone
            for mode in wanted.modes:
                if self._asked != wanted:
                    return None
                total = total + landscapes.fine_mode(work.problem, work.solver, wanted.state, n, mode, search)
            self._costs["fine"] = key, total, landscapes.local_minima(total)
        _, total, minima = self._costs["fine"]
        quick = self._worker.latest
        costs = quick.result.costs if quick and quick.result and quick.request[0] == wanted else None
        drawn = self._draw(wanted, total, minima, search, None)
        return replace(drawn, costs=costs, fine=True)

    def _draw(self, wanted: MapRequest, total, minima, search, maps) -> Map:
        look, n = wanted.look, wanted.microphone
        label = cost_label(self._work.scene.solver.weights)
        if self._work.measurement.array_dimension == 3:
            label += f" at z = {wanted.state.positions[n, 2]:.2f} m"
        floor = paint(
            total, search, look.log, label, minima=landscapes.places(minima, search),
            relief=look.relief, height=heights_of(self._work.told, self._work.measurement)[0],
        )  # fmt: skip
        here = landscapes.cost_at(total, search, wanted.state.positions[n])
        return Map(wanted, floor, maps, len(minima), here, float(total.min()))
