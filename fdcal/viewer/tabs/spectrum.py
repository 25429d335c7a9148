"""The power spectrum in the tab Map, and which of its modes are in the map."""

from typing import Any

import numpy as np
from viser import uplot

from ...acoustics.dictionary import array_f_max, max_order
from ...graphics.picture import row_word
from ...model.measurement import Measurement
from ...model.problem import mode_power
from .. import html
from ..binding import Binding, Tab
from ..cost_maps import map_modes, row_label
from ..plots import BLUE, ORANGE, RED, dots
from ..state import PageState

GREY, SHADE = "#808894", "rgba(128, 136, 148, 0.25)"  # of the curve, and of the area below it
MAX_POINTS = 700  # of the spectrum, all of which are sent each time
ABOVE, BELOW = 6.0, 8.0  # dB from the strongest peak to the top of the plot, and from the weakest to the bottom
MIN_POWER = 1e-8  # relative to the greatest power; lower powers are drawn as this one
HIDDEN = -1e3  # dB, below the plot, for points without a value: uPlot cannot draw NaN


def spectrum_levels(measurement: Measurement, modes: int) -> tuple[np.ndarray | None, np.ndarray]:
    """Return the spectrum of a measurement, or None, and the levels of its first `modes` peaks.

    The spectrum is (2, F) float64, Hz and dB re its maximum, with the greatest level of each of MAX_POINTS intervals.
    The peaks are (modes,) float64, dB; without a spectrum they are the mean powers of the modes, re the greatest.
    """
    f = measurement.frequencies[:modes]
    if measurement.spectrum is None:
        power = mode_power(measurement.pressures[:modes])
        return None, 10 * np.log10(np.maximum(power / power.max(), MIN_POWER))
    at, power = measurement.spectrum[0], measurement.spectrum[1:].mean(axis=0)  # over all takes
    decibels = 10 * np.log10(np.maximum(power / max(power.max(), 1e-300), MIN_POWER))
    starts = np.unique(np.linspace(0, len(at) - 1, min(len(at), MAX_POINTS)).astype(int))
    spectrum = np.stack([at[starts], np.maximum.reduceat(decibels, starts)])
    return spectrum, np.maximum(np.interp(f, at, decibels), np.interp(f, *spectrum))


