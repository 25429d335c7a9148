"""The tab Map: the microphone and the modes of the map, and how it is drawn."""

from collections.abc import Callable

import numpy as np

from ...acoustics.dictionary import max_order
from ...graphics.picture import row_word
from ...model.address import SOLVER
from ...model.measurement import Measurement
from ...model.validation import InputError, modes_text, parse_modes
from .. import html
from ..binding import Binding, Tab
from ..cost_maps import MAP_KINDS, CostMap, count_label, modes_label
from ..prepare import PreparedRun
from ..scheduler import Memo
from ..state import MAX_ORDER_OFFSET, Choices, PageState, has_volume


def orders_text(run: PreparedRun, drawn: CostMap | None) -> str:
    """Return the orders of the modes of a map of Eq. 7, as "order L = 3 to 8, ceil(k R) + 2"; "" for others."""
    if drawn is None or drawn.request.order_offset is None or run.problem.search is None:
        return ""
    k = run.problem.wavenumbers[np.asarray(drawn.request.modes) - 1]
    orders = max_order(k, run.problem.search.radius, drawn.request.order_offset)
    low, high = int(orders.min()), int(orders.max())
    text = f"order L = {low if low == high else f'{low} to {high}'}, ceil(k R) + {drawn.request.order_offset}"
    last, word = drawn.request.state.last, row_word(run.measurement)
    if drawn.request.custom_modes or drawn.request.modes[-1] == last:
        return text
    count, used = len(drawn.request.modes), last + 1 - drawn.request.state.first
    higher = f"the higher ones have too many functions for {run.measurement.count} microphones"
    return f"{text}; {count} of the {used} {word}s that the solver uses: {higher}"


def caption(drawn: CostMap | None, measurement: Measurement, orders: str = "") -> str:
    """Return the caption of a map as HTML: its local minima, the cost at the estimated position, the lowest cost.

    `orders`: those of the modes, in words.
    """
    if drawn is None:
        return ""
    request, found = drawn.request, drawn.minima
    if found is None:
        text = "Snapshot of the field reconstructed at the estimated positions (Eq. 6)"
        return f"<div style='{html.CARD}'>{text}</div>"
    minima = "no local minimum" if not found.count else f"{found.count} local minim{'um' if found.count == 1 else 'a'}"
    several, modes = len(request.modes) > 1, request.modes
    what = f"sum of {count_label(measurement, modes)}" if several else f"{modes_label(measurement, modes)} alone"
    here, lowest = map(drawn.text_of, (drawn.cost_here, drawn.lowest))
    cost = f"cost at the estimate <b>{here}</b>"
    if drawn.base is not None:
        at_lowest = drawn.cost_here <= drawn.lowest
        cost = "the estimate is at the lowest place of the map" if at_lowest else f"{cost} above the lowest"
    what = f"microphone {request.microphone}, {what}"
    what += f": <b>{minima}</b> in the map" if request.style.minima else ""
    if found.end is not None and drawn.base is None:
        lowest = f"below {drawn.text_of(found.end)}"
    places = f" at {len(found.lowest)} places" if len(found.lowest) > 1 else ""
    lowest = f", lowest {lowest}{places}" if request.style.minima and drawn.base is None else ""
    orders = f"<br>{orders}" if orders else ""
    orders = f"<br>{drawn.volume.text}{orders}" if drawn.volume is not None and drawn.volume.text else orders
    return f"<div style='{html.CARD}'>{what}<br>{cost}{lowest}{orders}</div>"


LINEAR, LOG = "Linear", "Logarithmic"
OBJECTIVE, EQ7 = "What the method minimises", "Eq. 7, for comparison"
NO_SEARCH = f"No map: {html.NO_DOMAIN}"
LABELS = {
    "flat": "Flat map", "relief": "Relief", "shape": "Mode shape (last mode)",
    "volume": "Isosurfaces (3-D)", "none": "No map",
}  # fmt: skip


