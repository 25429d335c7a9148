"""Modes are added to the map one by one, in the tab Map, and its local minima are counted on the way.

A sweep adds modes from the lowest up, or from a high one down. Its maps are computed on a thread, on the same fine
lattice as the maps that the page shows when nothing changes, so that they have the same local minima.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import viser
from viser import uplot

from ...cost.maps import partial_sums, refined
from ...model.measurement import Measurement
from .. import html
from ..binding import Binding, Tab
from ..cost_maps import (
    CostMap,
    CostMapRequest,
    MapStyle,
    carried_modes,
    cost_map,
    count_label,
    map_modes,
    modes_label,
)
from ..plots import BLUE, RED, Plot, dots
from ..scheduler import Memo
from ..state import PageState


@dataclass(frozen=True)
class Sweep:
    """A sweep, which may still grow."""

    request: CostMapRequest  # of its last map, with the modes in the order in which they are added
    frames: list[CostMap] = field(default_factory=list)  # maps of the first mode, of the first two, and so on

    def frame(self, count: int) -> CostMap | None:
        """Return the map of the first `count` modes, or None if it is not computed."""
        return self.frames[count - 1] if 0 < count <= len(self.frames) else None


@dataclass
class Playback:
    """A sweep that plays."""

    next: int = 0  # number of the next map, counted from 0
    due: float = float("-inf")  # time at which it is shown, s; by default at once
    shown: tuple[int, ...] | None = None  # modes of the last map that it showed


def first_of(sequence: tuple[int, ...], modes: tuple[int, ...]) -> int:
    """Return the number of `modes` (ascending) if they are the first of a sequence, otherwise 0."""
    return len(modes) if tuple(sorted(sequence[: len(modes)])) == modes else 0


HIDDEN = -1e3  # number of local minima, below the plot, where the curve has no point yet


def caption(measurement: Measurement, drawn: CostMap) -> str:
    """Return the caption of a map of a sweep, as HTML."""
    modes, minima = drawn.request.modes, 0 if drawn.minima is None else drawn.minima.count
    found = "no local minimum" if not minima else "1 local minimum" if minima == 1 else f"{minima} local minima"
    where = " in the layer at its height" if measurement.array_dimension == 3 else ""
    what = f"sum of {count_label(measurement, modes)}, {modes[0]} to {modes[-1]}"
    what = what if len(modes) > 1 else f"{modes_label(measurement, modes)} alone"
    return f"<div style='{html.CARD}'>microphone {drawn.request.microphone}, {what}: <b>{found}</b>{where}</div>"


def curve(count: int, minima: tuple[int, ...], summed: int) -> tuple[np.ndarray, ...]:
    """Return the columns of the plot: modes summed, local minima as far as they are counted, the present point.

    `count`: number of modes of the sweep; `minima`: local minima of the first of its maps; `summed`: number of modes of
    the present map; 0 for none.
    """
    x, line = np.arange(1.0, count + 1), np.full(count, HIDDEN)
    line[: len(minima)] = minima
    return x, line, np.where(x == summed, line, HIDDEN)


UP, DOWN = "Lowest first", "Highest first"
RATE, MAX_RATE = 4, 20  # modes per second
NONE, NEXT = -2, -1  # in place of the number of the state whose sweep is wanted: no state, and the present state
ADVICE = "Modes are added to the map one by one, and its local minima are counted: one is left, which all modes share."


class SweepTab(Tab):
    """Owns the controls of the tab, the maps of one sweep, and its playback.

    Its callbacks run on viser's event loop, `show` on the main loop.
    """

    where, order = "Map", 2

    def __init__(self, binding: Binding):
        self._binding, self._map, row, modes = binding, binding.tabs.map, binding.row, binding.modes
        self.worker = binding.threads.job(self._compute)
        self._sweep: Sweep | None = None
        self._playing: Playback | None = None
        self._wanted: CostMapRequest | None = None  # request of the last sweep
        self._revision, self._curve, self._drawn = NONE, Memo(), Memo()
        self._last: CostMap | None = None  # the map that was shown last
        self._alone, self._label = False, f"Add {row}s one by one"
        series = (
            uplot.Series(label="modes"),
            uplot.Series(label="local minima", stroke=BLUE, width=0, points=dots(4, BLUE, BLUE)),
            uplot.Series(label="in the map", stroke=RED, width=0, points=dots(8, RED, RED)),
        )
        with binding.gui.add_folder(f"Add {binding.row}s"):
            self.play = binding.button(
                self._label, lambda _: self.toggle(), icon=viser.Icon.PLUS, command="sweep",
                hint=f"Add one {row} after the other to the map",
            )  # fmt: skip
            self.summed = binding.slider(
                f"{row.title()}s summed", 1, modes, 1, modes, self.sum_modes, command="modes",
                hint=f"How many {row}s the map is the sum of",
            )  # fmt: skip
            self.single = binding.checkbox(
                f"This {row} only", False, lambda single: self.sum_modes(self._count(), single), command="alone",
                hint=f"The {row} that was added last, in place of the sum",
            )  # fmt: skip
            with binding.gui.add_folder("Order and speed", expand_by_default=False):
                self.order = binding.dropdown(
                    "Order", (UP, DOWN), lambda choices: DOWN if choices.descending else UP, self._choose_order,
                    hint=f"{row.title()}s 1, 2, 3 and so on, or from the highest {row} down",
                )  # fmt: skip
                # the film's scene begins with the highest
                highest = (binding.choices.modes or (modes,))[-1] if binding.choices.descending else modes
                self.highest = binding.slider(
                    f"Highest {row}", 1, modes, 1, highest, lambda _: self._restart(), hint="Of the whole sum"
                )
                self.rate = binding.gui.add_slider(f"{row.title()}s per second", 1, MAX_RATE, 1, RATE)
            self.text = binding.gui.add_html(html.remark(ADVICE))
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
        self._map.show_some()
        after = first_of(sequence, self._binding.choices.modes or ())  # from the beginning after the last map
        self._revision, self._playing = NEXT, Playback(after % len(sequence))

    def pause(self) -> None:
        """Stop."""
        self._playing = None

    def sum_modes(self, count: int, alone: bool | None = None) -> None:
        """Pause, and show the sum of the first `count` modes of the sweep; if `alone`, only the last of them."""
        self._alone = self.alone if alone is None else alone
        self.pause()
        self._map.show_some()
        sequence = self._sequence()
        count = min(count, len(sequence))
        self._map.choose_modes(sorted(sequence[count - 1 if self._alone else 0 : count]))

    @property
    def alone(self) -> bool:
        """Whether the map shows a single mode; the first mode, which is also a sum, does not change the answer."""
        modes = self._binding.choices.modes
        if modes != self._sequence()[:1]:
            self._alone = modes is not None and len(modes) == 1
        return self._alone

    def _count(self) -> int:
        """Return the number in the sweep, from 1, of the mode that was added last to the map."""
        choices, run, sequence = self._binding.choices, self._binding.run, self._sequence()
        shown = map_modes(run, run.session.view.state, choices.modes, choices.map_order)
        last = shown[0] if choices.descending else shown[-1]
        return sequence.index(last) + 1 if last in sequence else len(sequence)

    def _choose_order(self, order: str) -> None:
        self._binding.choose(descending=order == DOWN)
        self._restart()

    def _restart(self) -> None:
        """Show as many modes as before, in another order; a sweep that plays begins again."""
        again = self.playing
        self.sum_modes(1 if again else self.summed.value)
        if again:
            self.toggle()

    def _sequence(self) -> tuple[int, ...]:
        """Return the modes that a map can have, in the order in which they are added."""
        run, choices = self._binding.run, self._binding.choices
        usable = carried_modes(run, choices.map_order, self._binding.modes) or (1,)
        modes = tuple(mode for mode in usable if mode <= self.highest.value) or usable[:1]
        return modes[::-1] if choices.descending else modes

    # Only the main loop calls the methods below.

    def map_for(self, wanted: CostMapRequest, drawn: CostMap | None, reason: str) -> tuple[CostMap | None, str]:
        """Return the map of the sweep in place of `drawn`, if the sweep has the one that is wanted.

        While it plays, a map stays until the next one is computed.
        """
        sweep, style, found, swept = self._sweep, wanted.style, drawn, None
        if sweep is not None and style.kind == "flat":
            of = sweep.request
            same = replace(wanted, modes=of.modes, custom_modes=True, style=of.style) == of
            if same and (style.log, style.kind) == (of.style.log, of.style.kind):
                swept = sweep.frame(first_of(of.modes, wanted.modes))
        if swept is not None:

            def draw() -> CostMap:
                floor = swept.floor and replace(swept.floor, show_minima=style.minima)
                return replace(swept, request=wanted, floor=floor, fine=True)

            found = self._drawn(draw, swept, style.minima)
        last, reason = self._last, reason if swept is None else ""
        if found is None and not reason and self.playing and last is not None:
            kept = last.request.microphone == wanted.microphone and last.request.style == wanted.style
            return (last if kept else None), ""
        self._last = found
        return found, reason

    @property
    def made(self) -> Sweep | None:
        """The last sweep that was requested, as far as it is computed; None before it is begun."""
        sweep = self._sweep
        return sweep if sweep is not None and sweep.request == self._wanted else None

    def _compute(self, request: CostMapRequest) -> Iterator[None]:
        """Compute one map after the other, until another sweep is requested; on the thread."""
        run, n, offset = self._binding.run, request.microphone, request.order_offset
        if run.problem.search is None:
            return
        sweep, search = Sweep(request), refined(run.problem.search)
        self._sweep = sweep
        for sums in partial_sums(run.problem, run.solver, request.state, n, request.modes, offset, search):
            if not self.worker.wants(request):
                return
            of = replace(request, modes=tuple(sorted(sums.modes)))
            sweep.frames.append(cost_map(run, of, sums.cost, search, sums.minima))
            yield

    def show(self, state: PageState) -> None:
        """Request the maps of a sweep that plays or is wanted, play it, and update the tab."""
        revision, choices = state.revision, self._binding.choices
        if self._revision == NEXT:
            self._revision = revision
        elif self._revision != revision and not self.playing:
            self._wanted = self.worker.requested = None  # its curve is of another state
        if (self.playing or self._revision == revision) and not state.view.running:
            style, order = MapStyle(log=choices.log), choices.map_order
            of = revision, state.microphone, self._sequence(), order, True, style, False, state.view.state, None
            self._wanted = CostMapRequest(*of)
            self.worker.newest(self._wanted)
        latest, sweep = self.worker.latest, self.made
        error = None if latest is None or latest.request != self.worker.requested else latest.cause
        self._step(sweep, state.now, error)
        self._update(sweep, error)

    def _step(self, sweep: Sweep | None, now: float, error: Exception | None) -> None:
        """Show the next map of the sweep that plays, if it is due and computed."""
        playing, call = self._playing, self._binding.call
        if playing is None or sweep is None or (now < playing.due and error is None):
            return
        modes = sweep.request.modes
        if error is not None or playing.next >= len(modes):
            call(lambda: self.pause() if playing is self._playing else None)
        elif playing.next < len(sweep.frames):
            playing.next, playing.due = playing.next + 1, now + 1 / self.rate.value
            wanted = tuple(sorted(modes[: playing.next]))

            def go() -> None:
                """On viser's event loop, unless the user has paused or chosen other modes meanwhile."""
                if playing is not self._playing:
                    return
                if playing.shown is not None and self._binding.choices.modes != playing.shown:
                    self.pause()
                    return
                playing.shown = wanted
                self._map.choose_modes(wanted)

            call(go)

    def _update(self, sweep: Sweep | None, error: Exception | None) -> None:
        """Bring button, slider, the number of local minima of the present sum, and curve up to date."""
        binding, choices = self._binding, self._binding.choices
        sequence = self._sequence() if sweep is None else sweep.request.modes
        summed = first_of(sequence, choices.modes or ())  # 0 where the map is another sum
        label = "Stop" if self.playing else self._label
        if self.play.label != label:
            self.play.label, self.play.icon = label, viser.Icon.PLAYER_PAUSE if self.playing else viser.Icon.PLUS
        self.summed.max = max(len(self._sequence()), 2)
        binding.send(self.summed, self._count())
        binding.send(self.single, self.alone)
        frame = None if sweep is None else sweep.frame(summed)
        if error is not None:
            self.text.content = html.complaint(error)
        elif frame is None:
            self.text.content = html.remark(ADVICE)
        else:
            self.text.content = caption(binding.measurement, frame)
        self._plot.folder.visible = sweep is not None  # a sweep of another state has no curve
        if sweep is not None and sweep.frames:
            minima = tuple(0 if one.minima is None else one.minima.count for one in sweep.frames[:])
            data = self._curve(lambda: curve(len(sequence), minima, summed), sweep, len(minima), summed)
            self._plot.show(data, (0.0, max(minima) + 1.0))
