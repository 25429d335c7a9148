"""Which frequencies of a recording to use: modes where they stand out, and between them what is loudest over the noise.

Nothing in the method needs an eigenfrequency: any frequency at which the source is silent inside the array will do. In
a damped room few modes stand out, and the frequencies between them hold as much; but two closer than the resolution of
the decay say the same twice.
"""

from __future__ import annotations

import numpy as np

from ..model.validation import InputError

PROMINENCE = 1.0  # dB by which a mode stands out
LEAST_SNR = 10.0  # dB of a frequency worth using
RANGE = 60.0  # dB below the strongest that may still be used
MOST = 57  # frequencies: as many as a calibration uses unless told


def choose_frequencies(frequencies, power, noise, resolution: float, most: int = MOST) -> np.ndarray:
    """Indices of the frequencies to use, ascending : (M,) int64.

    Parameters
    ----------
    frequencies : (B,) Hz, evenly spaced and finer than the resolution
    power, noise : (B,), of the mean over the microphones, any one unit; noise 0 where it is not known
    resolution : Hz, the least distance between two
    most : the greatest number of them

    Peaks come first, the strongest over the noise before weaker ones, then whatever is loudest over the noise. Where
    there are more than `most`, the best of each of `most` equal parts of the band is kept.

    Raises InputError where nothing rises above the noise.
    """
    from scipy.signal import find_peaks

    decibels = 10 * np.log10(np.maximum(power, 1e-300))
    floor = np.maximum(noise, power.max() * 10 ** (-RANGE / 10))
    snr = 10 * np.log10(np.maximum(power - noise, 1e-300) / floor)
    usable = snr >= LEAST_SNR
    if not np.any(usable):
        raise InputError(
            f"no frequency between {frequencies[0]:g} and {frequencies[-1]:g} Hz is {LEAST_SNR:g} dB above the noise;"
            " record louder, or name another band: --frequencies LO:HI"
        )
    peaks = find_peaks(decibels, prominence=PROMINENCE)[0]
    is_peak = np.zeros(len(snr), bool)
    is_peak[peaks] = True
    order = np.lexsort((-snr, ~is_peak))
    chosen = _apart(frequencies, order[usable[order]], resolution)
    return chosen[spread_over_band(frequencies[chosen], (frequencies[0], frequencies[-1]), most)]


def spread_over_band(frequencies, band: tuple[float, float], most: int) -> np.ndarray:
    """Indices of `most` at most of some frequencies (B,), Hz, in the order of preference, ascending in frequency.

    All of them if they are not too many, else the first one in each of `most` equal parts of the band.
    """
    firsts = np.arange(len(frequencies))
    if len(frequencies) > most:
        parts = np.clip((frequencies - band[0]) / (band[1] - band[0]) * most, 0, most - 1).astype(int)
        firsts = np.unique(parts, return_index=True)[1]
    return firsts[np.argsort(frequencies[firsts])]


def _apart(frequencies: np.ndarray, order: np.ndarray, resolution: float) -> np.ndarray:
    """Of indices in the order of preference, those at least `resolution` from every earlier one kept."""
    step = frequencies[1] - frequencies[0] if len(frequencies) > 1 else 1.0
    reach = max(1, int(np.ceil(resolution / step * (1 - 1e-9))))
    taken = np.zeros(len(frequencies), bool)
    kept = []
    for index in order:
        if not taken[index]:
            kept.append(index)
            taken[max(0, index - reach + 1) : index + reach] = True
    return np.array(kept, dtype=np.int64)
