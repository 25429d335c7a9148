"""The tab Modes: the power spectrum, which of its modes are in the map, and switches for each mode."""

from __future__ import annotations

import numpy as np
import viser

from ...acoustics.dictionary import array_f_max, max_order
from ...graphics.units import row_word
from ...model.measurement import Measurement
from ...session.history import SessionView
from ..background.map_panels import map_modes, of_take, row_label
from ..gui import html
from ..gui.binding import Binding
from ..gui.choices import FLOOR
from ..gui.legend_html import spectrum_legend
from ..gui.plots import BLUE, ORANGE, RED
from ..server.client_values import bounded
from .map import MapTab
from .spectrum_plot import GREY, SpectrumPlot

COLUMNS, ROWS = 4, 6  # of switches
INTERVAL = 0.25  # s between two updates of the plot


class ModesTab:
    """Owns the controls of the tab."""

    def __init__(self, binding: Binding, map_tab: MapTab):
        self._binding, self._map, self._updated = binding, map_tab, -1e9
        self._key: tuple = ()
        gui, modes = binding.gui, binding.modes
        self.spectrum = SpectrumPlot(gui, binding.measurement, modes)
        gui.add_html(spectrum_legend(self.spectrum.has_spectrum, BLUE, ORANGE, RED, GREY))
        self.text = gui.add_html("")
        row = binding.row
        self.low = gui.add_slider(f"From {row}", 1, modes, 1, 1, hint=f"First {row} of the map")
        self.high = gui.add_slider(f"To {row}", 1, modes, 1, 1, hint=f"Last {row} of the map")
        self.same = gui.add_button("Same as solver", hint=f"Show the map of the {row}s that the solver uses")
        binding.on(self.low, lambda value: self._slide(value, self.high.value))
        binding.on(self.high, lambda value: self._slide(min(self.low.value, value), value))
        binding.on(self.same, lambda _: map_tab.choose_modes(None))
        self.switches = [self._add_row(modes) for modes in self._switched(None)]
        self.others = gui.add_html("")
        self._show_others()

    def _switched(self, take: int | None) -> list[tuple[int, ...]]:
        """Return the modes that have a switch, row by row: the lowest of a take, or of all."""
        shown = self._of_take(take)[: COLUMNS * ROWS]
        return [shown[i : i + COLUMNS] for i in range(0, len(shown), COLUMNS)]

    def _of_take(self, take: int | None) -> tuple[int, ...]:
        return of_take(self._binding.run, tuple(range(1, self._binding.modes + 1)), take)

    def _show_others(self) -> None:
        """Say how the modes without a switch are chosen, if there are any."""
        binding = self._binding
        rest, words = self._of_take(binding.choices.take)[COLUMNS * ROWS :], binding.row.title()
        text = (
            f'{words}s {rest[0]} to {rest[-1]}: use the sliders, or "{words} numbers" in the tab Map.' if rest else ""
        )
        binding.send("other modes", html.remark(text) if text else "", self.others, "content")

    def _slide(self, low, high) -> None:
        """Show the map of all modes between two; where `low` exceeds `high`, of `low` alone."""
        low, high = (bounded(value, 1, self._binding.modes, 1) for value in (low, high))
        self._show_map()
        self._map.choose_modes(range(low, max(low, high) + 1))

    def _show_map(self) -> None:
        """Switch the map on where there is none: the user chooses modes for a map."""
        if not self._binding.choices.shown:
            self._map.show_as(FLOOR)

    def _add_row(self, modes: tuple[int, ...]) -> viser.GuiButtonGroupHandle:
        hint = f"Add a {self._binding.row} to the map or remove it; a filled dot is in the map"
        row = self._binding.gui.add_button_group(f"{modes[0]} to {modes[-1]}", _labels(modes, ()), hint=hint)
        self._binding.on(row, self.press)
        return row

    def press(self, label) -> None:
        """Act on a switch, whose label ends with the number of its mode; ignore any other label."""
        number = str(label)[1:4]
        if number.isdecimal() and 1 <= int(number) <= self._binding.modes:
            self._show_map()
            self._map.toggle_mode(int(number))

    def show(self, view: SessionView, now: float) -> None:
        """Bring the tab up to date; called by the main loop."""
        binding, state = self._binding, view.state
        choices = binding.choices
        order_offset = None if choices.objective else choices.order_offset
        used = map_modes(binding.run, state, choices.modes, order_offset, choices.take)
        problem = binding.run.problem
        limit = array_f_max(state.positions, problem.sound_speed, problem.dimension)
        limit = round(limit) if np.isfinite(limit) else limit
        key = used, limit, choices.take
        if key == self._key or now - self._updated < INTERVAL:
            return
        self._key, self._updated = key, now
        self.spectrum.show(used, limit, choices.take)
        self.text.content = caption(binding.measurement, used, limit, self._order(state, used[-1]))
        binding.send("first mode of the map", used[0], self.low)
        binding.send("last mode of the map", used[-1], self.high)
        switched = self._switched(choices.take)
        for number, row in enumerate(self.switches):  # a take has no more of them than all takes
            modes = switched[number] if number < len(switched) else ()
            binding.send(f"switches {number}", _labels(modes, used), row, "options")
            binding.send(f"switched {number}", f"{modes[0]} to {modes[-1]}" if modes else "", row, "label")
            binding.send(f"has switches {number}", bool(modes), row, "visible")
        self._show_others()

    def _order(self, state, mode: int) -> int | None:
        """Return the order L of the expansion of a mode (Eq. 3); None where no radius is given."""
        problem = self._binding.run.problem
        if problem.search is None or problem.dimension != 2:
            return None
        radius, wavenumbers = problem.search.radius, problem.wavenumbers[mode - 1 : mode]
        return int(max_order(wavenumbers, radius, state.order_offset)[0])


def _labels(modes: tuple[int, ...], used: tuple[int, ...]) -> tuple[str, ...]:
    """Return the labels of a row of switches: a filled dot for a mode in the map."""
    return tuple(f"{'●' if mode in used else '○'}{mode}" for mode in modes)


def caption(measurement: Measurement, used: tuple[int, ...], limit: float, order: int | None) -> str:
    """Return the highest mode of the map, the highest frequency of the array, and a warning beyond it.

    `used`: modes in the map, counted from 1, ascending; `limit`: f_max of the estimated positions (Eq. 9); `order`: L
    of the highest mode (Eq. 3), or None. Returns HTML.
    """
    f, count = float(measurement.frequencies[used[-1] - 1]), measurement.count
    highest = f"<b>{limit:.0f} Hz</b>" if np.isfinite(limit) else "undefined, all estimates coincide"
    name, _, hertz = row_label(measurement, used[-1]).rpartition(", ")
    what = "highest" if measurement.take_count > 1 else "highest in the map"
    lines = [f"{what}: {name}, <b>{hertz}</b>"]
    lines += [f"f<sub>max</sub> of the estimates (Eq. 9): {highest}"]
    if order is not None:
        lines += [f"order L = <b>{order}</b>: {2 * order + 1} functions for {count} microphones"]
    if f > limit:
        beyond = f"the map has {row_word(measurement)}s beyond f<sub>max</sub>"
        lines += [f"<span style='color: {html.RED}'>&#9888; {beyond}</span>"]
    return f"<div style='{html.CARD}'>{'<br>'.join(lines)}</div>"
