"""The tab Map: of which microphone and modes the map on the floor is, and how it is drawn."""

from __future__ import annotations

import numpy as np

from ...acoustics.dictionary import max_order
from ...cost.reference_cost import ORDER_OFFSET, decibels
from ...graphics.primitives import format_number
from ...graphics.units import row_word
from ...graphics.volume import AXES
from ...model.measurement import Measurement
from ...model.texts import modes_text, parse_modes
from ...model.validation import InputError
from ..background.cost_map import CostMap, count_label, modes_label, of_take
from ..background.prepare import PreparedRun
from ..gui import html
from ..gui.binding import Binding
from ..gui.choices import (
    BASINS,
    FLOOR,
    MAX_ORDER_OFFSET,
    NOTHING,
    RELIEF,
    SHAPE,
    SLICES,
    VOLUME,
    kind_of,
    kinds_of,
    style_of,
)
from ..gui.legend_html import colour_bar
from ..server.client_values import bounded, bounded_number, one_of


def orders_text(run: PreparedRun, drawn: CostMap | None) -> str:
    """Return the orders of the modes of a map of Eq. 7, as "order L = 3 to 8, ceil(k R) + 2"; "" for others."""
    if drawn is None or drawn.request.order_offset is None or run.problem.search is None:
        return ""
    k = run.problem.wavenumbers[np.asarray(drawn.request.modes) - 1]
    orders = max_order(k, run.problem.search.radius, drawn.request.order_offset)
    low, high = int(orders.min()), int(orders.max())
    text = f"order L = {low if low == high else f'{low} to {high}'}, ceil(k R) + {drawn.request.order_offset}"
    last, word = drawn.request.state.last, row_word(run.measurement)
    used = of_take(run, tuple(range(1, last + 1)), drawn.request.take)
    if drawn.request.custom_modes or drawn.request.modes[-1] == used[-1]:
        return text
    return f"{text}; higher {word}s, up to {last}, have too many functions for {run.measurement.count} microphones"


def caption(drawn: CostMap | None, measurement: Measurement, orders: str = "") -> str:
    """Return what a map shows: its local minima, the cost at the estimated position, the lowest cost.

    `measurement`: whose modes or, of several takes, rows are summed; `orders`: of the modes, in words. Returns HTML.
    """
    if drawn is None:
        return ""
    request, count = drawn.request, drawn.minima
    if request.style.shape:
        text = "Snapshot of the field reconstructed at the estimated positions (Eq. 6)"
        return f"<div style='{html.CARD}'>{text}</div>"
    minima = "no local minimum" if not count else "1 local minimum" if count == 1 else f"{count} local minima"
    several, modes = len(request.modes) > 1, request.modes
    what = f"sum of {count_label(measurement, modes)}" if several else f"{modes_label(measurement, modes)} alone"
    if request.order_offset is None:
        here, lowest = format_number(drawn.cost_here, 4), format_number(drawn.lowest, 4)
    else:
        here, lowest = (f"{decibels(cost):.1f} dB" for cost in (drawn.cost_here, drawn.lowest))
    what = f"microphone {request.microphone}, {what}"
    what += f": <b>{minima}</b> in the map" if request.style.minima else ""
    lowest = f", lowest {lowest}" if request.style.minima else ""
    orders = f"<br>{drawn.note}" * bool(drawn.note) + (f"<br>{orders}" if orders else "")
    orders = f"<br>{drawn.volume.text}{orders}" if drawn.volume is not None and drawn.volume.text else orders
    return f"<div style='{html.CARD}'>{what}<br>cost at the estimate <b>{here}</b>{lowest}{orders}</div>"


AXIS_LABELS = {axis: label for label, axis in SLICES.items()}


