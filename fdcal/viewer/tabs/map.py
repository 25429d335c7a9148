"""The tab Map: microphone, modes and kind of the map, an animation that adds modes, and the power spectrum.

The animation "Add frequencies one by one" adds modes to the map from the lowest up, or from a high one down, and counts
the local minima of each sum. A thread computes its maps on the same fine lattice as the map that the page shows when
nothing changes, so that both have the same local minima.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import viser
from viser import uplot

from ...acoustics.dictionary import array_f_max, max_order
from ...assessment.words import count_label, modes_label, row_label
from ...cost.maps import partial_sums, refined
from ...model.address import SOLVER
from ...model.measurement import Measurement
from ...model.problem import mode_power
from ...model.validation import InputError, modes_text, parse_modes
from ...session.worker import Memo
from .. import cost_maps, html
from ..cost_maps import CostMap, CostMapRequest, MapStyle, carried_modes, cost_map, map_modes
from ..prepare import PreparedRun
from ..state import MAX_ORDER_OFFSET, Binding, Choices, PageState, Tab
from .curves import BLUE, ORANGE, RED, Plot, dots


def caption(run: PreparedRun, drawn: CostMap) -> str:
    """Return the caption of a map as HTML: its local minima, the costs, and the orders of the modes."""
    request, found, measurement = drawn.request, drawn.minima, run.measurement
    if found is None:
        text = "Snapshot of the field reconstructed at the estimated positions (Eq. 6)"
        return f"<div style='{html.CARD}'>{text}</div>"
    modes, marked = request.modes, request.style.minima
    several, single = f"sum of {count_label(measurement, modes)}", f"{modes_label(measurement, modes)} alone"
    what = f"microphone {request.microphone}, {several if len(modes) > 1 else single}"
    if marked:
        minima = {0: "no local minimum", 1: "1 local minimum"}.get(found.count, f"{found.count} local minima")
        what += f": <b>{minima}</b> in the map"
    cost = f"cost at the estimate <b>{drawn.text_of(drawn.cost_here)}</b>"
    if drawn.base is not None:
        at_lowest = drawn.cost_here <= drawn.lowest
        cost = "the estimate is at the lowest point of the map" if at_lowest else f"{cost} re the highest of the map"
    elif marked:
        lowest = drawn.text_of(drawn.lowest) if found.end is None else f"below {drawn.text_of(found.end)}"
        cost += f", lowest {lowest}" + (f" at {len(found.lowest)} places" if len(found.lowest) > 1 else "")
    lines = [what, cost]
    if drawn.volume is not None and drawn.volume.text:
        lines.append(drawn.volume.text)
    if request.order_offset is not None and run.problem.search is not None:  # a map of Eq. 7
        k = run.problem.wavenumbers[np.asarray(modes) - 1]
        orders = max_order(k, run.problem.search.radius, request.order_offset)
        low, high = int(orders.min()), int(orders.max())
        text = f"order L = {low if low == high else f'{low} to {high}'}, ceil(k R) + {request.order_offset}"
        used = request.state.last + 1 - request.state.first
        if not request.custom_modes and request.state.last not in modes:
            text += f"; {len(modes)} of the {used} frequencies that the solver uses: the higher ones have"
            text += f" too many functions for {measurement.count} microphones"
        lines.append(text)
    return f"<div style='{html.CARD}'>{'<br>'.join(lines)}</div>"


SCALES = {"Logarithmic": True, "Linear": False}
OBJECTIVE, EQ7 = "What the method minimises", "Eq. 7, for comparison"
NO_SEARCH = f"No map: {html.NO_DOMAIN}"
LABELS = {
    "flat": "Flat map", "relief": "Relief", "shape": "Mode shape (last frequency)",
    "volume": "Isosurfaces (3-D)", "none": "No map",
}  # fmt: skip


class MapTab(Tab):
    """Owns the controls of the map, each of which is visible only if it affects the map that is shown.

    `kinds`: the kinds of map that are possible.
    """

    part, where, order = "map", "Map", 1

    def __init__(self, binding: Binding):
        self._binding, self._possible = binding, binding.run.problem.search is not None
        self._caption, choices = Memo(), binding.choices
        self.kinds = tuple(kind for kind in cost_maps.MAP_KINDS if kind != "volume" or choices.in_space)
        mapped: Callable[[Choices], bool] = lambda of: self._possible and of.kind != "none"  # noqa: E731
        of_cost: Callable[[Choices], bool] = lambda of: mapped(of) and of.kind != "shape"  # noqa: E731
        labels = {LABELS[kind]: kind for kind in self.kinds}
        self.kind = binding.choice("Show", "kind", labels, visible=self._possible, command="kind")
        self.microphone = binding.slider(
            "Microphone", 0, binding.measurement.count - 1, 1, choices.microphone, self.pick,
            command="microphone", hint="You can also click a microphone in the scene, or drag it to move its estimate",
        )  # fmt: skip
        self.follow = binding.checkbox(
            "Follow the run", lambda choices: choices.follow, self.follow_solver,
            visible=not binding.run.solver.TRAITS.moves_all, hint="Show the microphone that the next step moves",
        )  # fmt: skip
        self.text = binding.on(
            binding.gui.add_text(
                "Frequency numbers", SOLVER if choices.modes is None else modes_text(choices.modes),
                hint=f'Frequencies of the map, such as 1-3, 5; "{SOLVER}" for those that the solver uses',
            ),
            self._read, command="map_modes",
        )  # fmt: skip
        binding.follow(self.text, visible=mapped)
        self.caption = binding.gui.add_html("")
        with binding.gui.add_folder("Scale and quantity", expand_by_default=False):
            self.quantity = binding.choice(
                "Quantity", "objective", {OBJECTIVE: True, EQ7: False},
                visible=lambda choices: of_cost(choices) and not choices.volume,
                hint="Eq. 7 at a given order does not depend on the method",
            )  # fmt: skip
            self.order = binding.slider(
                "Extra orders", 0, MAX_ORDER_OFFSET, 1, lambda choices: choices.order_offset,
                lambda value: binding.choose(order_offset=value),
                visible=lambda choices: of_cost(choices) and choices.map_order is not None,
                hint="Order of each frequency L = ceil(k R) + this number; 0 is the paper's Eq. 3",
            )  # fmt: skip
            self.scale = binding.choice("Scale", "log", SCALES, visible=of_cost, command="scale")
            self.minima = binding.choice(
                "Mark minima", "minima", visible=mapped,
                hint="Mark the local minima; in a mode shape, the positions with the same measured pressure",
            )  # fmt: skip

    def pick(self, number: int) -> None:
        """Show the map of a microphone, and stop following the solver; too large a number selects the last one."""
        number = min(max(number, 0), self._binding.measurement.count - 1)
        self._binding.choose(microphone=number, follow=False)
        self.microphone.value = number

    def follow_solver(self, follow: bool) -> None:
        """Show the microphone that the next step moves, or stay with the present one."""
        self._binding.choose(follow=follow, microphone=self.microphone.value)

    def choose_modes(self, modes) -> None:
        """Show the map of these modes, counted from 1; None for those that the solver uses."""
        modes = None if modes is None else tuple(modes)
        self._binding.choose(modes=modes, modes_error="")
        self.text.value = SOLVER if modes is None else modes_text(modes)

    def _read(self, text: str) -> None:
        """Show the map of the modes that a text names; for an invalid text, show only the error."""
        try:
            modes = None if text == SOLVER else parse_modes(text, self._binding.modes)
        except InputError as error:
            self._binding.choose(modes_error=html.error_message(error))
        else:
            self._binding.choose(modes=modes, modes_error="")

    def show_as(self, kind: str) -> None:
        """Show a kind of map, or a flat map if that kind is not possible."""
        self._binding.choose(kind=kind if kind in self.kinds else "flat")

    def show(self, tick: PageState) -> None:
        """Update the microphone and the caption."""
        binding, choices, drawn = self._binding, self._binding.choices, tick.drawn
        if not choices.follow and choices.microphone == tick.microphone:
            binding.sent[id(self.microphone)] = tick.microphone  # set by the user, who may still be dragging the slider
        binding.send(self.microphone, tick.microphone)
        reason = NO_SEARCH if not self._possible else "computing the map ..." if choices.kind != "none" else "no map"
        words = drawn and self._caption(lambda: caption(binding.run, drawn), drawn)
        self.caption.content = html.complaint(choices.modes_error) + (words or html.remark(tick.reason or reason))


@dataclass(frozen=True)
class Sweep:
    """The maps of a sweep, which may still grow."""

    request: CostMapRequest  # request for the last map; its modes are in the order in which they are added
    frames: list[CostMap] = field(default_factory=list)  # maps of the first mode, of the first two, and so on


@dataclass
class Playback:
    """The state of a sweep that is being played."""

    next: int = 0  # number of the next map, counted from 0
    due: float = float("-inf")  # time at which the next map is shown, s; by default at once
    shown: tuple[int, ...] | None = None  # modes of the last map that was shown


def first_of(sequence: tuple[int, ...], modes: tuple[int, ...]) -> int:
    """Return how many `modes` (ascending) there are if they are the first of a sequence, otherwise 0."""
    return len(modes) if tuple(sorted(sequence[: len(modes)])) == modes else 0


HIDDEN = -1e3  # ordinate below the plot, for points without a value, because uPlot cannot draw NaN
ORDERS = {"Lowest first": False, "Highest first": True}  # whether modes are added from the highest down
RATE, MAX_RATE = 4, 20  # modes added per second: at first, and at most
ADVICE = (
    "Frequencies are added to the map one by one, and its local minima are counted, until one is left: the position"
    " that fits all frequencies."
)


class SweepTab(Tab):
    """Owns the controls that add modes to the map, the maps of one sweep, and its playback.

    Its callbacks run on viser's event loop, and `show` runs on the main loop. `playing` is the playback, or None;
    `made` is the sweep that was requested last, as far as it is computed, or None if its computation has not begun.
    """

    part, where, order = "sweep", "Map", 2

    def __init__(self, binding: Binding):
        self._binding, self._map, modes = binding, binding.tabs.map, binding.modes
        self.worker = binding.threads.worker(self._compute)
        self._sweep: Sweep | None = None
        self.made: Sweep | None = None
        self.playing: Playback | None = None
        self._wanted: CostMapRequest | None = None  # request of the last sweep
        self._revision = -1  # revision of the state whose maps are wanted
        self._curve, self._drawn = Memo(), Memo()
        self._last: CostMap | None = None  # the map that was shown last
        self._alone, self._label = False, "Add frequencies one by one"
        series = (
            uplot.Series(label="frequencies"),
            uplot.Series(label="local minima", stroke=BLUE, width=0, points=dots(4, BLUE, BLUE)),
            uplot.Series(label="in the map", stroke=RED, width=0, points=dots(8, RED, RED)),
        )
        with binding.gui.add_folder("Add frequencies"):
            hint = "Add one frequency after the other to the map"
            play = binding.gui.add_button(self._label, icon=viser.Icon.PLUS, hint=hint)
            self.play = binding.on(play, lambda _: self.toggle(), command="sweep")
            self.summed = binding.slider(
                "Frequencies summed", 1, modes, 1, modes, self.sum_modes, command="modes",
                hint="Number of frequencies whose sum the map shows",
            )  # fmt: skip
            self.single = binding.checkbox(
                "This frequency only", False, lambda single: self.sum_modes(self._count(), single), command="alone",
                hint="Show only the frequency that was added last, not the sum",
            )  # fmt: skip
            with binding.gui.add_folder("Order and speed", expand_by_default=False):
                self.order = binding.choice(
                    "Order", "descending", ORDERS,
                    hint="Frequencies 1, 2, 3 and so on, or from the highest down",
                )  # fmt: skip
                binding.on(self.order, lambda _: self._restart())
                # the scene of the opening begins with the highest mode of the film
                highest = (binding.choices.modes or (modes,))[-1] if binding.choices.descending else modes
                self.highest = binding.slider(
                    "Highest freq.", 1, modes, 1, highest, lambda _: self._restart(), hint="Highest frequency number"
                )
                self.rate = binding.gui.add_slider("Speed (1/s)", 1, MAX_RATE, 1, RATE, hint="Frequencies per second")
            self.text = binding.gui.add_html(html.remark(ADVICE))
            title, x = "Local minima of the sum", "frequencies summed"
            self._plot = Plot(binding.gui, title, series, x, height=140, legend=False)
        self.plots = (self._plot,)

    def toggle(self) -> None:
        """Play the sweep from the modes that the map shows; if it is playing, stop it."""
        if self.playing is not None:
            self.playing = None
            return
        sequence = self._sequence()
        after = first_of(sequence, self._binding.choices.modes or ())  # a sweep that is complete begins again
        self._revision, self.playing = self._binding.state.revision, Playback(after % len(sequence))
        if self._binding.choices.kind == "none":
            self._map.show_as("flat")

    def sum_modes(self, count: int, alone: bool | None = None) -> None:
        """Stop, and show the sum of the first `count` modes of the sweep; if `alone`, only the last of them."""
        self._alone, self.playing = self.alone if alone is None else alone, None
        if not self._binding.run.solver.TRAITS.moves_all:  # its next run uses the modes of the map
            self._binding.session.pause()
        if self._binding.choices.kind == "none":
            self._map.show_as("flat")
        sequence = self._sequence()
        count = min(count, len(sequence))
        self._map.choose_modes(sorted(sequence[count - 1 if self._alone else 0 : count]))

    @property
    def alone(self) -> bool:
        """Whether the map shows a single mode; the first mode is also a sum, so that the last value is kept."""
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

    def _restart(self) -> None:
        """Show as many modes as before, in another order; a sweep that plays begins again."""
        again = self.playing is not None
        self.sum_modes(1 if again else self.summed.value)
        if again:
            self.toggle()

    def _sequence(self) -> tuple[int, ...]:
        """Return the modes that a map can show, in the order in which they are added."""
        run, choices, highest = self._binding.run, self._binding.choices, self.highest.value
        usable = carried_modes(run, choices.map_order, self._binding.modes) or (1,)
        kept = usable[: max(int(np.searchsorted(usable, highest, "right")), 1)]
        return kept[::-1] if choices.descending else kept

    # Only the main loop calls the methods below.

    def map_for(self, wanted: CostMapRequest, drawn: CostMap | None, reason: str) -> tuple[CostMap | None, str]:
        """Return the map of the sweep instead of `drawn`, if the sweep has the map that is wanted.

        While the sweep plays, each map is shown until the next one is computed.
        """
        sweep, style, last = self._sweep, wanted.style, self._last
        if sweep is not None and style.kind == "flat":
            own = sweep.request
            same = replace(wanted, modes=own.modes, custom_modes=True, style=own.style) == own
            count = first_of(own.modes, wanted.modes)
            if same and style.log == own.style.log and 0 < count <= len(sweep.frames):
                swept = sweep.frames[count - 1]
                floor = swept.floor and replace(swept.floor, show_minima=style.minima)
                shown, key = replace(swept, request=wanted, floor=floor, fine=True), (swept, style.minima)
                self._last = self._drawn.get(*key) or self._drawn.keep(shown, *key)  # the same object while shown
                return self._last, ""
        if drawn is None and not reason and self.playing is not None and last is not None:
            kept = last.request.microphone == wanted.microphone and last.request.style == wanted.style
            return (last if kept else None), ""
        self._last = drawn
        return drawn, reason

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
            part = replace(request, modes=tuple(sorted(sums.modes)))
            sweep.frames.append(cost_map(run, part, sums.cost, search, sums.minima))
            yield

    def show(self, state: PageState) -> None:
        """Request the maps of a sweep that plays or is wanted, play it, and update the controls."""
        binding, choices, playing = self._binding, self._binding.choices, self.playing
        if playing is None and self._revision != state.revision:
            self._wanted = self.worker.requested = None  # the curve belongs to another state
        if (playing is not None or self._revision == state.revision) and not state.view.running:
            style, order = MapStyle(log=choices.log), choices.map_order
            of_map = state.revision, state.microphone, self._sequence(), order, True, style
            self._wanted = CostMapRequest(*of_map, False, state.view.state, None)
            self.worker.newest(self._wanted)
        latest, sweep = self.worker.latest, self._sweep
        self.made = sweep = sweep if sweep is not None and sweep.request == self._wanted else None
        error = None if latest is None or latest.request != self.worker.requested else latest.error
        if playing is not None and sweep is not None and (state.now >= playing.due or error is not None):
            self._step(playing, sweep, state.now, error is not None)
        label, icon = ("Stop", viser.Icon.PLAYER_PAUSE) if self.playing else (self._label, viser.Icon.PLUS)
        self.play.label, self.play.icon = label, icon
        self.summed.max = max(len(self._sequence()), 2)
        binding.send(self.summed, self._count())
        binding.send(self.single, self.alone)
        self.text.content = html.remark(ADVICE) if error is None else html.complaint(error)
        # A sweep of another state has no curve, and a new one has none before its first map.
        self._plot.folder.visible = sweep is not None and bool(sweep.frames)
        if sweep is not None and sweep.frames:
            minima = tuple(0 if one.minima is None else one.minima.count for one in sweep.frames[:])
            summed = first_of(sweep.request.modes, choices.modes or ())  # 0 where the map is another sum
            columns = self._curve.get(sweep, len(minima), summed)
            if columns is None:  # modes summed, minima as far as they are counted, the point of the map
                x = np.arange(1.0, len(sweep.request.modes) + 1)
                line = np.full(len(x), HIDDEN)
                line[: len(minima)] = minima
                columns = x, line, np.where(x == summed, line, HIDDEN)
                self._curve.keep(columns, sweep, len(minima), summed)
            self._plot.show(columns, (0.0, max(minima) + 1.0))

    def _step(self, playing: Playback, sweep: Sweep, now: float, failed: bool) -> None:
        """Show the next map of the sweep that plays, if it is computed; stop after the last one."""
        modes, wanted = sweep.request.modes, None
        if not failed and playing.next < len(modes):
            if playing.next >= len(sweep.frames):
                return
            playing.next, playing.due = playing.next + 1, now + 1 / self.rate.value
            wanted = tuple(sorted(modes[: playing.next]))

        def go() -> None:
            """Show the map unless the user has stopped or chosen other modes meanwhile; on viser's event loop."""
            if playing is not self.playing:
                return
            if wanted is None or playing.shown not in (None, self._binding.choices.modes):
                self.playing = None
                return
            playing.shown = wanted
            self._map.choose_modes(wanted)

        self._binding.call(go)


