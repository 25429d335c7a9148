"""How many frequencies of a room carry independent information, and which ones to expect.

    N(f)  = 4 pi/3 V (f/c)^3 + pi/4 S (f/c)^2 + L/8 f/c    modes below f in a box (Kuttruff, Room Acoustics, ch. 3)
    N(f)  = pi A (f/c)^2 + P/2 f/c                         in a rectangle of two dimensions
    n(f)  = min(dN/df, T60 / 2.2)                          independent frequencies in 1 Hz

V, S, L, A, P: volume, surface, sum of the edges; area and perimeter. 2.2 / T60 is the width of a resonance at -3 dB,
Hz: where resonances overlap (Schroeder 1962), pressures at two frequencies closer than that are not independent.
"""

from __future__ import annotations

import numpy as np

from ..model.validation import InputError

RESONANCE_WIDTH = 2.2  # times 1 / T60, Hz
MOST_FREQUENCIES = 1_000_000  # of a band: more are a mistake, and fill the memory


def decay_rate(reverberation_time: float) -> float:
    """Return the rate at which the pressure decays by 60 dB in `reverberation_time`, s : 1/s."""
    return float(np.log(1000) / reverberation_time)


def mode_count(size, frequencies, sound_speed: float) -> np.ndarray:
    """Return the mean number of modes below each frequency.

    `size` (2,) or (3,) float, lengths of the room, metres; `frequencies` (F,) float64, Hz; `sound_speed`: m/s. Returns
    (F,) float64.
    """
    ratio = np.asarray(frequencies, float) / sound_speed
    if len(size) == 2:
        return np.pi * size[0] * size[1] * ratio**2 + sum(size) * ratio
    x, y, z = size
    surface, edges = 2 * (x * y + y * z + z * x), 4 * (x + y + z)
    return 4 * np.pi / 3 * x * y * z * ratio**3 + np.pi / 4 * surface * ratio**2 + edges / 8 * ratio


def independent_frequencies(low: float, high: float, reverberation_time: float, sound_speed: float, size=None):
    """Return frequencies that a source in the room excites independently.

    `low`, `high`: band, Hz; `reverberation_time`: t60, s; `sound_speed`: m/s; `size` (2,) or (3,) float, lengths of the
    room, metres; without them resonances are taken to overlap everywhere. Returns (M,) float64, ascending. Raises
    InputError: the band holds more than MOST_FREQUENCIES.
    """
    grid = np.linspace(low, high, 4000)
    count = (grid - low) * reverberation_time / RESONANCE_WIDTH
    if size is not None:
        slope = np.gradient(mode_count(size, grid, sound_speed), grid)
        rate = np.minimum(slope, reverberation_time / RESONANCE_WIDTH)
        count = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(grid))])
    if count[-1] > MOST_FREQUENCIES:
        problem = f"{low:g} to {high:g} Hz with a reverberation time of {reverberation_time:g} s hold {count[-1]:.2g}"
        remedy = "use a narrower band (<frequencies>) or a shorter reverberation time"
        raise InputError(f"{problem} independent frequencies", remedy, key="frequencies", value=(low, high))
    return np.interp(np.arange(0.5, count[-1]), count, grid)