class MapTab(Tab):
    """Owns the controls of the tab, each of which is visible if it has an effect on the kind of map.

    `kinds`: the kinds of map that are possible.
    """

    where, order = "Map", 1

    def __init__(self, binding: Binding):
        self._binding, self._possible = binding, binding.run.problem.search is not None
        self._caption, self._risen = Memo(), ""  # `_risen` is the kind of map that `rise` has chosen
        self.kinds = tuple(kind for kind in MAP_KINDS if kind != "volume" or has_volume(binding.measurement))
        labels = {LABELS[kind]: kind for kind in self.kinds}
        choices, row, choose = binding.choices, binding.row, binding.choose

        def of_kind(*kinds: str) -> Callable[[Choices], bool]:
            return lambda choices: self._possible and choices.kind in kinds

        mapped, of_cost = of_kind(*MAP_KINDS[:-1]), of_kind("flat", "relief", "volume")
        self.kind = binding.dropdown(
            "Show", tuple(labels), lambda choices: LABELS[choices.kind], lambda label: self.show_as(labels[label]),
            visible=self._possible,
        )  # fmt: skip
        self.microphone = binding.slider(
            "Microphone", 0, binding.measurement.count - 1, 1, choices.microphone, self.choose_microphone,
            command="microphone", hint="Or click a microphone in the scene; drag it to move its estimate",
        )  # fmt: skip
        self.follow = binding.checkbox(
            "Follow the run", lambda choices: choices.follow, self.follow_solver,
            visible=not binding.run.solver.TRAITS.moves_all, hint="Show the microphone that the next step moves",
        )  # fmt: skip
        self.text = binding.on(
            binding.gui.add_text(
                f"{row.title()} numbers", SOLVER if choices.modes is None else modes_text(choices.modes),
                hint=f'Of the map, for example 1-3, 5; "{SOLVER}" for those that the solver uses',
            ),
            self._read,
        )  # fmt: skip
        binding.follow(self.text, visible=mapped)
        self.caption = binding.gui.add_html("")
        with binding.gui.add_folder("Scale and quantity", expand_by_default=False):
            self.quantity = binding.dropdown(
                "Quantity", (OBJECTIVE, EQ7), lambda choices: OBJECTIVE if choices.objective else EQ7,
                lambda value: choose(objective=value == OBJECTIVE),
                visible=lambda choices: of_cost(choices) and not choices.volume,
                hint="Eq. 7 at one order is the same for all methods",
            )  # fmt: skip
            self.order = binding.slider(
                "Extra orders", 0, MAX_ORDER_OFFSET, 1, lambda choices: choices.order_offset,
                lambda value: choose(order_offset=value),
                visible=lambda choices: of_cost(choices) and choices.map_order is not None,
                hint="Order of each mode L = ceil(k R) + this number; 0 is the paper's Eq. 3",
            )  # fmt: skip
            self.scale = binding.dropdown(
                "Scale", (LOG, LINEAR), lambda choices: LOG if choices.log else LINEAR,
                lambda value: choose(log=value == LOG), visible=of_kind("flat", "relief", "volume"),
            )  # fmt: skip
            self.minima = binding.checkbox(
                "Mark minima", lambda choices: choices.minima, lambda value: choose(minima=value), visible=mapped,
                hint="Mark and count the local minima; of a mode shape, where the microphone would measure the same",
            )  # fmt: skip

    def choose_microphone(self, number: int) -> None:
        """Show the map of a microphone, and stop following the solver."""
        self._binding.choose(microphone=number, follow=False)

    def pick(self, number: int) -> None:
        """Show the map of a microphone that was chosen outside of the tab; the number is clipped to the array."""
        self.choose_microphone(min(max(number, 0), self._binding.measurement.count - 1))
        self.microphone.value = self._binding.choices.microphone

    def follow_solver(self, follow: bool) -> None:
        """Show the microphone that the next step moves, or stay with the present one."""
        self._binding.choose(follow=follow, microphone=self.microphone.value)

    def choose_modes(self, modes) -> None:
        """Show the map of these modes, counted from 1; None for those that the solver uses."""
        modes = None if modes is None else tuple(modes)
        self._binding.choose(modes=modes, modes_error="")
        self.text.value = SOLVER if modes is None else modes_text(modes)

    def _read(self, text) -> None:
        """Show the map of the modes that a text names; for an invalid text, show only the error."""
        try:
            modes = None if text == SOLVER else parse_modes(text, self._binding.modes)
        except InputError as error:
            self._binding.choose(modes_error=html.error_message(error))
            return
        self._binding.choose(modes=modes, modes_error="")

    def show_as(self, kind: str) -> None:
        """Show a kind of map, or a flat map if that kind is not possible."""
        self._binding.choose(kind=kind if kind in self.kinds else "flat")

    def show_some(self) -> None:
        """Show a flat map if no map is shown."""
        if self._binding.choices.kind == "none":
            self.show_as("flat")

    def rise(self) -> None:
        """Replace a flat map by isosurfaces, or by a relief for a plane array."""
        if self._binding.choices.kind == "flat":
            self._risen = "volume" if "volume" in self.kinds else "relief"
            self.show_as(self._risen)

    def lie(self) -> None:
        """Show the flat map again after `rise`, unless another kind was chosen in between."""
        if self._binding.choices.kind == self._risen:
            self.show_as("flat")
        self._risen = ""

    def show(self, tick: PageState) -> None:
        """Update the microphone and the caption."""
        binding, run, choices, drawn = self._binding, self._binding.run, self._binding.choices, tick.drawn
        if not choices.follow and choices.microphone == tick.microphone:
            binding.sent[id(self.microphone)] = tick.microphone  # set by the user, who may still be dragging the slider
        binding.send(self.microphone, tick.microphone)
        reason = NO_SEARCH if not self._possible else "computing the map ..." if choices.kind != "none" else "no map"
        words = drawn and self._caption(lambda: caption(drawn, run.measurement, orders_text(run, drawn)), drawn)
        self.caption.content = html.complaint(choices.modes_error) + (words or html.remark(tick.reason or reason))
