"""Which frequencies of a recording to use: modes that stand out, and between them those of the highest SNR.

The method does not need eigenfrequencies: any frequency at which there is no source inside the array will do. In a
damped room few modes stand out, and the frequencies between them carry as much information; but two that are closer
than the frequency resolution are not independent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model.validation import InputError

DEFAULT_COUNT = 57  # frequencies, where nothing is known of the microphones


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


def choose_frequencies(
    frequencies: np.ndarray, power: np.ndarray, noise: np.ndarray, resolution: float, most: int = DEFAULT_COUNT
) -> np.ndarray:
    """Return the indices of the frequencies to use.

    Peaks come first, in the order of their signal-to-noise ratio, then all others in that order. Where there are more
    than `most`, the best one in each of `most` equal parts of the band is kept.

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
    InputError
        No frequency rises above the noise.
    """
    from scipy.signal import find_peaks

    decibels = 10 * np.log10(np.maximum(power, 1e-300))
    floor = np.maximum(noise, power.max() * 10 ** (-THRESHOLDS.dynamic_range / 10))
    snr = 10 * np.log10(np.maximum(power - noise, 1e-300) / floor)
    usable = snr >= THRESHOLDS.min_snr
    if not np.any(usable):
        raise InputError(
            f"no frequency between {frequencies[0]:g} and {frequencies[-1]:g} Hz is {THRESHOLDS.min_snr:g} dB above the"
            " noise",
            "record at a higher level, or choose another band: <frequencies> LO:HI",
            key="frequencies",
        )
    peaks = find_peaks(decibels, prominence=THRESHOLDS.prominence)[0]
    is_peak = np.zeros(len(snr), bool)
    is_peak[peaks] = True
    order = np.lexsort((-snr, ~is_peak))
    chosen = _apart(frequencies, order[usable[order]], resolution)
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


def _apart(frequencies: np.ndarray, order: np.ndarray, resolution: float) -> np.ndarray:
    """Return those indices, in the order of preference, that are at least `resolution` from every earlier one kept."""
    step = frequencies[1] - frequencies[0] if len(frequencies) > 1 else 1.0
    reach = max(1, int(np.ceil(resolution / step * (1 - 1e-9))))
    taken = np.zeros(len(frequencies), bool)
    kept = []
    for index in order:
        if not taken[index]:
            kept.append(index)
            taken[max(0, index - reach + 1) : index + reach] = True
    return np.array(kept, dtype=np.int64)
