"""Modes are added to the map one by one, in the tab Map, and its local minima are counted on the way.

A sweep adds modes in one order: from the lowest up, or from a high one down. Its maps are computed on a thread and kept
as images; they are as fine as those that the page shows when nothing changes, so they have the same local minima.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import viser
from viser import uplot

from ...cost.maps import partial_sums, refined
from ...graphics.heatmap import TABLE, colour_limits, colour_numbers, normalise, of_colour_numbers, table_numbers
from ...graphics.primitives import Floor
from ...model.measurement import Measurement
from ...solvers.interface import RunState
from ..cost_maps import (
    CostMap,
    CostMapRequest,
    MapStyle,
    ModePanels,
    carried_modes,
    cost_map,
    count_label,
    least_range,
    map_modes,
    modes_label,
    of_take,
)
from ..gui import html
from ..gui.binding import Binding, Tab
from ..gui.plots import BLUE, RED, Plot, dots
from ..prepare import PreparedRun
from ..scheduler import Memo, Scheduler
from ..state import FLOOR, PageState
from .map import MapTab

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

    def __init__(self, run: PreparedRun, threads: Scheduler):
        self._run = run
        self._sweep: Sweep | None = None
        self._drawn = Memo()
        self.worker = threads.job(self._compute)

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
        of = sweep.request
        asked = wanted.revision, wanted.microphone, wanted.order_offset, style.log, style.basins
        if (of.revision, of.microphone, of.order_offset, of.log, of.basins) != asked:
            return None
        frame = sweep.frame(count)
        if frame is None or sweep.of_first(count) != wanted.modes:
            return None

        def draw() -> CostMap:
            image = TABLE[frame.numbers] if frame.floor.areas else of_colour_numbers(frame.numbers)
            floor = replace(frame.floor, rgb=image, show_minima=style.minima)
            return replace(frame.map, request=wanted, floor=floor, fine=True)

        return self._drawn(draw, frame, style.minima)

    def _compute(self, request: SweepRequest) -> Iterator[None]:
        """On the thread: map after map, until another sweep is requested."""
        run, state, n, offset = self._run, request.state, request.microphone, request.order_offset
        if run.problem.search is None:
            return
        modes = tuple(mode for mode in request.modes if mode <= request.highest) or request.modes[:1]
        sweep = Sweep(request, modes[::-1] if request.descending else modes, tuple(range(1, len(modes) + 1)))
        self._sweep = sweep
        search, style = refined(run.problem.search), MapStyle(log=request.log, basins=request.basins)
        for sums in partial_sums(run.problem, run.solver, state, n, sweep.modes, offset, search):
            if not self.worker.wants(request):
                return
            of = CostMapRequest(
                request.revision, n, tuple(sorted(sums.modes)), offset, True, style, follow=False, state=state,
                lineage=None,
            )  # fmt: skip
            drawn = cost_map(run, of, sums.cost, search, sums.minima)
            if drawn.floor is None:
                raise ValueError("a map of a sweep is on the floor")
            if request.basins:
                numbers = table_numbers(drawn.floor.rgb)
            else:
                low, high, _ = colour_limits(sums.cost, request.log, least_range(run, of))
                numbers = colour_numbers(normalise(sums.cost, low, high, request.log))
            floor = replace(drawn.floor, rgb=NO_IMAGE)
            sweep.frames.append(SweepFrame(replace(drawn, floor=None), sums.minima.count, floor, numbers))
            yield


@dataclass
class Playback:
    """A sweep that plays."""

    rate: float  # maps per second
    next: int = 0  # which map is next, counted from 0
    due: float = float("-inf")  # when that is, s; at once unless given
    shown: tuple[int, ...] | None = None  # modes that the playback showed last

    def ended(self, stops: Sequence[int], now: float) -> bool:
        """Whether the last of all maps has been shown long enough."""
        return self.next >= len(stops) and now >= self.due

    def advance(self, stops: Sequence[int], ready: int, now: float) -> int | None:
        """Return the number of modes to be summed now; None where the present map stays.

        `stops`: numbers of modes of all maps of the sweep; `ready`: number of its maps that are computed; `now`: time,
        s.
        """
        if self.next >= min(ready, len(stops)) or now < self.due:
            return None
        self.next, self.due = self.next + 1, now + 1 / self.rate
        return stops[self.next - 1]

    def continue_from(self, summed: int, count: int) -> None:
        """Go on after the map of `summed` of `count` modes; from the beginning after the last one."""
        self.next = summed % count


HIDDEN = -1e3  # local minima, where the curve has no point yet: below the plot


def caption(measurement: Measurement, microphone: int, modes: tuple[int, ...], minima: int, layer: bool = False) -> str:
    """Return what a map of a sweep shows, as HTML.

    `microphone`: counted from 0; `modes`: ascending, counted from 1; `minima`: number of local minima of the map;
    `layer`: whether the map is a layer of a domain in space.
    """
    found = "no local minimum" if not minima else "1 local minimum" if minima == 1 else f"{minima} local minima"
    where = " in the layer at its height" if layer else ""
    what = f"sum of {count_label(measurement, modes)}, {modes[0]} to {modes[-1]}"
    what = what if len(modes) > 1 else f"{modes_label(measurement, modes)} alone"
    return f"<div style='{html.CARD}'>microphone {microphone}, {what}: <b>{found}</b>{where}</div>"


def curve(stops: tuple[int, ...], counts: tuple[int, ...], summed: int) -> tuple[np.ndarray, ...]:
    """Return the columns of the plot: modes summed, local minima as far as they are counted, the present point.

    `stops`: numbers of modes of all maps of the sweep; `counts`: local minima of the first of them; `summed`: number of
    modes of the present map; 0 for none.
    """
    x = np.array(stops, float)
    line = np.concatenate([np.array(counts, float), np.full(len(stops) - len(counts), HIDDEN)])
    return x, line, np.where(x == summed, line, HIDDEN)


UP, DOWN = "Lowest first", "Highest first"
ORDERS: tuple[str, ...] = (UP, DOWN)
RATE, MAX_RATE = 4, 20  # modes per second
NOT_ASKED, NEXT = -2, -1  # in place of the number of a state whose sweep is wanted: of none, of the present one
ADVICE = (
    "Play adds one {} after the other to the map and counts its local minima; the sum keeps the one that all share."
)


class SweepTab(Tab):
    """Owns the controls of the tab, the thread that computes the maps, and what plays.

    Its callbacks run on viser's event loop, `show` on the main loop.

    `map_tab`: whose modes are set.
    """

    def __init__(self, binding: Binding, map_tab: MapTab):
        self._binding, self._map, row, modes = binding, map_tab, binding.row, binding.modes
        self.worker = SweepWorker(binding.run, binding.threads)
        self._playing: Playback | None = None
        self._wanted: SweepRequest | None = None  # of the last sweep that was asked for
        self._revision, self._curve = NOT_ASKED, Memo()
        self._panels: ModePanels | None = None  # maps of single modes, drawn last
        self._last: CostMap | None = None  # the map that was shown last
        self._alone = False
        series = (
            uplot.Series(label="modes"),
            uplot.Series(label="local minima", stroke=BLUE, width=0, points=dots(4, BLUE, BLUE)),
            uplot.Series(label="in the map", stroke=RED, width=0, points=dots(8, RED, RED)),
        )
        with binding.gui.add_folder(f"Add {binding.row}s"):
            self.play = binding.button(
                "Play", lambda _: self.toggle(), icon=viser.Icon.PLUS, hint=f"Add one {row} after the other to the map"
            )
            self.summed = binding.slider(
                f"{row.title()}s summed", 1, modes, 1, modes, self.sum_modes,
                hint=f"How many {row}s the map is the sum of",
            )  # fmt: skip
            with binding.gui.add_folder("Order and speed", expand_by_default=False):
                hint = f"{row.title()}s 1, 2, 3 and so on, or from the highest {row} down"
                self.order = binding.dropdown("Order", ORDERS, UP, lambda _: self._restart(), hint=hint)
                self.highest = binding.slider(
                    f"Highest {row}", 1, modes, 1, modes, lambda _: self._restart(), hint="Of the whole sum"
                )
                self.rate = binding.gui.add_slider(f"{row.title()}s per second", 1, MAX_RATE, 1, RATE)
            self.text = binding.gui.add_html(html.remark(ADVICE.format(row)))
            self._plot = Plot(
                binding.gui, "Local minima of the sum", series, f"{binding.row}s summed",
                height=140, whole=True, legend=False,
            )  # fmt: skip
        self.plots = (self._plot,)

    @property
    def playing(self) -> bool:
        """Whether modes are being added."""
        return self._playing is not None

    def toggle(self) -> None:
        """Play from the modes of the map, or pause."""
        if self._playing is not None:
            self.pause()
            return
        sequence = self._sequence()
        playing = Playback(self.rate.value)
        playing.continue_from(first_of(sequence, self._binding.choices.modes or ()), len(sequence))
        if not self._binding.choices.shown:
            self._map.show_as(FLOOR)
        self._revision, self._playing = NEXT, playing

    def pause(self) -> None:
        """Stop."""
        self._playing = None

    def sum_modes(self, count: int) -> None:
        """Pause, and show the sum of the first `count` modes of the sweep."""
        self.pause()
        self._revision = NEXT
        sequence = self._sequence()
        self._map.choose_modes(sorted(sequence[: min(count, len(sequence))]))

    @property
    def alone(self) -> bool:
        """Whether the map shows one mode alone; of the lowest one, which is also a sum, whether the last one was."""
        modes = self._binding.choices.modes
        if modes != self._usable()[:1]:
            self._alone = modes is not None and len(modes) == 1
        return self._alone

    def sum_up_to(self, highest: int, alone: bool) -> None:
        """Pause, and show the sum of the modes up to `highest` that a map can sum, or the last of them alone."""
        self.pause()
        if not self._binding.choices.shown:
            self._map.show_as(FLOOR)
        usable = self._usable()
        summed = usable[: max(sum(mode <= highest for mode in usable), 1)]
        self._alone = alone
        self._map.choose_modes(summed[-1:] if alone else summed)

    def _restart(self) -> None:
        """Show as many modes as before, in another order; whatever plays begins again."""
        again = self.playing
        self.sum_modes(1 if again else self.summed.value)
        if again:
            self.toggle()

    def _usable(self) -> tuple[int, ...]:
        """Return the modes that can be summed, ascending."""
        binding, choices = self._binding, self._binding.choices
        return of_take(binding.run, carried_modes(binding.run, choices.map_order, binding.modes) or (1,), choices.take)

    def _sequence(self) -> tuple[int, ...]:
        """Return the modes in the order in which they are added."""
        usable = self._usable()
        modes = tuple(mode for mode in usable if mode <= self.highest.value) or usable[:1]
        return modes[::-1] if self.order.value == DOWN else modes

    # Below: the main loop alone.

    def map_for(self, wanted: CostMapRequest, drawn: CostMap | None, reason: str) -> tuple[CostMap | None, str]:
        """Return the map of the sweep in place of `drawn`, where the sweep has the one that is wanted.

        While it plays, the map of the modes before stays until the next one is there.
        """
        if drawn is not None:
            self._panels = drawn.panels
        swept = self.worker.map_of(wanted)
        found = drawn if swept is None else replace(swept, panels=self._panels)
        last, reason = self._last, reason if swept is None else ""
        if found is None and not reason and self.playing and last is not None:
            kept = last.request.microphone == wanted.microphone and last.request.style == wanted.style
            return (last if kept else None), ""
        self._last = found
        return found, reason

    def show(self, tick: PageState) -> None:
        """Request the maps of a sweep that plays or was asked for, play it, and bring the tab up to date."""
        view, revision, now = tick.view, tick.revision, tick.now
        if self._revision == NEXT:
            self._revision = revision
        elif self._revision != revision and not self.playing:
            self._wanted = None  # its curve is of another state
            self.worker.worker.requested = None
        if (self.playing or self._revision == revision) and not view.running:
            choices = self._binding.choices
            self._wanted = SweepRequest(
                revision, tick.microphone, self._usable(), self.highest.value, self.order.value == DOWN,
                choices.map_order, choices.style.log, choices.style.basins, view.state,
            )  # fmt: skip
            self.worker.worker.newest(self._wanted)
        sweep = None if self._wanted is None else self.worker.sweep(self._wanted)
        self._step(sweep, now)
        self._update(sweep)

    def _step(self, sweep: Sweep | None, now: float) -> None:
        """Show the next map of what plays, where it is due and ready."""
        playing = self._playing
        if playing is None or sweep is None:
            return
        playing.rate = self.rate.value
        if self.worker.error is not None or playing.ended(sweep.stops, now):
            self._binding.call(lambda: self.pause() if playing is self._playing else None)
        elif (summed := playing.advance(sweep.stops, len(sweep.frames), now)) is not None:

            def go() -> None:
                """On viser's event loop, unless the user has paused or chosen other modes meanwhile."""
                if playing is not self._playing:
                    return
                if playing.shown is not None and self._binding.choices.modes != playing.shown:
                    self.pause()
                    return
                playing.shown = sweep.of_first(summed)
                self._map.choose_modes(playing.shown)

            self._binding.call(go)

    def _update(self, sweep: Sweep | None) -> None:
        """Bring button, slider, the number of local minima of the present sum, and curve up to date."""
        binding, sequence = self._binding, self._sequence() if sweep is None else sweep.modes
        summed = first_of(sequence, binding.choices.modes or ())  # 0 where the map is another sum
        label = "Pause" if self.playing else "Play"
        if self.play.label != label:
            self.play.label, self.play.icon = label, viser.Icon.PLAYER_PAUSE if self.playing else viser.Icon.PLUS
        run, choices = binding.run, binding.choices
        shown = map_modes(run, run.session.view.state, choices.modes, choices.map_order, choices.take)
        binding.send(self.summed, first_of(sequence, shown) or len(sequence))
        frame = None if sweep is None else sweep.frame(summed)
        if self.worker.error is not None:
            self.text.content = html.complaint(self.worker.error)
        elif sweep is None or frame is None:
            self.text.content = html.remark(ADVICE.format(binding.row))
        else:
            of, modes, layer = sweep.request, sweep.of_first(summed), binding.measurement.array_dimension == 3
            self.text.content = caption(binding.measurement, of.microphone, modes, frame.count, layer)
        self._plot.folder.visible = sweep is not None  # a sweep of another state has no curve
        if sweep is not None and sweep.frames:
            counts = tuple(frame.count for frame in sweep.frames[:])
            data = self._curve(lambda: curve(sweep.stops, counts, summed), sweep, len(counts), summed)
            self._plot.show(data, limits=(0.0, max(counts) + 1.0))
