"""The plot of the tab Modes: the power spectrum, a dot on each peak, and the highest frequency f_max."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser
from viser import uplot

from ...model.measurement import Measurement
from ...model.problem import mode_power
from ..gui.plots import BLUE, ORANGE, RED, dots

GREY, SHADE = "#808894", "rgba(128, 136, 148, 0.25)"  # of the curve, and of the area below it
MAX_POINTS = 700  # of the spectrum: a plot is sent whole each time
ABOVE, BELOW = 6.0, 8.0  # dB by which the plot exceeds the strongest and the weakest peak
MIN_POWER = 1e-8  # of the greatest power, drawn for anything below
HIDDEN = -1e3  # dB, where a curve has nothing to show: below the plot, for uPlot cannot draw a NaN


class SpectrumPlot:
    """Owns the plot.

    Attributes
    ----------
    has_spectrum : bool, whether the measurement has a spectrum; otherwise each mode is drawn as a stem
    handle : viser.GuiUplotHandle
    """

    def __init__(self, gui: viser.GuiApi, measurement: Measurement, modes: int):
        self._f = measurement.frequencies[:modes]
        self._spectrum, self._peaks = spectrum_levels(measurement, modes)
        self.has_spectrum = self._spectrum is not None
        self._x, self._curve, self._at = self._curve_through_peaks()
        self.handle = self._make(gui)

    def show(self, used: tuple[int, ...], limit: float) -> None:
        """Mark the modes `used` in the map, counted from 1, and the frequency `limit`, Hz."""
        self.handle.data = self.columns(used, limit)

    def _curve_through_peaks(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the curve, (P,) Hz and (P,) dB, and (modes,) which of its points are the peaks."""
        if self._spectrum is None:
            stems = np.repeat(self._peaks, 3)
            stems[0::3] = stems[2::3] = HIDDEN
            return np.repeat(self._f, 3), stems, np.arange(1, len(stems), 3)
        x = np.concatenate([self._spectrum[0], self._f])
        order = np.argsort(x, kind="stable")
        at = np.argsort(order, kind="stable")[self._spectrum.shape[1] :]
        return x[order], np.concatenate([self._spectrum[1], self._peaks])[order], at

    def _make(self, gui: viser.GuiApi) -> viser.GuiUplotHandle:
        title = "Mean power at the microphones" if self.has_spectrum else "Mean power of the modes"
        edge = 0.02 * float(self._x[-1] - self._x[0]) + (0.0 if self.has_spectrum else 1.0)
        lowest = 10 * float(np.floor((self._peaks.min() - BELOW) / 10))
        return gui.add_uplot(
            data=self.columns((), np.inf),
            series=self._series(),
            title=title,
            legend={"show": False},
            scales={
                "x": uplot.Scale(time=False, range=(float(self._x[0]) - edge, float(self._x[-1]) + edge)),
                "y": uplot.Scale(range=(lowest, ABOVE)),
            },
            axes=(
                uplot.Axis(label="frequency (Hz)", labelSize=20, size=34),
                uplot.Axis(label="dB re the maximum", labelSize=18, size=40),
            ),
            height=240,
            padding=(12, 14, 0, 0),
        )

    def _series(self) -> tuple[uplot.Series, ...]:
        fill: dict[str, Any] = {"fill": SHADE, "fillTo": HIDDEN} if self.has_spectrum else {}
        return (
            uplot.Series(label="Hz"),
            uplot.Series(label="power", stroke=GREY, width=1, points={"show": False}, **fill),
            uplot.Series(label="not in the map", stroke=ORANGE, width=0, points=dots(5, ORANGE, "transparent")),
            uplot.Series(label="in the map", stroke=BLUE, width=0, points=dots(7, BLUE, BLUE)),
            uplot.Series(label="f_max", stroke=RED, width=1.5, dash=(6, 4), points={"show": False}),
        )

    def columns(self, used: tuple[int, ...], limit: float) -> tuple[np.ndarray, ...]:
        """Return the columns of the plot.

        Parameters
        ----------
        used : modes in the map, counted from 1
        limit : f_max, Hz

        Returns
        -------
        tuple of (P,) float64
            Frequency (Hz), curve, dots of modes not in the map, dots of modes in the map, line of f_max (dB).
        """
        inside = np.isin(np.arange(1, len(self._f) + 1), used)
        columns = [self._x, self._curve]
        for chosen in (~inside, inside):
            columns.append(np.full(len(self._x), HIDDEN))
            columns[-1][self._at[chosen]] = self._peaks[chosen]
        columns.append(np.full(len(self._x), HIDDEN))
        if not self._x[0] < limit < self._x[-1]:
            return tuple(columns)
        at = int(np.searchsorted(self._x, limit))
        height = float(np.interp(limit, self._x, self._curve)) if self.has_spectrum else HIDDEN
        line = ([limit] * 3, [height] * 3, [HIDDEN] * 3, [HIDDEN] * 3, [HIDDEN, ABOVE, HIDDEN])
        return tuple(np.insert(column, at, more) for column, more in zip(columns, line, strict=True))


def spectrum_levels(measurement: Measurement, modes: int) -> tuple[np.ndarray | None, np.ndarray]:
    """Return the spectrum and the levels of its peaks.

    Parameters
    ----------
    measurement : Measurement
    modes : int, number of modes

    Returns
    -------
    spectrum : (2, F) float64, Hz and dB re its maximum, the greatest of each of MAX_POINTS intervals; or None
    peaks : (modes,) float64, dB; without a spectrum of the modes' own mean power, re the greatest
    """
    f = measurement.frequencies[:modes]
    if measurement.spectrum is None:
        power = mode_power(measurement.pressures[:modes])
        return None, 10 * np.log10(np.maximum(power / power.max(), MIN_POWER))
    at, power = measurement.spectrum
    decibels = 10 * np.log10(np.maximum(power / max(power.max(), 1e-300), MIN_POWER))
    starts = np.unique(np.linspace(0, len(at) - 1, min(len(at), MAX_POINTS)).astype(int))
    spectrum = np.stack([at[starts], np.maximum.reduceat(decibels, starts)])
    return spectrum, np.maximum(np.interp(f, at, decibels), np.interp(f, *spectrum))
