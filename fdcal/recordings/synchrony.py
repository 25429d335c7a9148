"""Whether the channels of a recording share one clock: the delay of each over time, from the recording alone.

The cross-spectrum of two microphones belongs to the room, the source and their places, which do not change. So the
phase between its means over two stretches of time is that of a delay alone,

    C_n(f, t) conj C_n(f, 0) = |C_n|^2 exp(-j 2 pi f d_n(t)),   C_n = mean X_n conj X_r,

whatever the room. Its transform has a peak at d_n(t) (Knapp and Carter, "The Generalized Correlation Method for
Estimation of Time Delay", IEEE TASSP 24(4), 1976). Clocks of different speed give a line, lost samples a step.
"""

from dataclasses import dataclass

import numpy as np

from ..acoustics.spectrum import fast_length, irfft, rfft
from .recording import Recording, read_samples


@dataclass(frozen=True)
class SynchronyRules:
    """How delays are measured."""

    segment: float = 0.25  # seconds, of one transform
    stretches: int = 16  # of the recording, at most
    fewest: int = 4  # stretches, below which nothing is known
    segments: int = 8  # of a stretch, at least
    most: int = 24  # segments of a stretch that are read
    changed: int = 2  # stretches of another delay, at least: in the one of a step either delay may win
    lowest: float = 100.0  # Hz
    weakest: float = 1e-6  # power over the largest of a frequency that counts
    peak: float = 8.0  # of the correlation over its root mean square
    fine: int = 8  # points per sample
    # samples and seconds of a delay that changes, the larger of which is the least that counts
    min_samples: float = 0.3
    min_seconds: float = 1e-5


SYNCHRONY = SynchronyRules()


@dataclass(frozen=True)
class ChannelDelays:
    """Delays of the channels over time, less the median channel's."""

    times: np.ndarray  # (G,) float64, s, middle of each stretch
    delays: np.ndarray  # (N, G) float64, s, later than in the first stretch; NaN where nothing is known
    limit: float  # s, of a change that counts

    def faults(self, names: tuple[str, ...]) -> dict[str, str]:
        """Return what is wrong with the clock of each channel that differs from the others', by name."""
        known = np.isfinite(self.delays)
        usual = known.mean(axis=1) > 0.5
        found = {}
        for n, row in enumerate(self.delays):
            lost = np.flatnonzero(~known[n] & (known[usual].mean(axis=0) > 0.5))
            if known[n, 1] and len(lost) and np.mean(known[n, lost[0] :]) < 0.2:
                found[names[n]] = f"shares no clock with the others from {self.times[lost[0]]:.3g} s on"
            elif known[n].sum() >= SYNCHRONY.fewest and np.sum(np.abs(row[known[n]]) > self.limit) >= SYNCHRONY.changed:
                found[names[n]] = self._change(row)
        return found

    def _change(self, row: np.ndarray) -> str:
        """Return whether a delay is nearer to a line or to a step, in words."""
        seen = np.isfinite(row)
        t, d = self.times[seen], row[seen]
        slope = np.sum((t - t[0]) * d) / np.sum((t - t[0]) ** 2)
        off_line = np.sum((d - slope * (t - t[0])) ** 2)
        steps = [np.sum((d[:k] - np.median(d[:k])) ** 2) + np.sum((d[k:] - np.median(d[k:])) ** 2)
                 for k in range(1, len(d))]  # fmt: skip
        k = int(np.argmin(steps)) + 1
        if off_line <= steps[k - 1]:
            return f"drifts by {1e6 * slope:+.3g} ppm"
        jump = float(np.median(d[k:]) - np.median(d[:k]))
        return f"jumps by {1e3 * jump:+.3g} ms at about {(t[k - 1] + t[k]) / 2:.3g} s"


def channel_delays(recording: Recording) -> ChannelDelays | None:
    """Return the delays of the channels of a stationary recording over time; None where it is too short."""
    fs, rules = recording.sample_rate, SYNCHRONY
    length = int(rules.segment * fs)
    count = min(rules.stretches, recording.samples // (rules.segments * length))
    if count < rules.fewest or recording.count < 3:
        return None
    padded = fast_length(length)
    f = np.arange(padded // 2 + 1) * fs / padded
    window, stretch = np.hanning(length), recording.samples // count
    reference = _reference(recording)
    spectra = np.zeros((count, recording.count, len(f)), np.complex64)
    for g in range(count):
        starts = np.unique(np.linspace(g * stretch, (g + 1) * stretch - length, rules.most).astype(int))
        for start in starts:
            X = rfft(window * read_samples(recording, start, start + length), padded)
            spectra[g] += X * X[reference].conj()
    used = (f >= rules.lowest) & (f <= 0.45 * fs)
    power = np.mean(np.abs(spectra[:, reference]), axis=0) * used
    used &= power > rules.weakest * power.max()
    delays = np.zeros((recording.count, count))
    for n in range(recording.count):
        for g in range(1, count):
            delays[n, g] = _delay(spectra[g, n] * spectra[0, n].conj(), used, padded, fs)
    delays[reference, 1:] = 0.0 if power.max() > 0 else np.nan
    with np.errstate(all="ignore"):
        middle = np.array([np.median(row[np.isfinite(row)]) if np.isfinite(row).any() else 0.0 for row in delays.T])
    limit = max(rules.min_samples / fs, rules.min_seconds)
    return ChannelDelays((np.arange(count) + 0.5) * stretch / fs, delays - middle, limit)


def _reference(recording: Recording) -> int:
    """Return the channel of median level at the beginning."""
    level = np.sum(read_samples(recording, 0, min(recording.samples, 100_000)) ** 2, axis=1)
    return int(np.argsort(level, kind="stable")[recording.count // 2])


def _delay(product: np.ndarray, used: np.ndarray, padded: int, fs: float) -> float:
    """Return the lag of the greatest correlation, s; NaN where it does not stand out."""
    whitened = np.where(used, product / np.maximum(np.abs(product), np.finfo(np.float32).tiny), 0.0)
    correlation = irfft(whitened, SYNCHRONY.fine * padded)
    best = int(np.argmax(correlation))
    if correlation[best] < SYNCHRONY.peak * np.sqrt(np.mean(correlation**2)):
        return np.nan
    left, middle, right = (correlation[(best + k) % len(correlation)] for k in (-1, 0, 1))
    bend = left - 2 * middle + right
    lag = best + (0.5 * (left - right) / bend if bend < 0 else 0.0)
    lag -= len(correlation) if lag > len(correlation) / 2 else 0
    return float(lag / (SYNCHRONY.fine * fs))
