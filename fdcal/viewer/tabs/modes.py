"""The modes seen: the power spectrum with the peaks picked, which are in the map, how far they may go; switches."""

from __future__ import annotations

import numpy as np
from viser import uplot

from ...acoustics.fourier_bessel import array_f_max, max_order
from ...model.measurement import Measurement
from ...model.power import mode_power
from ...model.problem import Problem
from ...session.history import SessionView
from ..gui import html
from ..gui.binding import FLOOR, Binding
from ..gui.plots import dots
from ..server.client_values import bounded
from .map import MapTab

ROW, ROWS = 4, 6  # switches
GREY, SHADE, ORANGE, BLUE, RED = "#808894", "rgba(128, 136, 148, 0.25)", "#e08a1e", "#1f78c8", "#d61828"
MOST_POINTS = 700  # of the spectrum: a plot is sent whole each time
ABOVE, BELOW = 6.0, 8.0  # dB that the plot goes beyond the strongest and the weakest peak
FAINTEST = 1e-8  # of the greatest power, drawn for anything below
UNSEEN = -1e3  # dB, where a curve has nothing to show: below the plot, for uPlot cannot take a NaN
INTERVAL = 0.25  # s between two sendings of the plot


class ModesTab:
    """Owns the handles of the tab."""

    def __init__(self, binding: Binding, problem: Problem, map_tab: MapTab):
        self._binding, self._problem, self._map, self._sent = binding, problem, map_tab, -1e9
        gui, self._f = binding.gui, binding.measurement.frequencies[: binding.modes]
        self._seen, self._levels = levels(binding.measurement, binding.modes)
        self._key: tuple = ()
        self._floor = 10 * np.floor((self._levels.min() - BELOW) / 10)
        self._x, self._curve, self._peaks = self._drawn()
        self.plot = self._plot()
        gui.add_html(html.spectrum_legend(self._seen is not None, BLUE, ORANGE, RED, GREY))
        self.text = gui.add_html("")
        self.low = gui.add_slider("From mode", 1, binding.modes, 1, 1, hint="Of the map")
        self.high = gui.add_slider("To mode", 1, binding.modes, 1, 1, hint="Of the map: watch the minima merge")
        self.own = gui.add_button("Modes in use", hint="The map of the modes that the solver uses")
        binding.on(self.low, lambda value: self._slide(value, self.high.value))
        binding.on(self.high, lambda value: self._slide(min(self.low.value, value), value))
        binding.on(self.own, lambda _: map_tab.choose_modes(None))
        count = min(binding.modes, ROW * ROWS)
        self.switches = [self._add_row(first, min(first + ROW - 1, count)) for first in range(1, count + 1, ROW)]
        if count < binding.modes:
            gui.add_html(
                html.remark(f"Modes {count + 1} to {binding.modes}: by the sliders, or as Mode numbers in Map.")
            )

    def _slide(self, low, high) -> None:
        """All modes from one to another; the end that was not moved gives way."""
        low, high = (bounded(value, 1, self._binding.modes, 1) for value in (low, high))
        self._show_map()
        self._map.choose_modes(range(low, max(low, high) + 1))

    def _show_map(self) -> None:
        """Modes are chosen for a map: one that is switched off comes back."""
        if not self._binding.choices.shown:
            self._map.show_as(FLOOR)

    def _add_row(self, first: int, last: int):
        hint = "Press to take a mode into the map or out of it; a filled dot is in"
        row = self._binding.gui.add_button_group(f"{first} to {last}", self._faces(first, last, ()), hint=hint)
        self._binding.on(row, self.press)
        return first, last, row

    @staticmethod
    def _faces(first: int, last: int, used) -> tuple[str, ...]:
        return tuple(f"{'●' if mode in used else '○'}{mode}" for mode in range(first, last + 1))

    def press(self, value) -> None:
        """One switch; what it says on its face is its mode."""
        number = str(value)[1:4]
        if number.isdecimal() and 1 <= int(number) <= self._binding.modes:
            self._show_map()
            self._map.toggle_mode(int(number))

    def _drawn(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The curve, (P,) Hz and (P,) dB, and (modes,) which of its points are the peaks.

        The spectrum through all peaks picked; where none was kept, a stem for each.
        """
        if self._seen is None:
            stems = np.repeat(self._levels, 3)
            stems[0::3] = stems[2::3] = UNSEEN
            return np.repeat(self._f, 3), stems, np.arange(1, len(stems), 3)
        x = np.concatenate([self._seen[0], self._f])
        order = np.argsort(x, kind="stable")
        peaks = np.argsort(order, kind="stable")[self._seen.shape[1] :]
        return x[order], np.concatenate([self._seen[1], self._levels])[order], peaks

    def _plot(self):
        spectrum = self._seen is not None
        title = "Mean power at the microphones" if spectrum else "Power of the modes picked"
        edge = 0.02 * float(self._x[-1] - self._x[0]) + (0.0 if spectrum else 1.0)
        return self._binding.gui.add_uplot(
            data=self._data((), np.inf),
            series=(
                uplot.Series(label="Hz"),
                uplot.Series(
                    label="power", stroke=GREY, width=1, points={"show": False},
                    **({"fill": SHADE, "fillTo": UNSEEN} if spectrum else {}),
                ),
                uplot.Series(label="not in the map", stroke=ORANGE, width=0, points=dots(5, ORANGE, "transparent")),
                uplot.Series(label="in the map", stroke=BLUE, width=0, points=dots(7, BLUE, BLUE)),
                uplot.Series(label="f_max", stroke=RED, width=1.5, dash=(6, 4), points={"show": False}),
            ),
            title=title,
            legend={"show": False},
            scales={
                "x": uplot.Scale(time=False, range=(float(self._x[0]) - edge, float(self._x[-1]) + edge)),
                "y": uplot.Scale(range=(float(self._floor), ABOVE)),
            },
            axes=(
                uplot.Axis(label="frequency (Hz)", labelSize=20, size=34),
                uplot.Axis(label="dB re the strongest", labelSize=18, size=40),
            ),
            height=240,
            padding=(12, 14, 0, 0),
        )  # fmt: skip

    def _data(self, used, limit: float) -> tuple[np.ndarray, ...]:
        """The curve, a dot on each peak, in one series or the other as its mode is in the map or not, and f_max."""
        inside = np.isin(np.arange(1, len(self._f) + 1), used)
        columns = [self._x, self._curve]
        for chosen in (~inside, inside):
            columns.append(np.full(len(self._x), UNSEEN))
            columns[-1][self._peaks[chosen]] = self._levels[chosen]
        columns.append(np.full(len(self._x), UNSEEN))
        if not self._x[0] < limit < self._x[-1]:
            return tuple(columns)
        at = int(np.searchsorted(self._x, limit))
        height = float(np.interp(limit, self._x, self._curve)) if self._seen is not None else UNSEEN
        stroke = ([limit] * 3, [height] * 3, [UNSEEN] * 3, [UNSEEN] * 3, [UNSEEN, ABOVE, UNSEEN])
        return tuple(np.insert(column, at, more) for column, more in zip(columns, stroke, strict=True))

    def show(self, view: SessionView, now: float) -> None:
        """Called by the main loop."""
        state = view.state
        used = self._binding.choices.modes or tuple(range(state.first, state.last + 1))
        limit = array_f_max(state.positions, self._problem.sound_speed, self._problem.dimension)
        limit = round(limit) if np.isfinite(limit) else limit
        if (used, limit) == self._key or now - self._sent < INTERVAL:
            return
        self._key, self._sent = (used, limit), now
        self.plot.data = self._data(used, limit)
        self.text.content = html.modes_lines(self._binding.measurement, used, limit, self._order(state, used[-1]))
        self._binding.send("map low", used[0], self.low)
        self._binding.send("map high", used[-1], self.high)
        for first, last, row in self.switches:
            self._binding.send(f"row {first}", self._faces(first, last, used), row, "options")

    def _order(self, state, mode: int) -> int | None:
        """Highest order L of the expansion of a mode; None where no radius is told."""
        if self._problem.search is None or self._problem.dimension != 2:
            return None
        offset = getattr(state, "order_offset", 0)
        return int(max_order(self._problem.wavenumbers[mode - 1 : mode], self._problem.search.radius, offset)[0])


def levels(measurement: Measurement, modes: int) -> tuple[np.ndarray | None, np.ndarray]:
    """What there is to draw : the spectrum (2, F), Hz and dB re its greatest, or None; and (modes,) dB of the picked.

    Of the spectrum, the greatest in each of MOST_POINTS stretches. Without one, the picked modes' own mean power.
    """
    f = measurement.frequencies[:modes]
    if measurement.spectrum is None:
        power = mode_power(measurement.pressures[:modes])
        return None, 10 * np.log10(np.maximum(power / power.max(), FAINTEST))
    at, power = measurement.spectrum
    decibels = 10 * np.log10(np.maximum(power / max(power.max(), 1e-300), FAINTEST))
    starts = np.unique(np.linspace(0, len(at) - 1, min(len(at), MOST_POINTS)).astype(int))
    seen = np.stack([at[starts], np.maximum.reduceat(decibels, starts)])
    return seen, np.maximum(np.interp(f, at, decibels), np.interp(f, *seen))
