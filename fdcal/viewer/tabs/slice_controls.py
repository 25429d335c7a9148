"""The controls of the slice through the isosurfaces: across which axis it lies, and where."""

from __future__ import annotations

from ...graphics.volume import AXES
from ..background.cost_map import CostMap
from ..gui.binding import Binding
from ..gui.choices import SLICES
from ..server.client_values import bounded_number, one_of

LABELS = {axis: label for label, axis in SLICES.items()}


class SliceControls:
    """Owns the controls; those of an array in a plane are never visible.

    `position`: slider, metres.
    """

    def __init__(self, binding: Binding):
        self._binding, gui, style = binding, binding.gui, binding.choices.style
        self.axis = gui.add_dropdown(
            "Slice across", tuple(SLICES), initial_value=LABELS[style.slice_axis],
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
