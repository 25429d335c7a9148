"""A recording at a lower sampling rate: what lies above the band in use is taken off, and with it most of the work."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .recording import Recording

ROOM = 4.0  # times the highest frequency, the least new sampling rate
STOP_DB = 110.0  # by which what would fold into the band is held down
SLOWEST = 200.0  # Hz
AT_ONCE = 8_000_000  # samples of all channels that are filtered at a time


def decimate(recording: Recording, highest: float) -> Recording:
    """The recording at a fraction of its rate, right up to `highest` Hz; filtered whenever a block is read."""
    from scipy.signal import firwin, kaiserord, upfirdn

    fs = recording.sample_rate
    factor = int(fs / max(ROOM * highest, SLOWEST))
    if factor < 2:
        return recording
    stop = fs / factor - highest
    taps, beta = kaiserord(STOP_DB, (stop - highest) / (fs / 2))
    half = factor * (taps // (2 * factor) + 1)  # so that the filter is full at a sample that is kept
    taps = firwin(2 * half + 1, (highest + stop) / 2, window=("kaiser", beta), fs=fs).astype(np.float32)

    def block(start: int, end: int, channels: np.ndarray) -> np.ndarray:
        out = np.empty((len(channels), end - start), dtype=np.float32)
        step = max(1, AT_ONCE // (factor * len(channels)))
        for begin in range(start, end, step):
            piece(out[:, begin - start :][:, : min(step, end - begin)], begin, channels)
        return out

    def piece(out: np.ndarray, begin: int, channels: np.ndarray) -> None:
        end = begin + out.shape[1]
        first, last = begin * factor - half, (end - 1) * factor + half + 1
        inside = max(first, 0), min(last, recording.samples)
        values = np.zeros((len(channels), last - first), dtype=np.float32)
        values[:, inside[0] - first : inside[1] - first] = recording.block(*inside, channels)
        for row, samples in zip(out, values, strict=True):
            row[:] = upfirdn(taps, samples, 1, factor)[2 * half // factor :][: end - begin]

    return replace(recording, sample_rate=fs / factor, samples=recording.samples // factor, block=block)
