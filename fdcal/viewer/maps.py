"""Cost maps, computed on a thread of their own; only the one that belongs to what is looked at is given out."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..picture import Floor, cost_label, heights_of, paint
from ..session import LatestWorker
from .preparing import Work

PAUSE = 0.15  # s at least between two maps while the solver runs, which needs the processor too


@dataclass(frozen=True)
class MapRequest:
    """A map to be computed. `turn` counts the states seen, which have no cheap equality of their own."""

    turn: int
    microphone: int
    single: bool  # the map of one mode, not the sum of those in use
    first: int
    last: int
    log: bool
    state: object = field(compare=False)
    lineage: object = field(compare=False)  # of the history that the state belongs to

    def stands_for(self, wanted: MapRequest, running: bool) -> bool:
        """Whether this map may be shown where `wanted` is asked for: while running, an older state's may."""
        if self == wanted or not running:
            return self == wanted
        mine, theirs = (
            (one.microphone, one.single, one.log, one.first if one.single else None) for one in (self, wanted)
        )
        return mine == theirs and self.lineage is wanted.lineage


class Maps:
    """Asks for maps and hands out the newest that fits; all of it on the caller's thread but `_paint`."""

    def __init__(self, work: Work):
        self._work, self._asked = work, None
        self._worker = LatestWorker(self._paint, "fdcal-map")

    def newest(self, wanted: MapRequest, running: bool, now: float) -> tuple[Floor | None, str]:
        """The map to show and, where there is none for it, why. Asks for `wanted` where it is not there yet."""
        latest = self._worker.latest
        pause = 0.0 if latest is None else max(PAUSE, 0.5 * (latest.ended - latest.began))
        rested = not running or latest is None or now - latest.ended > pause
        if wanted != self._asked and rested and not self._worker.busy:
            self._asked = wanted
            self._worker.request(wanted)
        if latest is None or not latest.request[0].stands_for(wanted, running):
            return None, ""
        return latest.result, latest.error

    def close(self, timeout: float) -> bool:
        """End the thread after the map under way."""
        return self._worker.close(timeout)

    def _paint(self, wanted: MapRequest) -> Floor:
        work, modes = self._work, slice(wanted.first - 1, wanted.last)
        maps = work.solver.landscape(work.problem, wanted.state, wanted.microphone, modes)
        label = cost_label(work.scene.solver.weights)
        if work.measurement.array_dimension == 3:
            label += f" at z = {wanted.state.positions[wanted.microphone, 2]:.2f} m"
        base = heights_of(work.scene, work.measurement)[0]
        return paint(maps.sum(axis=0), work.problem.search, wanted.log, label, base)