class SliceControls:
    """Owns the controls; those of an array in a plane are never visible.

    `position`: slider, metres.
    """

    def __init__(self, binding: Binding):
        self._binding, gui, style = binding, binding.gui, binding.choices.style
        self.axis = gui.add_dropdown(
            "Slice across", tuple(SLICES), initial_value=AXIS_LABELS[style.slice_axis],
            hint="A plane through the isosurfaces, coloured by the cost; it begins at the estimate of the microphone",
        )  # fmt: skip
        low, high = self._ends()
        place = low if style.slice_position is None else bounded_number(style.slice_position, low, high, low)
        self.position = gui.add_slider("Slice at (m)", low, high, 0.01, place, hint="Along that axis")
        binding.on(self.axis, self.cut_across)
        binding.on(self.position, self.cut_at)

    def _ends(self) -> tuple[float, float]:
        """The lowest and the highest place of the slice, metres."""
        search, axis = self._binding.run.problem.search, self._binding.choices.style.slice_axis
        if search is None or axis not in AXES or AXES.index(axis) >= len(search.origin):
            return 0.0, 1.0
        low = search.origin[AXES.index(axis)]
        return float(low), float(low + search.size[AXES.index(axis)])

    def cut_across(self, value) -> None:
        """Lay the slice across another axis, through the estimate of the microphone; or remove it."""
        label = one_of(value, SLICES, "z")
        self._binding.choose_style(slice_axis=SLICES[label], slice_position=None)
        if self.axis.value != label:
            self.axis.value = label
        self.show_relevant(True)

    def cut_at(self, value) -> None:
        """Move the slice to a place along its axis, metres."""
        low, high = self._ends()
        self._binding.choose_style(slice_position=bounded_number(value, low, high, low))

    def show_relevant(self, volume: bool) -> None:
        """Show the controls where there is a volume, the slider where there is a slice."""
        cut = self._binding.choices.style.slice_axis in AXES
        self.axis.visible, self.position.visible = volume, volume and cut
        low, high = self._ends()
        if (self.position.min, self.position.max) != (low, high):
            self.position.min, self.position.max = low, high

    def show(self, drawn: CostMap | None) -> None:
        """Move the slider to a slice that goes through the estimate; called by the main loop."""
        plate = None if drawn is None or drawn.volume is None else drawn.volume.plate
        if plate is not None and self._binding.choices.style.slice_position is None:
            low, high = self._ends()
            place = min(max(round(plate.position, 2), low), high)
            self._binding.send("slice", (plate.axis, place), self, "place")

    @property
    def place(self) -> tuple[int, float]:
        """Axis and place of the slider."""
        return AXES.find(self._binding.choices.style.slice_axis), float(self.position.value)

    @place.setter
    def place(self, wanted: tuple[int, float]) -> None:
        self.position.value = wanted[1]


SAME_AS_SOLVER, CUSTOM = "Same as solver", "Custom"
LINEAR, LOG = "Linear", "Logarithmic"
EQ7, OBJECTIVE = "Cost, Eq. 7", "Solver's objective"
QUANTITIES: tuple[str, ...] = (EQ7, OBJECTIVE)
SCALES: tuple[str, ...] = (LOG, LINEAR)
ALL_TAKES = "All takes"
NO_SEARCH = (
    "No map: the file has no search domain, and the positions could not be estimated to make one. Add search_origin,"
    " search_size, search_step and radius (metres) to the file of the measurement."
)


def take_label(take: int | None) -> str:
    """Return what the list of takes calls one of them, or all."""
    return ALL_TAKES if take is None else f"Take {take}"


