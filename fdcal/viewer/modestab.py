"""The modes seen: how loud each is, which are in the map, how far they may go; a switch for each of the lowest."""

from __future__ import annotations

import numpy as np
from viser import uplot

from ..dictionary import max_order
from ..history import SessionView
from ..measurement import Problem
from ..verdict import highest_frequency
from . import words
from .desk import Desk
from .maptab import MapTab

ROW, ROWS = 4, 6  # switches
GREY, BLUE = "#9aa0a8", "#1f78c8"
INTERVAL = 0.25  # s between two sendings of the plot


class ModesTab:
    """Owns the handles of the tab."""

    def __init__(self, desk: Desk, problem: Problem, map_tab: MapTab):
        self._desk, self._problem, self._map, self._sent = desk, problem, map_tab, -1e9
        gui, power = desk.gui, np.mean(np.abs(desk.measurement.pressures[: desk.modes]) ** 2, axis=1)
        self._levels = 10 * np.log10(power / power.max() + 1e-30)
        self._f = desk.measurement.frequencies[: desk.modes]
        self._key: tuple = ()
        self.plot = gui.add_uplot(
            data=self._data(()),
            series=(
                uplot.Series(label="Hz"),
                uplot.Series(label="not in the map", stroke=GREY, width=1.5, points={"show": False}),
                uplot.Series(label="in the map", stroke=BLUE, width=2.5, points={"show": False}),
            ),
            title="Power of the picked modes (dB)",
            scales={"x": uplot.Scale(time=False)},
            axes=(uplot.Axis(label="frequency (Hz)", labelSize=20, size=34), uplot.Axis(size=48)),
            height=215,
            padding=(12, 16, 0, 0),
        )
        self.text = gui.add_html("")
        count = min(desk.modes, ROW * ROWS)
        self.switches = [self._add_row(first, min(first + ROW - 1, count)) for first in range(1, count + 1, ROW)]

    def _add_row(self, first: int, last: int):
        hint = "Press to take a mode into the map or out of it; a filled dot is in"
        row = self._desk.gui.add_button_group(f"{first} to {last}", self._faces(first, last, ()), hint=hint)
        self._desk.on(row, self.press)
        return first, last, row

    @staticmethod
    def _faces(first: int, last: int, used) -> tuple[str, ...]:
        return tuple(f"{'●' if mode in used else '○'}{mode}" for mode in range(first, last + 1))

    def press(self, value) -> None:
        """One switch; what it says on its face is its mode."""
        number = str(value)[1:4]
        if number.isdecimal() and 1 <= int(number) <= self._desk.modes:
            self._map.toggle_mode(int(number))

    def _data(self, used) -> tuple[np.ndarray, ...]:
        """Strokes from the lowest level up to each mode's, in one curve or the other."""
        low = np.floor(self._levels.min() / 10) * 10 - 5
        x, inside = np.repeat(self._f, 3), np.isin(np.arange(1, len(self._f) + 1), used)
        strokes = [np.full(3 * len(self._f), low) for _ in range(2)]
        for curve, chosen in zip(strokes, (~inside, inside), strict=True):
            curve[1::3] = np.where(chosen, self._levels, low)
        return x, *strokes

    def show(self, view: SessionView, now: float) -> None:
        """Called by the main loop."""
        state = view.state
        used = self._desk.choices.modes or tuple(range(state.first, state.last + 1))
        limit = round(highest_frequency(self._problem, np.asarray(state.positions)))
        if (used, limit) == self._key or now - self._sent < INTERVAL:
            return
        self._key, self._sent = (used, limit), now
        self.plot.data = self._data(used)
        self.text.content = words.modes_lines(self._desk.measurement, used, limit, self._order(state, used[-1]))
        for first, last, row in self.switches:
            self._desk.tell(f"row {first}", self._faces(first, last, used), row, "options")

    def _order(self, state, mode: int) -> int | None:
        """Highest order L of the expansion of a mode; None where no radius is told."""
        if self._problem.search is None or self._problem.dimension != 2:
            return None
        offset = getattr(state, "order_offset", 0)
        return int(max_order(self._problem.wavenumbers[mode - 1 : mode], self._problem.search.radius, offset)[0])
