"""Which map lies on the floor, and how it is drawn."""

from __future__ import annotations

from ...model import mode_ranges
from ...model.validation import InputError
from ..background.cost_maps import CostMap
from ..gui import html
from ..gui.binding import FLOOR, NOTHING, RELIEF, SHAPE, Binding, Choices
from ..server.client_values import bounded, one_of

IN_USE, CHOSEN = "Those in use", "Chosen here"
KINDS = (FLOOR, RELIEF, SHAPE, NOTHING)
LINEAR, LOG = "Linear", "Logarithmic"


NO_SEARCH = "No map: nothing tells within which bounds to look for the microphones (search domain)."


def _why_none(choices: Choices) -> str:
    """Why there is no map."""
    return "map under way ..." if choices.shown else "no map"


def _kind_of(choices: Choices) -> str:
    if not choices.shown:
        return NOTHING
    return RELIEF if choices.look.relief else SHAPE if choices.look.shape else FLOOR


class MapTab:
    """Owns the handles of the tab."""

    def __init__(self, binding: Binding):
        self._binding, gui, choices = binding, binding.gui, binding.choices
        highest, look, chosen = binding.measurement.count - 1, choices.look, choices.modes is not None
        self.microphone = gui.add_slider(
            "Microphone", 0, highest, 1, choices.microphone, hint="Or click one in the scene; drag one to move it"
        )
        self.follow = gui.add_checkbox(
            "Follow solver", choices.follow, hint="Show the microphone that a step has moved"
        )
        self.follow.visible = not binding.work.solver.TRAITS.moves_all
        self._possible = binding.work.problem.search is not None
        kind, modes = _kind_of(choices), choices.modes or (1,)
        self.which = gui.add_dropdown(
            "Modes shown", (IN_USE, CHOSEN), initial_value=CHOSEN if chosen else IN_USE, hint="Of the map alone"
        )
        self.upto = gui.add_slider("Up to mode", 1, binding.modes, 1, modes[-1], hint="Watch the minima merge")
        self.text = gui.add_text("Mode numbers", mode_ranges.to_text(modes), hint="As in 1-3, 5")
        self.kind = gui.add_dropdown("Show", KINDS, initial_value=kind, visible=self._possible)
        self.scale = gui.add_dropdown("Scale", (LOG, LINEAR), initial_value=LOG if look.log else LINEAR)
        self.opacity = gui.add_slider("Opacity (%)", 10, 100, 5, round(100 * look.opacity))
        self.bar = gui.add_html(html.colour_bar(None))
        self._show_what_counts()
        self._listen()

    def _show_what_counts(self) -> None:
        """The controls that mean nothing for the kind of map, or where there can be none, are not shown."""
        kind, chosen = (
            _kind_of(self._binding.choices) if self._possible else NOTHING,
            self._binding.choices.modes is not None,
        )
        self.which.visible = kind != NOTHING
        self.upto.visible = self.text.visible = chosen and kind != NOTHING
        self.scale.visible = kind in (FLOOR, RELIEF)
        self.opacity.visible = kind in (FLOOR, SHAPE)

    def _listen(self) -> None:
        binding = self._binding
        binding.on(self.microphone, self.choose_microphone)
        binding.on(self.follow, lambda value: self.follow_solver(bool(value)))
        binding.on(self.which, self._choose_which)
        binding.on(self.upto, lambda value: self.choose_modes(range(1, bounded(value, 1, binding.modes, 1) + 1)))
        binding.on(self.text, self._read)
        binding.on(self.kind, self.show_as)
        binding.on(self.scale, self.scale_as)
        binding.on(self.opacity, lambda value: binding.look(opacity=bounded(value, 10, 100, 100) / 100))

    @property
    def _looked_at(self) -> int:
        """The microphone that the page shows."""
        return bounded(self.microphone.value, 0, self._binding.measurement.count - 1, self._binding.choices.microphone)

    def choose_microphone(self, value) -> None:
        """A microphone chosen by hand is stayed with."""
        number = bounded(value, 0, self._binding.measurement.count - 1, self._binding.choices.microphone)
        self._binding.choose(microphone=number, follow=False)
        self.follow.value = False

    def pick(self, number: int) -> None:
        """A microphone chosen in the scene."""
        self.choose_microphone(number)
        self.microphone.value = self._binding.choices.microphone

    def follow_solver(self, wanted: bool) -> None:
        """Show the microphone that a step has moved, or stay with the one that is shown."""
        self._binding.choose(follow=wanted, microphone=self._looked_at)
        self.follow.value = wanted

    def choose_modes(self, modes) -> None:
        """The map of just these modes, counted from 1; None for those in use."""
        modes = None if modes is None else tuple(modes)
        self._binding.choose(modes=modes, complaint="")
        self.which.value = IN_USE if modes is None else CHOSEN
        self._show_what_counts()
        if modes is not None:
            self.text.value, self.upto.value = mode_ranges.to_text(modes), modes[-1]

    def toggle_mode(self, mode: int) -> None:
        """Switch one mode of the map on or off; the last one stays."""
        now = set(self._binding.choices.modes or self._in_use()) ^ {mode}
        if now:
            self.choose_modes(sorted(now))

    def _in_use(self) -> tuple[int, ...]:
        state = self._binding.session.view.state
        return tuple(range(state.first, state.last + 1))

    def _choose_which(self, value) -> None:
        self.choose_modes(self._in_use() if value == CHOSEN else None)

    def _read(self, text) -> None:
        """A text that cannot be read is told below and changes nothing."""
        try:
            modes = mode_ranges.parse(text, self._binding.modes)
        except InputError as error:
            self._binding.choose(complaint=str(error))
            return
        self._binding.choose(modes=modes, complaint="")
        self.upto.value = modes[-1]

    def show_as(self, value) -> None:
        """One of KINDS."""
        kind = one_of(value, KINDS, FLOOR)
        self._binding.choose(shown=kind != NOTHING)
        self._binding.look(relief=kind == RELIEF, shape=kind == SHAPE)
        self._show_what_counts()
        if self.kind.value != kind:
            self.kind.value = kind

    def scale_as(self, value) -> None:
        """LOG or LINEAR."""
        scale = one_of(value, (LOG, LINEAR), LOG)
        self._binding.look(log=scale == LOG)
        if self.scale.value != scale:
            self.scale.value = scale

    def show(self, microphone: int, drawn: CostMap | None, trouble: str) -> None:
        """Called by the main loop, with the map on the floor or why there is none."""
        binding = self._binding
        if not binding.choices.follow and binding.choices.microphone == microphone:
            binding.sent["microphone"] = microphone  # set by a hand, which may hold it still
        binding.send("microphone", microphone, self.microphone)
        complaint = binding.choices.complaint
        key = None if drawn is None else id(drawn.floor), trouble, complaint, binding.choices.shown
        if binding.sent.get("map") != key:
            binding.sent["map"] = key
            wanted = _why_none(binding.choices) if self._possible else NO_SEARCH
            bar = html.colour_bar(drawn.floor.bar if drawn else None, trouble or wanted) + html.map_lines(drawn)
            binding.send("bar", html.complaint(complaint) + bar, self.bar, "content")