class SpectrumPanel(Tab):
    """Owns the plot, in which each mode of a measurement without a spectrum is drawn as a stem, and the text below."""

    where, order = "Map", 4
    interval = 0.25

    def __init__(self, binding: Binding):
        self._binding, gui, measurement, modes = binding, binding.gui, binding.measurement, binding.modes
        f, (spectrum, self._peaks) = measurement.frequencies[:modes], spectrum_levels(measurement, modes)
        self._has_spectrum, self._rows = spectrum is not None, np.arange(1, modes + 1)
        if spectrum is None:
            self._x, self._curve, self._at = np.repeat(f, 3), np.repeat(self._peaks, 3), np.arange(1, 3 * modes, 3)
            self._curve[0::3] = self._curve[2::3] = HIDDEN
        else:
            x = np.concatenate([spectrum[0], f])
            order = np.argsort(x, kind="stable")
            self._x, self._curve = x[order], np.concatenate([spectrum[1], self._peaks])[order]
            self._at = np.argsort(order, kind="stable")[spectrum.shape[1] :]
        first, last = self._x[[0, -1]].tolist()
        edge = 0.02 * (last - first) + (0.0 if self._has_spectrum else 1.0)
        lowest = 10 * float(np.floor((self._peaks.min() - BELOW) / 10))
        fill: dict[str, Any] = {"fill": SHADE, "fillTo": HIDDEN} if self._has_spectrum else {}
        what = "at the microphones" if self._has_spectrum else f"of the {row_word(measurement)}s"
        marks = {
            "in the map": f"<circle cx='9' cy='9' r='4' fill='{BLUE}'/>",
            "not in the map": f"<circle cx='9' cy='9' r='3' fill='none' stroke='{ORANGE}' stroke-width='1.6'/>",
            "f<sub>max</sub>": f"<path d='M9 1V17' stroke='{RED}' stroke-width='1.8' stroke-dasharray='5 3'/>",
        }
        if self._has_spectrum:
            marks["mean power"] = f"<path d='M1 15L6 13L9 3L12 13L17 15' fill='none' stroke='{GREY}'/>"
        with gui.add_folder("Spectrum", expand_by_default=False):
            self.plot = gui.add_uplot(
                data=self.columns((), np.inf),
                series=(
                    uplot.Series(label="Hz"),
                    uplot.Series(label="power", stroke=GREY, width=1, points={"show": False}, **fill),
                    uplot.Series(label="not in the map", stroke=ORANGE, width=0, points=dots(5, ORANGE, "transparent")),
                    uplot.Series(label="in the map", stroke=BLUE, width=0, points=dots(7, BLUE, BLUE)),
                    uplot.Series(label="f_max", stroke=RED, width=1.5, dash=(6, 4), points={"show": False}),
                ),
                title=f"Mean power {what}",
                legend={"show": False},
                scales={
                    "x": uplot.Scale(time=False, range=(first - edge, last + edge)),
                    "y": uplot.Scale(range=(lowest, ABOVE)),
                },
                axes=(
                    uplot.Axis(label="frequency (Hz)", labelSize=20, size=34),
                    uplot.Axis(label="dB re the maximum", labelSize=18, size=40),
                ),
                height=240,
                padding=(12, 14, 0, 0),
            )
            gui.add_html(f"<div style='{html.CARD}'>{html.drawings_html(marks)}</div>")
            self.text = gui.add_html("")

    def columns(self, used: tuple[int, ...], limit: float) -> tuple[np.ndarray, ...]:
        """Return the columns of the plot.

        `used`: modes in the map, counted from 1; `limit`: f_max. Returns tuple of (P,) float64, frequency (Hz), curve,
        dots of modes not in the map, dots of modes in the map, line of f_max (dB).
        """
        x, curve = self._x, self._curve
        inside, columns = np.isin(self._rows, used), [x, curve, *np.full((3, len(x)), HIDDEN)]
        for column, chosen in zip(columns[2:], (~inside, inside), strict=False):
            column[self._at[chosen]] = self._peaks[chosen]
        if not x[0] < limit < x[-1]:
            return tuple(columns)
        at = int(np.searchsorted(x, limit))
        height = float(np.interp(limit, x, curve)) if self._has_spectrum else HIDDEN
        line = ([limit] * 3, [height] * 3, [HIDDEN] * 3, [HIDDEN] * 3, [HIDDEN, ABOVE, HIDDEN])
        return tuple(np.insert(column, at, more) for column, more in zip(columns, line, strict=True))

    def inputs(self, state: PageState) -> tuple:
        """Return the modes of the map and the highest frequency of the array."""
        binding, choices, shown = self._binding, self._binding.choices, state.view.state
        used = map_modes(binding.run, shown, choices.modes, choices.map_order)
        problem = binding.run.problem
        limit = array_f_max(shown.positions, problem.sound_speed, problem.dimension)
        return used, round(limit) if np.isfinite(limit) else limit

    def show(self, state: PageState) -> None:
        """Let the plot follow the modes of the map."""
        binding, problem = self._binding, self._binding.run.problem
        used, limit = self.inputs(state)
        self.plot.data = self.columns(used, limit)
        order = None  # L of the expansion of the highest mode (Eq. 3), where a radius is given
        if problem.search is not None and problem.dimension == 2:
            k = problem.wavenumbers[used[-1] - 1 : used[-1]]
            order = int(max_order(k, problem.search.radius, state.view.state.order_offset)[0])
        self.text.content = caption(binding.measurement, used, limit, order)


def caption(measurement: Measurement, used: tuple[int, ...], limit: float, order: int | None) -> str:
    """Return the highest mode of the map, the highest frequency of the array, and a warning beyond it.

    `used`: modes in the map, counted from 1, ascending; `limit`: f_max of the estimated positions (Eq. 9); `order`: L
    of the highest mode (Eq. 3), or None. Returns HTML.
    """
    f, count = float(measurement.frequencies[used[-1] - 1]), measurement.count
    highest = f"<b>{limit:.0f} Hz</b>" if np.isfinite(limit) else "undefined, all estimates coincide"
    name, _, hertz = row_label(measurement, used[-1]).rpartition(", ")
    what = "highest" if measurement.take_count > 1 else "highest in the map"
    lines = [f"{what}: {name}, <b>{hertz}</b>", f"f<sub>max</sub> of the estimates (Eq. 9): {highest}"]
    if order is not None:
        lines += [f"order L = <b>{order}</b>: {2 * order + 1} functions for {count} microphones"]
    if f > limit:
        beyond = f"the map has {row_word(measurement)}s beyond f<sub>max</sub>"
        lines += [f"<span style='color: {html.RED}'>&#9888; {beyond}</span>"]
    return f"<div style='{html.CARD}'>{'<br>'.join(lines)}</div>"