class MapTab:
    """Owns the controls of the tab."""

    def __init__(self, binding: Binding):
        self._binding = binding
        self._possible = binding.run.problem.search is not None
        self.kinds = kinds_of(binding.measurement)
        self._add_microphone()
        self._add_take()
        self._add_modes()
        self._add_quantity()
        self._add_style()
        self.caption = binding.gui.add_html(colour_bar(None))
        self._show_relevant()
        self._listen()

    def _add_microphone(self) -> None:
        binding, choices = self._binding, self._binding.choices
        self.microphone = binding.gui.add_slider(
            "Microphone", 0, binding.measurement.count - 1, 1, choices.microphone,
            hint="Or click a microphone in the scene; drag it to move its estimate",
        )  # fmt: skip
        self.follow = binding.gui.add_checkbox(
            "Follow solver", choices.follow, hint="Show the microphone that the last step moved"
        )
        self.follow.visible = not binding.run.solver.TRAITS.moves_all

    def _add_take(self) -> None:
        """Add the list of takes, where there are several."""
        self.take = None
        if self._binding.measurement.take_count > 1:
            self.take = self._binding.gui.add_dropdown(
                "Take", (ALL_TAKES, *self._takes), initial_value=take_label(self._binding.choices.take),
                hint="Whose rows the maps sum and whose spectrum is shown; a take is one place of the source",
            )  # fmt: skip

    @property
    def _takes(self) -> dict[str, int]:
        """The takes by their labels."""
        return {take_label(take): take for take in np.unique(self._binding.measurement.takes).tolist()}

    def _add_modes(self) -> None:
        binding, modes, row = self._binding, self._binding.choices.modes, self._binding.row
        self.which = binding.gui.add_dropdown(
            f"{row.title()}s shown", (SAME_AS_SOLVER, CUSTOM),
            initial_value=SAME_AS_SOLVER if modes is None else CUSTOM,
            hint="Of the map; the solver keeps its own",
        )  # fmt: skip
        modes = modes or (1,)
        self.upto = binding.gui.add_slider(
            f"Up to {row}", 1, binding.modes, 1, modes[-1], hint=f"From {row} 1 to this one; the tab Sweep plays this"
        )
        self.text = binding.gui.add_text(f"{row.title()} numbers", modes_text(modes), hint="For example 1-3, 5")

    def _add_quantity(self) -> None:
        gui, choices = self._binding.gui, self._binding.choices
        self.quantity = gui.add_dropdown(
            "Quantity", QUANTITIES, initial_value=OBJECTIVE if choices.objective else EQ7,
            hint="Eq. 7 compares all solvers; the objective is what this solver minimises",
        )  # fmt: skip
        self.order = gui.add_slider(
            "Extra orders", 0, MAX_ORDER_OFFSET, 1, choices.order_offset,
            hint="Order of each mode L = ceil(k R) + this number; 0 is the paper's Eq. 3",
        )  # fmt: skip

    def _add_style(self) -> None:
        gui, choices = self._binding.gui, self._binding.choices
        self.kind = gui.add_dropdown("Show", self.kinds, initial_value=kind_of(choices), visible=self._possible)
        self.relief = gui.add_slider(
            "Relief height (%)", 5, 100, 5, round(100 * choices.style.relief_height),
            hint="Of the highest cost, of the longer side of the map",
        )  # fmt: skip
        self.slice = SliceControls(self._binding)
        self.scale = gui.add_dropdown("Scale", SCALES, initial_value=LOG if choices.style.log else LINEAR)
        self.minima = gui.add_checkbox("Mark minima", choices.style.minima, hint="Mark and count the local minima")
        self.opacity = gui.add_slider("Opacity (%)", 10, 100, 5, round(100 * choices.style.opacity))

    def _show_relevant(self) -> None:
        """Hide the controls that have no effect on the kind of map, and all of them where there can be no map."""
        choices = self._binding.choices
        kind = kind_of(choices) if self._possible else NOTHING
        self.which.visible = kind != NOTHING
        self.upto.visible = self.text.visible = choices.modes is not None and kind != NOTHING
        of_cost, in_space = kind in (FLOOR, RELIEF, VOLUME, BASINS), kind != NOTHING and choices.style.volume
        self.scale.visible = of_cost and kind != BASINS
        self.minima.visible = of_cost
        self.quantity.visible = of_cost and not in_space
        self.order.visible = of_cost and choices.map_order is not None
        self.opacity.visible = kind in (FLOOR, SHAPE, VOLUME, BASINS)
        self.relief.visible = kind == RELIEF
        self.slice.show_relevant(in_space)

    def refresh(self) -> None:
        """Let visibility follow the choices."""
        self._show_relevant()

    def _listen(self) -> None:
        binding = self._binding
        binding.on(self.microphone, self.choose_microphone)
        binding.on(self.follow, lambda value: self.follow_solver(bool(value)))
        if self.take is not None:
            binding.on(self.take, self.choose_take)
        binding.on(self.which, lambda value: self.choose_modes(self._in_use() if value == CUSTOM else None))
        binding.on(self.upto, lambda value: self.choose_modes(range(1, bounded(value, 1, binding.modes, 1) + 1)))
        binding.on(self.text, self._read)
        binding.on(self.quantity, self.show_quantity)
        binding.on(self.order, self.set_order)
        binding.on(self.kind, self.show_as)
        binding.on(self.scale, self.scale_as)
        binding.on(self.minima, lambda value: self.mark_minima(bool(value)))
        binding.on(self.opacity, self.fade)
        binding.on(self.relief, self.raise_relief)

    @property
    def _selected(self) -> int:
        """The microphone that the page shows."""
        return self._bounded_microphone(self.microphone.value)

    def _bounded_microphone(self, value) -> int:
        return bounded(value, 0, self._binding.measurement.count - 1, self._binding.choices.microphone)

    def choose_microphone(self, value) -> None:
        """Show the map of a microphone, and stop following the solver."""
        self._binding.choose(microphone=self._bounded_microphone(value), follow=False)
        self.follow.value = False

    def pick(self, number: int) -> None:
        """Show the map of a microphone that was chosen outside of the tab."""
        self.choose_microphone(number)
        self.microphone.value = self._binding.choices.microphone

    def choose_take(self, value) -> None:
        """Show the maps and the spectrum of a take, by its label; of all takes for any other text."""
        take = self._takes.get(str(value))
        self._binding.choose(take=take)
        if self.take is not None and self.take.value != take_label(take):
            self.take.value = take_label(take)

    def follow_solver(self, follow: bool) -> None:
        """Show the microphone that the last step moved, or stay with the present one."""
        self._binding.choose(follow=follow, microphone=self._selected)
        self.follow.value = follow

    def choose_modes(self, modes) -> None:
        """Show the map of these modes, counted from 1; None for those that the solver uses."""
        modes = None if modes is None else tuple(modes)
        self._binding.choose(modes=modes, modes_error="")
        self.which.value = SAME_AS_SOLVER if modes is None else CUSTOM
        self._show_relevant()
        if modes is not None:
            self.text.value, self.upto.value = modes_text(modes), modes[-1]

    def toggle_mode(self, mode: int) -> None:
        """Add a mode to the map or remove it; the last one stays."""
        modes = set(self._binding.choices.modes or self._in_use()) ^ {mode}
        if modes:
            self.choose_modes(sorted(modes))

    def _in_use(self) -> tuple[int, ...]:
        state = self._binding.session.view.state
        return tuple(range(state.first, state.last + 1))

    def _read(self, text) -> None:
        """Show the map of the modes that a text names; a text that cannot be read changes nothing but the error."""
        try:
            modes = parse_modes(text, self._binding.modes)
        except InputError as error:
            self._binding.choose(modes_error=html.error_message(error))
            return
        self._binding.choose(modes=modes, modes_error="")
        self.upto.value = modes[-1]

    def show_quantity(self, value) -> None:
        """Show EQ7 or OBJECTIVE."""
        quantity = one_of(value, QUANTITIES, EQ7)
        self._binding.choose(objective=quantity == OBJECTIVE)
        self._show_relevant()
        if self.quantity.value != quantity:
            self.quantity.value = quantity

    def set_order(self, value) -> None:
        """Set what is added to ceil(k R) in the order of every mode of the map."""
        offset = bounded(value, 0, MAX_ORDER_OFFSET, ORDER_OFFSET)
        self._binding.choose(order_offset=offset)
        if self.order.value != offset:
            self.order.value = offset

    def show_as(self, value) -> None:
        """Show one of `kinds`."""
        kind = one_of(value, self.kinds, FLOOR)
        self._binding.choose(shown=kind != NOTHING)
        self._binding.choose_style(**style_of(kind, self._binding.measurement))
        self._show_relevant()
        if self.kind.value != kind:
            self.kind.value = kind

    def scale_as(self, value) -> None:
        """Use the scale LOG or LINEAR."""
        scale = one_of(value, SCALES, LOG)
        self._binding.choose_style(log=scale == LOG)
        if self.scale.value != scale:
            self.scale.value = scale

    def mark_minima(self, marked: bool) -> None:
        """Mark and count the local minima, or not."""
        self._binding.choose_style(minima=marked)
        if self.minima.value != marked:
            self.minima.value = marked

    def fade(self, value) -> None:
        """Set the opacity of the map, %."""
        self._binding.choose_style(opacity=bounded(value, 10, 100, 100) / 100)

    def raise_relief(self, value) -> None:
        """Set the height of the highest cost in a relief, % of the longer side of the map."""
        self._binding.choose_style(relief_height=bounded(value, 5, 100, 30) / 100)

    def show(self, microphone: int, drawn: CostMap | None, reason: str) -> None:
        """Bring the tab up to date; called by the main loop.

        `microphone`: whose map is shown, counted from 0; `drawn`: CostMap on the floor, or None; `reason`: why there is
        no map, "" where it is only not ready.
        """
        binding, choices = self._binding, self._binding.choices
        if not choices.follow and choices.microphone == microphone:
            binding.sent["microphone"] = microphone  # set by the user, who may still be dragging the slider
        binding.send("microphone", microphone, self.microphone)
        self.slice.show(drawn)
        key = None if drawn is None else id(drawn.floor or drawn.volume), reason, choices.modes_error, choices.shown
        if binding.sent.get("map") == key:
            return
        binding.sent["map"] = key
        reason = reason or (NO_SEARCH if not self._possible else "computing the map ..." if choices.shown else "no map")
        scale = "" if drawn and drawn.areas else colour_bar(drawn.bar if drawn else None, reason)
        text = (
            html.complaint(choices.modes_error)
            + scale
            + caption(drawn, binding.measurement, orders_text(binding.run, drawn))
        )
        binding.send("caption of the map", text, self.caption, "content")
