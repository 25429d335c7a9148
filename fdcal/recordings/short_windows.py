"""Short windows of a recording, for the covariance of `fdcal.cost.short_windows`.

Of a stationary sound windows are taken all over the recording, of an impulse response from what follows the direct
sound by SKIP until the sound is lost in noise. A window whose sound is in a gap of speech or music does not count.
"""

import numpy as np

from ..model.validation import Complexes, Reals
from .recording import Recording, read_samples

WINDOW = 0.03  # seconds
SKIP = 0.02  # seconds after the direct sound
MAX_WINDOWS = 400  # of all takes together
MAX_GROUPS = 120  # of all takes together
MIN_WINDOWS = 30
SPACING = 1.5  # of the frequencies, over that of independent ones, 1 / WINDOW
LOWEST, HIGHEST = 120.0, 3000.0  # Hz
QUIET = 1e-3  # of the mean power at a frequency; a window with less is in a gap
ONSET = 0.3  # of the peak, where the direct sound begins
OVER_NOISE = 4.0  # power over that of the end of the recording, where an impulse response ends
SHORTEST = 0.2  # seconds after the onset that count in any case


def short_windows(
    recording: Recording, kind: str, band: tuple[float, float], takes: int = 1, number: int = 0
) -> tuple[Reals, Complexes]:
    """Return frequencies (F,), Hz, and pressures (F, W, N) complex64 of the windows; 0 where a window does not count.

    `takes`, `number`: how many takes there are, and which one this is: each has frequencies of its own.
    """
    fs, n = recording.sample_rate, int(WINDOW * recording.sample_rate)
    first, last = (0, recording.samples - n) if kind == "stationary" else _decay(recording, n)
    if last <= first:
        return np.zeros(0), np.zeros((0, 0, recording.count), np.complex64)
    spacing = max(SPACING / WINDOW, (band[1] - band[0]) / max(1, MAX_GROUPS // takes))
    f = np.arange(band[0] + spacing * number / takes, band[1], spacing)
    transform = np.exp(-2j * np.pi * np.outer(np.arange(n), f) / fs) * np.hanning(n)[:, None]
    count = int(min(max(MIN_WINDOWS, MAX_WINDOWS // takes), (last - first) / (n / 2) + 1))
    p = np.empty((len(f), count, recording.count), np.complex64)
    for window, start in enumerate(np.linspace(first, last, count).astype(int)):
        p[:, window] = (read_samples(recording, int(start), int(start) + n) @ transform).T
    power = np.mean(np.abs(p) ** 2, axis=2)
    p /= np.sqrt(np.maximum(power, 1e-300))[..., None]
    p[power <= QUIET * power.mean(axis=1, keepdims=True)] = 0
    return f, p


def _decay(recording: Recording, n: int) -> tuple[int, int]:
    """First samples of the first and the last window of an impulse response."""
    fs = recording.sample_rate
    x = read_samples(recording, 0, recording.samples)
    peak = np.abs(x).max(axis=1, keepdims=True)
    onset = int(np.median(np.argmax(np.abs(x) > ONSET * peak, axis=1)))
    energy = np.convolve(np.sum(x**2, axis=0), np.ones(n), "same")
    floor = np.median(energy[-max(1, len(energy) // 10) :])
    end = onset + int(np.argmax(np.append(energy[onset:] < OVER_NOISE * floor, True)))
    return onset + int(SKIP * fs), min(recording.samples, max(end, onset + int(SHORTEST * fs))) - n
