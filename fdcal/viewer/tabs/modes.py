"""The tab Modes: the power spectrum, which of its modes are in the map, and switches for each mode."""

from __future__ import annotations

import numpy as np
import viser

from ...acoustics.fourier_bessel import array_f_max, max_order
from ...model.measurement import Measurement
from ...session.history import SessionView
from ..background.map_panels import map_modes
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
    """Owns the controls of the tab.

    Attributes
    ----------
    spectrum : SpectrumPlot
    """

    def __init__(self, binding: Binding, map_tab: MapTab):
        self._binding, self._map, self._updated = binding, map_tab, -1e9
        self._key: tuple = ()
        gui, modes = binding.gui, binding.modes
        self.spectrum = SpectrumPlot(gui, binding.measurement, modes)
        gui.add_html(spectrum_legend(self.spectrum.has_spectrum, BLUE, ORANGE, RED, GREY))
        self.text = gui.add_html("")
        self.low = gui.add_slider("From mode", 1, modes, 1, 1, hint="First mode of the map")
        self.high = gui.add_slider("To mode", 1, modes, 1, 1, hint="Last mode of the map")
        self.same = gui.add_button("Same as solver", hint="Show the map of the modes that the solver uses")
        binding.on(self.low, lambda value: self._slide(value, self.high.value))
        binding.on(self.high, lambda value: self._slide(min(self.low.value, value), value))
        binding.on(self.same, lambda _: map_tab.choose_modes(None))
        count = min(modes, COLUMNS * ROWS)
        self.switches = [self._add_row(i, min(i + COLUMNS - 1, count)) for i in range(1, count + 1, COLUMNS)]
        if count < modes:
            text = f'Modes {count + 1} to {modes}: use the sliders, or "Mode numbers" in the tab Map.'
            gui.add_html(html.remark(text))

    def _slide(self, low, high) -> None:
        """Show the map of all modes between two; where `low` exceeds `high`, of `low` alone."""
        low, high = (bounded(value, 1, self._binding.modes, 1) for value in (low, high))
        self._show_map()
        self._map.choose_modes(range(low, max(low, high) + 1))

    def _show_map(self) -> None:
        """Switch the map on where there is none: the user chooses modes for a map."""
        if not self._binding.choices.shown:
            self._map.show_as(FLOOR)

    def _add_row(self, first: int, last: int) -> tuple[int, int, viser.GuiButtonGroupHandle]:
        hint = "Add a mode to the map or remove it; a filled dot is in the map"
        row = self._binding.gui.add_button_group(f"{first} to {last}", _labels(first, last, ()), hint=hint)
        self._binding.on(row, self.press)
        return first, last, row

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
        used = map_modes(binding.run, state, choices.modes, order_offset)
        problem = binding.run.problem
        limit = array_f_max(state.positions, problem.sound_speed, problem.dimension)
        limit = round(limit) if np.isfinite(limit) else limit
        if (used, limit) == self._key or now - self._updated < INTERVAL:
            return
        self._key, self._updated = (used, limit), now
        self.spectrum.show(used, limit)
        self.text.content = caption(binding.measurement, used, limit, self._order(state, used[-1]))
        binding.send("first mode of the map", used[0], self.low)
        binding.send("last mode of the map", used[-1], self.high)
        for first, last, row in self.switches:
            binding.send(f"row {first}", _labels(first, last, used), row, "options")

    def _order(self, state, mode: int) -> int | None:
        """Return the order L of the expansion of a mode (Eq. 3); None where no radius is given."""
        problem = self._binding.run.problem
        if problem.search is None or problem.dimension != 2:
            return None
        radius, wavenumbers = problem.search.radius, problem.wavenumbers[mode - 1 : mode]
        return int(max_order(wavenumbers, radius, state.order_offset)[0])


def _labels(first: int, last: int, used: tuple[int, ...]) -> tuple[str, ...]:
    """Return the labels of a row of switches: a filled dot for a mode in the map."""
    return tuple(f"{'●' if mode in used else '○'}{mode}" for mode in range(first, last + 1))


def caption(measurement: Measurement, used: tuple[int, ...], limit: float, order: int | None) -> str:
    """Return the highest mode of the map, the highest frequency of the array, and a warning beyond it.

    Parameters
    ----------
    measurement : Measurement
    used : modes in the map, counted from 1, ascending
    limit : f_max of the estimated positions (Eq. 9), Hz
    order : L of the highest mode (Eq. 3), or None

    Returns
    -------
    str
        HTML.
    """
    f, count = float(measurement.frequencies[used[-1] - 1]), measurement.count
    highest = f"<b>{limit:.0f} Hz</b>" if np.isfinite(limit) else "undefined, all estimates coincide"
    lines = [f"highest in the map: mode {used[-1]}, <b>{f:.1f} Hz</b>"]
    lines += [f"f<sub>max</sub> of the estimates (Eq. 9): {highest}"]
    if order is not None:
        lines += [f"order L = <b>{order}</b>: {2 * order + 1} functions for {count} microphones"]
    if f > limit:
        lines += [f"<span style='color: {html.RED}'>&#9888; the map has modes beyond f<sub>max</sub></span>"]
    return f"<div style='{html.CARD}'>{'<br>'.join(lines)}</div>"
