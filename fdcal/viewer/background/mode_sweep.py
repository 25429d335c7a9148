"""The maps of one microphone while modes are added, computed on a thread of its own and kept as images.

A sweep adds modes in one order: from the lowest up, or from a high one down. Its maps are as fine as those that the
page shows when nothing changes, so they have the same local minima.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ...cost.maps import partial_sums, refined
from ...cost.scale import Minima
from ...graphics.basin_map import TABLE, table_numbers
from ...graphics.heatmap import colour_limits, colour_numbers, normalise, of_colour_numbers
from ...graphics.primitives import Floor
from ...solvers.interface import RunState
from .cost_map import CostMap, CostMapRequest, MapStyle, cost_map
from .prepare import PreparedRun
from .threads import Threads

NO_IMAGE = np.zeros((1, 1, 3), np.uint8)


@dataclass(frozen=True)
class SweepRequest:
    """A sweep to be computed."""

    revision: int  # counts the states on the screen
    microphone: int  # counted from 0
    modes: tuple[int, ...]  # those that can be summed, ascending, counted from 1
    highest: int  # the highest mode of the sum
    descending: bool  # whether the highest mode comes first
    order_offset: int | None  # of the maps; None for what the solver minimises
    log: bool  # whether the scale is logarithmic
    basins: bool  # whether the maps show basins of attraction
    state: RunState = field(compare=False)  # of the solver


@dataclass(frozen=True)
class Sweep:
    """A sweep, which may still grow."""

    request: SweepRequest
    modes: tuple[int, ...]  # in the order in which they are added, counted from 1
    stops: tuple[int, ...]  # how many of them each map is the sum of
    frames: list[SweepFrame] = field(default_factory=list)  # the maps; a list that is only appended to

    @property
    def counts(self) -> tuple[int, ...]:
        """The numbers of local minima so far."""
        return tuple(frame.count for frame in self.frames[:])

    def frame(self, count: int) -> SweepFrame | None:
        """Return the map of the first `count` modes, or None where there is none, or not yet."""
        place = self.stops.index(count) if count in self.stops else len(self.stops)
        return self.frames[place] if place < len(self.frames) else None

    def of_first(self, count: int) -> tuple[int, ...]:
        """Return the first `count` modes, ascending."""
        return tuple(sorted(self.modes[:count]))


@dataclass(frozen=True)
class SweepFrame:
    """One map of a sweep."""

    map: CostMap
    count: int  # local minima of the map
    floor: Floor  # of the map, without its image
    numbers: np.ndarray  # (ny, nx) uint8, the image: numbers of colours


def first_of(sequence: tuple[int, ...], modes: tuple[int, ...]) -> int:
    """Return how many `modes` (ascending) there are, if they are the first of a sequence; or 0."""
    return len(modes) if tuple(sorted(sequence[: len(modes)])) == modes else 0


class SweepWorker:
    """Computes the maps of one sweep at a time, on a thread of the session, and keeps them."""

    def __init__(self, run: PreparedRun, threads: Threads):
        self._run = run
        self._sweep: Sweep | None = None
        self._drawn: tuple[SweepFrame, bool, CostMap] | None = None
        self.worker = threads.start(self._compute, "fdcal-sweep")

    def sweep(self, wanted: SweepRequest) -> Sweep | None:
        """Return the sweep of a request, as far as it is computed; None before its modes are known."""
        sweep = self._sweep
        return sweep if sweep is not None and sweep.request == wanted else None

    @property
    def error(self) -> Exception | None:
        """What has kept the last sweep from being computed."""
        latest = self.worker.latest
        return None if latest is None or latest.request != self.worker.requested else latest.cause

    def map_of(self, wanted: CostMapRequest) -> CostMap | None:
        """Return the map of a request where the sweep has it: the same object as long as nothing changes."""
        sweep, style, count = self._sweep, wanted.style, len(wanted.modes)
        if sweep is None or style.relief or style.shape or style.volume:
            return None
        of, alike = sweep.request, ("revision", "microphone", "order_offset")
        if any(getattr(of, name) != getattr(wanted, name) for name in alike) or (of.log, of.basins) != (
            style.log,
            style.basins,
        ):
            return None
        frame = sweep.frame(count)
        return None if frame is None or sweep.of_first(count) != wanted.modes else self._image(frame, wanted)

    def _image(self, frame: SweepFrame, wanted: CostMapRequest) -> CostMap:
        if self._drawn is None or self._drawn[0] is not frame or self._drawn[1] != wanted.style.minima:
            image = TABLE[frame.numbers] if frame.floor.areas else of_colour_numbers(frame.numbers)
            floor = replace(frame.floor, rgb=image, show_minima=wanted.style.minima)
            self._drawn = frame, wanted.style.minima, replace(frame.map, request=wanted, floor=floor, fine=True)
        return self._drawn[2]

    def _compute(self, request: SweepRequest) -> None:
        """On the thread: map after map, until another sweep is requested."""
        run, state, n, offset = self._run, request.state, request.microphone, request.order_offset
        if run.problem.search is None:
            return
        modes = tuple(mode for mode in request.modes if mode <= request.highest) or request.modes[:1]
        sweep = Sweep(request, modes[::-1] if request.descending else modes, tuple(range(1, len(modes) + 1)))
        self._sweep = sweep
        search = refined(run.problem.search)
        for sums in partial_sums(run.problem, run.solver, state, n, sweep.modes, offset, search):
            if not self.worker.wants(request):
                return
            sweep.frames.append(self._frame(request, sums.modes, sums.cost, sums.minima, search))

    def _frame(self, request: SweepRequest, modes, cost: np.ndarray, minima: Minima, search) -> SweepFrame:
        style = MapStyle(log=request.log, basins=request.basins)
        of = CostMapRequest(
            request.revision, request.microphone, tuple(sorted(modes)), request.order_offset, True, style,
            follow=False, state=request.state, lineage=None,
        )  # fmt: skip
        drawn = cost_map(self._run, of, cost, search, minima)
        if drawn.floor is None:
            raise ValueError("a map of a sweep is on the floor")
        if request.basins:
            numbers = table_numbers(drawn.floor.rgb)
        else:
            low, high, _ = colour_limits(cost, request.log)
            numbers = colour_numbers(normalise(cost, low, high, request.log))
        floor = replace(drawn.floor, rgb=NO_IMAGE)
        return SweepFrame(replace(drawn, floor=None), minima.count, floor, numbers)
