"""A recording at a lower sampling rate: frequencies above the band in use are filtered out, which saves most work."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .recording import Recording


@dataclass(frozen=True)
class DecimationSettings:
    """Of the filter before the sampling rate is reduced."""

    oversampling: float = 4.0  # least new sampling rate over the highest frequency
    stop_db: float = 110.0  # attenuation of what would alias into the band, decibels
    min_sample_rate: float = 200.0  # Hz
    block_samples: int = 8_000_000  # samples of all channels that are filtered at a time


DEFAULTS = DecimationSettings()


def decimate(recording: Recording, highest: float, settings: DecimationSettings = DEFAULTS) -> Recording:
    """Return the recording at a fraction of its sampling rate, unchanged up to a highest frequency.

    `highest`: Hz. Returns filtered whenever a block of it is read; `recording` itself where its rate is low already.
    """
    from scipy.signal import firwin, kaiserord, upfirdn

    fs = recording.sample_rate
    factor = int(fs / max(settings.oversampling * highest, settings.min_sample_rate))
    if factor < 2:
        return recording
    stop = fs / factor - highest
    taps, beta = kaiserord(settings.stop_db, (stop - highest) / (fs / 2))
    half = factor * (taps // (2 * factor) + 1)  # a multiple of the factor: centred on samples that are kept
    window: Any = ("kaiser", beta)  # SciPy's annotation allows names of windows only
    taps = np.asarray(firwin(2 * half + 1, (highest + stop) / 2, window=window, fs=fs), dtype=np.float32)

    def block(start: int, end: int, channels: np.ndarray) -> np.ndarray:
        out = np.empty((len(channels), end - start), dtype=np.float32)
        step = max(1, settings.block_samples // (factor * len(channels)))
        for begin in range(start, end, step):
            filter_into(out[:, begin - start :][:, : min(step, end - begin)], begin, channels)
        return out

    def filter_into(out: np.ndarray, begin: int, channels: np.ndarray) -> None:
        end = begin + out.shape[1]
        first, last = begin * factor - half, (end - 1) * factor + half + 1
        inside = max(first, 0), min(last, recording.samples)
        values = np.zeros((len(channels), last - first), dtype=np.float32)
        values[:, inside[0] - first : inside[1] - first] = recording.block(*inside, channels)
        for row, samples in zip(out, values, strict=True):
            row[:] = upfirdn(taps, samples, 1, factor)[2 * half // factor :][: end - begin]

    return replace(recording, sample_rate=fs / factor, samples=recording.samples // factor, block=block)
