"""Which frequencies of a recording to use: evenly over the band, as close as is worth it.

The method does not need eigenfrequencies: any frequency at which there is no source inside the array will do. They are
chosen without regard to the level. A peak of the level is a maximum of the pressure where the array stands, and there
its gradient is small: an array much smaller than the wavelength, calibrated with peaks alone, comes out at 0.5 to 0.8
of its size. Two frequencies that are close carry the same information. With e(t) the energy of the response at time t
and v its noise or, where that is less, what a model of the field cannot explain,

    T_eq = (sum e)^2 / sum e^2     the pressure decorrelates over a bandwidth of 1 / T_eq
    T    = sum e / (e + v)         the time in which the response stands out

Samples 1 / T apart hold all that there is in the band, as those of any response of length T do. The late part of a
response is weak, so T is about 5 T_eq where a room decays evenly, and more where the direct sound is strong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model.validation import InputError


@dataclass(frozen=True)
class SelectionThresholds:
    """Which frequencies are worth using, decibels."""

    min_snr: float = 10.0  # of a frequency that is used
    dynamic_range: float = 60.0  # below the strongest frequency


THRESHOLDS = SelectionThresholds()


@dataclass(frozen=True)
class RowLimits:
    """How many rows are taken, and how close."""

    # most, usual_count: rows of all takes together, by default, of so many microphones, which take some 5 s of one
    # processor. The time of a row grows with the square of their number
    most: int = 400
    usual_count: int = 32
    # least_of_array, most_of_array, least_of_take: rows that the default leaves however many microphones or takes there
    # are, and however few
    least_of_array: int = 112
    most_of_array: int = 1600
    least_of_take: int = 20
    unexplained: float = 1e-4  # power relative to that of the response that no model of the field explains


ROWS = RowLimits()


def default_most(microphones: int, takes: int = 1) -> int:
    """Return how many rows of each take are used at most unless their number is given.

    The limit is one of computing time alone. Takes share it, since rows of another take say more than closer ones.

    Examples
    --------
    >>> default_most(32), default_most(32, takes=8), default_most(128)
    (400, 50, 112)
    """
    affordable = int(ROWS.most * (ROWS.usual_count / microphones) ** 2)
    every = min(max(ROWS.least_of_array, affordable), ROWS.most_of_array)
    return max(ROWS.least_of_take, every // takes)


@dataclass(frozen=True)
class Spacing:
    """How close the frequencies of a recording are worth taking, Hz."""

    step: float  # least distance of two frequencies
    # bandwidth over which the pressures decorrelate, 1 / T_eq; frequencies that are closer are not independent
    decorrelation: float


def spacing_of(energy: np.ndarray, noise: np.ndarray, interval: float) -> Spacing:
    """Return the spacing of frequencies of a response.

    `energy` (T,) float64, of the response and the noise over time, windows included; `noise` (T,) float64, its expected
    part that is noise; `interval`: of the times, s.

    Examples
    --------
    >>> t = np.arange(0, 1, 1e-3)
    >>> spacing = spacing_of(np.exp(-2 * 14 * t), 0 * t, 1e-3)  # falls by 60 dB in 0.5 s
    >>> round(spacing.decorrelation), round(spacing.step, 1)
    (14, 2.8)
    """
    e = np.maximum(energy - noise, 0.0)
    if not e.max(initial=0.0) > 0:
        return Spacing(*(2 * (1 / max(interval * len(energy), 1e-9),)))
    v = np.maximum(noise, ROWS.unexplained * np.sum(e**2) / np.sum(e))
    return Spacing(float(1 / (interval * np.sum(e / (e + v)))), float(np.sum(e**2) / np.sum(e) ** 2 / interval))


def spacing_of_decay(rate: float) -> Spacing:
    """Return the spacing of frequencies of a response that decays evenly, at `rate` nepers per second."""
    return Spacing(2 * rate / float(np.log(2 / ROWS.unexplained)), rate)


class NothingAboveNoise(InputError):
    """A recording without any frequency at which the sound rises above the noise."""


def choose_frequencies(
    frequencies: np.ndarray, power: np.ndarray, noise: np.ndarray, resolution: float, most: int = ROWS.most
) -> np.ndarray:
    """Return the indices of the frequencies to use: in equal parts of the band the one nearest to the middle.

    `frequencies` (B,) float64, Hz, evenly spaced and finer than the resolution; `power`, `noise` (B,) float64, mean
    over the microphones, any one unit; noise 0 where it is unknown; `resolution`: least distance between two
    frequencies, Hz; `most`: greatest number of frequencies. Returns (M,) int64, ascending. Raises NothingAboveNoise: no
    frequency does.
    """
    floor = np.maximum(noise, power.max() * 10 ** (-THRESHOLDS.dynamic_range / 10))
    snr = 10 * np.log10(np.maximum(power - noise, 1e-300) / floor)
    usable = snr >= THRESHOLDS.min_snr
    if not np.any(usable):
        raise NothingAboveNoise(
            f"no frequency between {frequencies[0]:g} and {frequencies[-1]:g} Hz is {THRESHOLDS.min_snr:g} dB above the"
            " noise",
            "record at a higher level, or choose another band: <frequencies> LO:HI",
            key="frequencies",
        )
    at = np.flatnonzero(usable)
    return at[spread_over_band(frequencies[at], (frequencies[0], frequencies[-1]), most, resolution)]


def spread_over_band(frequencies: np.ndarray, band: tuple[float, float], most: int, apart: float) -> np.ndarray:
    """Return the indices of at most `most` frequencies, the one nearest to the middle of each of equal parts of a band.

    `frequencies` (B,) float64, Hz, ascending; `band`: Hz; `apart`: least width of a part, Hz; two frequencies are three
    quarters of it apart at least. Returns (M,) int64, ascending.
    """
    count = max(1, min(most, int((band[1] - band[0]) / apart * (1 + 1e-9)) + 1))
    width = (band[1] - band[0]) / max(1, count - 1)
    part = np.round((frequencies - band[0]) / width).astype(int) if count > 1 else np.zeros(len(frequencies), int)
    away = np.abs(frequencies - band[0] - part * width)
    order = np.lexsort((away, part))
    firsts = order[np.unique(part[order], return_index=True)[1]]
    kept = []
    for n in firsts.tolist():
        if not kept or frequencies[n] - frequencies[kept[-1]] >= 0.75 * apart:  # samples do not lie on the middles
            kept.append(n)
    return np.array(kept, np.int64)
