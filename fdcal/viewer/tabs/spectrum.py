"""The power spectrum in the tab Map, and which of its modes are in the map."""

from typing import Any

import numpy as np
import viser
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
MAX_POINTS = 700  # of the spectrum: a plot is sent whole each time
ABOVE, BELOW = 6.0, 8.0  # dB by which the plot exceeds the strongest and the weakest peak
MIN_POWER = 1e-8  # of the greatest power, drawn for anything below
HIDDEN = -1e3  # dB, where a curve has nothing to show: below the plot, for uPlot cannot draw a NaN


# What the plot shows of one take, or of all: its modes, counted from 1, and their levels, dB, (K,) each; the curve
# through all peaks, Hz and dB, (P,) each; which of its points are the peaks (K,).
TakeCurve = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class SpectrumPlot:
    """Owns the plot.

    `has_spectrum`: whether the measurement has a spectrum; otherwise each mode is drawn as a stem.
    """

    def __init__(self, gui: viser.GuiApi, measurement: Measurement, modes: int):
        self.has_spectrum = measurement.spectrum is not None
        rows, takes = np.arange(1, modes + 1), np.unique(measurement.takes[:modes]).tolist()
        self._curves: dict[int | None, TakeCurve] = {None: _curve_through_peaks(measurement, rows)}  # by the take
        for take in takes if len(takes) > 1 else ():
            of_take = rows[measurement.takes[:modes] == take]
            self._curves[take] = _curve_through_peaks(measurement.of_take(take), of_take)
        what = "at the microphones" if self.has_spectrum else f"of the {row_word(measurement)}s"
        first, last = self._curves[None][2][[0, -1]].tolist()
        edge = 0.02 * (last - first) + (0.0 if self.has_spectrum else 1.0)
        min_level = min(peaks.min() for _, peaks, *_ in self._curves.values())
        lowest = 10 * float(np.floor((min_level - BELOW) / 10))
        fill: dict[str, Any] = {"fill": SHADE, "fillTo": HIDDEN} if self.has_spectrum else {}
        self.handle = gui.add_uplot(
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

    def columns(self, used: tuple[int, ...], limit: float, take: int | None = None) -> tuple[np.ndarray, ...]:
        """Return the columns of the plot.

        `used`: modes in the map, counted from 1; `limit`: f_max; `take`: whose modes and spectrum are drawn; None for
        those of all takes. Returns tuple of (P,) float64, frequency (Hz), curve, dots of modes not in the map, dots of
        modes in the map, line of f_max (dB).
        """
        rows, peaks, x, curve, tops = self._curves[take]
        inside, columns = np.isin(rows, used), [x, curve, *np.full((3, len(x)), HIDDEN)]
        for column, chosen in zip(columns[2:], (~inside, inside), strict=False):
            column[tops[chosen]] = peaks[chosen]
        if not x[0] < limit < x[-1]:
            return tuple(columns)
        at = int(np.searchsorted(x, limit))
        height = float(np.interp(limit, x, curve)) if self.has_spectrum else HIDDEN
        line = ([limit] * 3, [height] * 3, [HIDDEN] * 3, [HIDDEN] * 3, [HIDDEN, ABOVE, HIDDEN])
        return tuple(np.insert(column, at, more) for column, more in zip(columns, line, strict=True))


def _curve_through_peaks(measurement: Measurement, rows: np.ndarray) -> TakeCurve:
    """Return the curve of a measurement, or of one take of it, whose modes are called `rows`."""
    f, (spectrum, peaks) = measurement.frequencies[: len(rows)], spectrum_levels(measurement, len(rows))
    if spectrum is None:
        stems = np.repeat(peaks, 3)
        stems[0::3] = stems[2::3] = HIDDEN
        return rows, peaks, np.repeat(f, 3), stems, np.arange(1, len(stems), 3)
    x = np.concatenate([spectrum[0], f])
    order = np.argsort(x, kind="stable")
    at = np.argsort(order, kind="stable")[spectrum.shape[1] :]
    return rows, peaks, x[order], np.concatenate([spectrum[1], peaks])[order], at


def spectrum_levels(measurement: Measurement, modes: int) -> tuple[np.ndarray | None, np.ndarray]:
    """Return the spectrum and the levels of its peaks.

    `modes`: number of modes. Returns `spectrum` (2, F) float64, Hz and dB re its maximum, the greatest of each of
    MAX_POINTS intervals; or None; `peaks` (modes,) float64, dB; without a spectrum of the modes' own mean power, re the
    greatest.
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
    """Owns the plot and the text below it."""

    where, order = "Map", 4
    interval = 0.25

    def __init__(self, binding: Binding):
        self._binding, gui = binding, binding.gui
        with gui.add_folder("Spectrum", expand_by_default=False):
            self.spectrum = SpectrumPlot(gui, binding.measurement, binding.modes)
            marks = {
                "in the map": f"<circle cx='9' cy='9' r='4' fill='{BLUE}'/>",
                "not in the map": f"<circle cx='9' cy='9' r='3' fill='none' stroke='{ORANGE}' stroke-width='1.6'/>",
                "f<sub>max</sub>": f"<path d='M9 1V17' stroke='{RED}' stroke-width='1.8' stroke-dasharray='5 3'/>",
            }
            if self.spectrum.has_spectrum:
                marks["mean power"] = f"<path d='M1 15L6 13L9 3L12 13L17 15' fill='none' stroke='{GREY}'/>"
            gui.add_html(f"<div style='{html.CARD}'>{html.drawings_html(marks)}</div>")
            self.text = gui.add_html("")

    def inputs(self, state: PageState) -> tuple:
        """Return the modes of the map, the highest frequency of the array, and the take."""
        binding, choices, shown = self._binding, self._binding.choices, state.view.state
        used = map_modes(binding.run, shown, choices.modes, choices.map_order, choices.take)
        problem = binding.run.problem
        limit = array_f_max(shown.positions, problem.sound_speed, problem.dimension)
        limit = round(limit) if np.isfinite(limit) else limit
        return used, limit, choices.take

    def show(self, state: PageState) -> None:
        """Let the plot follow the modes of the map."""
        binding, problem = self._binding, self._binding.run.problem
        used, limit, take = self.inputs(state)
        self.spectrum.handle.data = self.spectrum.columns(used, limit, take)
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