SHADE = "rgba(128, 136, 148, 0.25)"  # colour of the area below the spectrum
MAX_POINTS = 700  # largest number of points of the spectrum; every update sends all of them
ABOVE, BELOW = 6.0, 8.0  # dB, space above the strongest peak, and least space below the weakest one
MIN_POWER = 1e-8  # relative to the greatest power; lower powers are drawn as this one


def spectrum_levels(measurement: Measurement, modes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the spectrum of a measurement, and the levels of its first `modes` peaks.

    The spectrum is (2, F) float64, Hz and dB re its maximum, with the greatest level of each of MAX_POINTS intervals;
    for a measurement without a spectrum it has the mean power of each mode. The peaks are (modes,) float64, dB.
    """
    f = measurement.frequencies[:modes]
    order = np.argsort(f, kind="stable")
    at, power = f[order], mode_power(measurement.pressures[:modes])[order]
    if measurement.spectrum is not None:
        at, power = measurement.spectrum[0], measurement.spectrum[1:].mean(axis=0)  # over all takes
    decibels = 10 * np.log10(np.maximum(power / max(power.max(), 1e-300), MIN_POWER))
    starts = np.unique(np.linspace(0, len(at) - 1, min(len(at), MAX_POINTS)).astype(int))
    spectrum = np.stack([at[starts], np.maximum.reduceat(decibels, starts)])
    return spectrum, np.maximum(np.interp(f, at, decibels), np.interp(f, *spectrum))


class SpectrumTab(Tab):
    """Owns the plot of the spectrum, which shows the modes that are in the map, and the text below."""

    part, where, order = "spectrum", "Map", 4
    interval = 0.25

    def __init__(self, binding: Binding):
        self._binding, gui, measurement, modes = binding, binding.gui, binding.measurement, binding.modes
        f, (spectrum, self._peaks) = measurement.frequencies[:modes], spectrum_levels(measurement, modes)
        x, self._rows = np.concatenate([spectrum[0], f]), np.arange(1, modes + 1)
        order = np.argsort(x, kind="stable")
        self._x, self._curve = x[order], np.concatenate([spectrum[1], self._peaks])[order]
        self._at = np.argsort(order, kind="stable")[spectrum.shape[1] :]
        self._range = 10 * float(np.floor((self._peaks.min() - BELOW) / 10)), ABOVE
        marks = {
            "mean power": f"<path d='M1 15L6 13L9 3L12 13L17 15' fill='none' stroke='{html.GREY}'/>",
            "in the map": f"<circle cx='9' cy='9' r='4' fill='{BLUE}'/>",
            "not in the map": f"<circle cx='9' cy='9' r='3' fill='none' stroke='{ORANGE}' stroke-width='1.6'/>",
            "f<sub>max</sub>": f"<path d='M9 1V17' stroke='{RED}' stroke-width='1.8' stroke-dasharray='5 3'/>",
        }
        series = (
            uplot.Series(label="Hz"),
            uplot.Series(label="power", stroke=html.GREY, points={"show": False}, fill=SHADE, fillTo=HIDDEN),
            uplot.Series(label="not in the map", stroke=ORANGE, width=0, points=dots(5, ORANGE, "transparent")),
            uplot.Series(label="in the map", stroke=BLUE, width=0, points=dots(7, BLUE, BLUE)),
            uplot.Series(label="f_max", stroke=RED, width=1.5, dash=(6, 4), points={"show": False}),
        )
        with gui.add_folder("Spectrum", expand_by_default=False):
            title = "Mean power (dB re the maximum)"
            self.plot = Plot(gui, title, series, "frequency (Hz)", height=240, legend=False)
            gui.add_html(html.drawings_html(marks))
            self.text = gui.add_html("")
        self.plots = (self.plot,)

    def columns(self, used: tuple[int, ...], limit: float) -> tuple[np.ndarray, ...]:
        """Return the columns of the plot.

        `used`: modes in the map, counted from 1; `limit`: f_max, Hz. The columns are (P,) float64: frequency, Hz, and
        in dB the curve, the dots of modes not in the map, the dots of modes in the map, and the line of f_max.
        """
        x, curve = self._x, self._curve
        inside, columns = np.isin(self._rows, used), [x, curve, *np.full((3, len(x)), HIDDEN)]
        for column, chosen in zip(columns[2:], (~inside, inside), strict=False):
            column[self._at[chosen]] = self._peaks[chosen]
        if not x[0] < limit < x[-1]:
            return tuple(columns)
        at = int(np.searchsorted(x, limit))
        height = float(np.interp(limit, x, curve))
        line = ([limit] * 3, [height] * 3, [HIDDEN] * 3, [HIDDEN] * 3, [HIDDEN, ABOVE, HIDDEN])
        return tuple(np.insert(column, at, more) for column, more in zip(columns, line, strict=True))

    def inputs(self, state: PageState) -> tuple:
        """Return the modes of the map, and f_max of the estimated array, Hz (Eq. 9)."""
        choices, shown, problem = self._binding.choices, state.view.state, self._binding.run.problem
        used = map_modes(self._binding.run, shown, choices.modes, choices.map_order)
        limit = array_f_max(shown.positions, problem.sound_speed, problem.dimension)
        return used, round(limit) if np.isfinite(limit) else limit

    def show(self, state: PageState) -> None:
        """Update the plot, and the text below: the highest mode, f_max, and a warning if the mode is beyond f_max."""
        measurement, problem = self._binding.measurement, self._binding.run.problem
        used, limit = self.inputs(state)
        self.plot.show(self.columns(used, limit), self._range)
        name, _, hertz = row_label(measurement, used[-1]).rpartition(", ")
        what = "highest" if measurement.take_count > 1 else "highest in the map"
        highest = f"<b>{limit:.0f} Hz</b>" if np.isfinite(limit) else "undefined, all estimates coincide"
        lines = [f"{what}: {name}, <b>{hertz}</b>", f"f<sub>max</sub> of the estimates (Eq. 9): {highest}"]
        if problem.search is not None and problem.dimension == 2:  # the expansion of the highest mode (Eq. 3)
            k = problem.wavenumbers[used[-1] - 1 : used[-1]]
            order = int(max_order(k, problem.search.radius, state.view.state.order_offset)[0])
            lines += [f"order L = <b>{order}</b>: {2 * order + 1} functions for {measurement.count} microphones"]
        if measurement.frequencies[used[-1] - 1] > limit:
            beyond = "the map has frequencies beyond f<sub>max</sub>"
            lines += [f"<span style='color: {html.RED}'>&#9888; {beyond}</span>"]
        self.text.content = f"<div style='{html.CARD}'>{'<br>'.join(lines)}</div>"
