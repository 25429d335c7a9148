"""Which frequencies of a recording to use: modes that stand out, and those between them, as close as is worth it.

The method does not need eigenfrequencies: any frequency at which there is no source inside the array will do. In a
damped room few modes stand out, and the frequencies between them carry as much information; but two that are close
carry the same. With e(t) the energy of the response at time t and v its noise or, where that is less, what a model of
the field cannot explain,

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
    """Which frequencies are worth using, decibels.

    Attributes
    ----------
    prominence : float
        Of a peak in the spectrum that counts as a mode.
    min_snr : float
        Of a frequency that is used.
    dynamic_range : float
        Below the strongest frequency.
    """

    prominence: float = 1.0
    min_snr: float = 10.0
    dynamic_range: float = 60.0


THRESHOLDS = SelectionThresholds()


@dataclass(frozen=True)
class RowLimits:
    """How many rows are taken, and how close.

    Attributes
    ----------
    most : int
        Rows of all takes together, by default: 32 microphones at so many take some 5 s of one processor.
    usual_count : int
        Microphones up to which that holds; of more, whose rows take longer by the square, fewer are taken.
    least_of_array, least_of_take : int
        Rows that the default leaves however many microphones or takes there are.
    unexplained : float
        Power relative to that of the response that no model of the field explains.
    """

    most: int = 400
    usual_count: int = 64
    least_of_array: int = 112
    least_of_take: int = 20
    unexplained: float = 1e-4


ROWS = RowLimits()


def default_most(microphones: int, takes: int = 1) -> int:
    """Return how many rows of each take are used at most unless their number is given.

    The limit is one of computing time alone. Takes share it, since rows of another take say more than closer ones.

    Examples
    --------
    >>> default_most(32), default_most(32, takes=8), default_most(128)
    (400, 50, 112)
    """
    every = max(ROWS.least_of_array, int(ROWS.most * min(1.0, (ROWS.usual_count / microphones) ** 2)))
    return max(ROWS.least_of_take, every // takes)


@dataclass(frozen=True)
class Spacing:
    """How close the frequencies of a recording are worth taking, Hz.

    Attributes
    ----------
    step : float
        Least distance of two frequencies.
    decorrelation : float
        Bandwidth over which the pressures decorrelate, 1 / T_eq; frequencies that are closer are not independent.
    """

    step: float
    decorrelation: float


def spacing_of(energy: np.ndarray, noise: np.ndarray, interval: float) -> Spacing:
    """Return the spacing of frequencies of a response.

    Parameters
    ----------
    energy : (T,) float64
        Of the response and the noise over time, windows included.
    noise : (T,) float64
        Its expected part that is noise.
    interval : float
        Of the times, s.

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
    return Spacing(1 / (interval * np.sum(e / (e + v))), float(np.sum(e**2) / np.sum(e) ** 2 / interval))


def spacing_of_decay(rate: float) -> Spacing:
    """Return the spacing of frequencies of a response that decays evenly, at `rate` nepers per second."""
    return Spacing(2 * rate / float(np.log(2 / ROWS.unexplained)), rate)


class NothingAboveNoise(InputError):
    """A recording without any frequency at which the sound rises above the noise."""


def choose_frequencies(
    frequencies: np.ndarray, power: np.ndarray, noise: np.ndarray, resolution: float, most: int = ROWS.most
) -> np.ndarray:
    """Return the indices of the frequencies to use.

    As many as fit at the resolution; among them peaks count twice, and the others by their signal-to-noise ratio. Where
    there are more than `most`, the best one in each of `most` equal parts of the band is kept.

    Parameters
    ----------
    frequencies : (B,) float64
        Hz, evenly spaced and finer than the resolution.
    power, noise : (B,) float64
        Mean over the microphones, any one unit; noise 0 where it is unknown.
    resolution : float
        Least distance between two frequencies, Hz.
    most : int
        Greatest number of frequencies.

    Returns
    -------
    (M,) int64
        Ascending.

    Raises
    ------
    NothingAboveNoise
        No frequency does.
    """
    from scipy.signal import find_peaks

    decibels = 10 * np.log10(np.maximum(power, 1e-300))
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
    peaks = find_peaks(decibels, prominence=THRESHOLDS.prominence)[0]
    is_peak = np.zeros(len(snr), bool)
    is_peak[peaks] = True
    worth = 1 + is_peak + np.clip(snr / THRESHOLDS.dynamic_range, 0, 1) / 2
    chosen = _apart(frequencies, np.where(usable, worth, 0.0), resolution)
    chosen = chosen[np.argsort(-worth[chosen], kind="stable")]
    return chosen[spread_over_band(frequencies[chosen], (frequencies[0], frequencies[-1]), most)]


def spread_over_band(frequencies: np.ndarray, band: tuple[float, float], most: int) -> np.ndarray:
    """Return the indices of at most `most` frequencies, the first one in each of `most` equal parts of the band.

    Parameters
    ----------
    frequencies : (B,) float64
        Hz, in the order of preference.
    band : (float, float)
        Hz.
    most : int

    Returns
    -------
    (M,) int64
        Ascending in frequency; all of them if they are not more than `most`.
    """
    firsts = np.arange(len(frequencies))
    if len(frequencies) > most:
        parts = np.clip((frequencies - band[0]) / (band[1] - band[0]) * most, 0, most - 1).astype(int)
        firsts = np.unique(parts, return_index=True)[1]
    return firsts[np.argsort(frequencies[firsts])]


def _apart(frequencies: np.ndarray, worth: np.ndarray, resolution: float) -> np.ndarray:
    """Return the indices, at least `resolution` apart, whose `worth` (B,) is greatest in all; none where it is 0."""
    step = frequencies[1] - frequencies[0] if len(frequencies) > 1 else 1.0
    reach = max(1, int(np.ceil(resolution / step * (1 - 1e-9))))
    best = np.zeros(len(worth) + reach)  # of the indices up to this one; the first `reach` are none
    for n, value in enumerate(worth.tolist()):
        best[n + reach] = max(best[n + reach - 1], best[n] + value)
    kept, n = [], len(worth) - 1
    while n >= 0:
        if best[n + reach] > best[n + reach - 1]:
            kept.append(n)
            n -= reach
        else:
            n -= 1
    return np.array(kept[::-1], dtype=np.int64)
