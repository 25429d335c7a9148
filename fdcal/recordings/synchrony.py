"""Whether the channels of a recording share one clock: the delay of each channel over time, from the recording alone.

The cross-spectrum of two microphones depends on the room, the source and the positions, which do not change. So the
phase difference between its means over two stretches of time is that of a delay,

    C_n(f, t) conj C_n(f, 0) = |C_n|^2 exp(-j 2 pi f d_n(t)),   C_n = mean X_n conj X_r,

in any room. Its transform has a peak at d_n(t) (Knapp and Carter, "The Generalized Correlation Method for Estimation of
Time Delay", IEEE TASSP 24(4), 1976). Each frequency is weighted with the product of the coherences of both stretches.
If a clock has another speed, the delay is a linear function of time; if samples are missing, it has a step.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..acoustics.spectrum import fast_length, irfft, rfft
from .recording import Recording, read_samples


@dataclass(frozen=True)
class SynchronyRules:
    """Settings of the measurement of delays; figures are for 16 microphones in a living room and 12 s of sound."""

    # Length of one transform, s, longer than most of the reverberation and than any delay. Delays scatter by 0.23 us in
    # noise at 30 dB and by 0.70 us in speech; with half the length by 0.39 and 0.91 us, with twice by 0.15 and 1.11 us.
    segment: float = 0.25
    # shortest, longest: length of a stretch, s. With 1 s the delays in speech scatter by 1.7 us, and one in 33 is not
    # found. In 4 s a drift of 80 ppm amounts to 0.3 ms, so that sound below 3 kHz remains coherent.
    shortest: float = 2.0
    longest: float = 4.0
    stretches: int = 16  # greatest number of stretches; more of them give the time of a step more exactly
    fewest: int = 4  # least number of stretches: three do not distinguish a line from a step
    # Channels that serve as the reference, one after the other, by the quantile of their level.
    references: tuple[float, ...] = (0.5, 0.25, 0.75)
    changed: int = 2  # least number of stretches with another delay; a stretch with a step in it may have either delay
    # least ratio of the peak of the correlation to its RMS: independent noise reaches 4.4, coherent sound of 0 dB SNR
    # 19 or more
    peak: float = 8.0
    fine: int = 4  # points per sample; 2 and 8 give the same scatter of delays
    # Least change of a delay that is a fault, s. If the air becomes 1 K warmer, sound crosses an array of 0.8 m 4 us
    # earlier.
    min_change: float = 1e-5
    # the same limit relative to the scatter of the delays; in 43 takes without a fault no change exceeds 6.5
    scatter: float = 8.0


SYNCHRONY = SynchronyRules()


class ClockFault(NamedTuple):
    """What is wrong with the clock of a channel."""

    kind: str  # "drift", "jump" or "lost"; `fdcal.assessment.words.clock_words` has the words
    value: float = 0.0  # rate of a drift, ppm, or size of a jump, seconds
    since: float = 0.0  # time of a jump or of the loss of a clock, seconds


@dataclass(frozen=True)
class ChannelDelays:
    """Delays of the channels over time, relative to the median channel."""

    times: np.ndarray  # (G,) float64, s, middle of each stretch
    delays: np.ndarray  # (N, G) float64, s, relative to those of the first stretch; NaN where they are unknown
    limit: np.ndarray  # (N,) float64, s; a larger change of the delay is a fault

    def faults(self, names: tuple[str, ...]) -> dict[str, ClockFault]:
        """Return the fault of each channel whose clock differs from the others, by the name of the channel."""
        known = np.isfinite(self.delays)
        usual = known.mean(axis=1) > 0.5
        found = {}
        for n, row in enumerate(self.delays):
            missing = np.flatnonzero(~known[n] & (known[usual].sum(axis=0) > usual.sum() / 2))
            if known[n, 1] and len(missing) and np.mean(known[n, missing[0] :]) < 0.2:
                found[names[n]] = ClockFault("lost", since=float(self.times[missing[0]]))
            elif known[n].sum() >= SYNCHRONY.fewest and np.sum(np.abs(row) > self.limit[n]) >= SYNCHRONY.changed:
                found[names[n]] = self._change(row)
        return found

    def unknown(self, names: tuple[str, ...]) -> list[str]:
        """Return the channels whose clock is unknown, because they are hardly coherent with the others."""
        few, faults = np.isfinite(self.delays).sum(axis=1) < SYNCHRONY.fewest, self.faults(names)
        return [name for name, unknown in zip(names, few, strict=True) if unknown and name not in faults]

    def _change(self, row: np.ndarray) -> ClockFault:
        """Return the fault, a drift or a jump, that fits the delays (G,), s, of a channel better."""
        seen = np.isfinite(row)
        t, d = self.times[seen], row[seen]
        slope = np.sum((t - t[0]) * d) / np.sum((t - t[0]) ** 2)
        off_line = np.sum((d - slope * (t - t[0])) ** 2)
        steps = [sum(np.sum((x - np.median(x)) ** 2) for x in np.split(d, [k])) for k in range(1, len(d))]
        k = int(np.argmin(steps)) + 1
        if off_line <= steps[k - 1]:
            return ClockFault("drift", 1e6 * float(slope))
        return ClockFault("jump", float(np.median(d[k:]) - np.median(d[:k])), float(t[k - 1] + t[k]) / 2)


def channel_delays(recording: Recording) -> ChannelDelays | None:
    """Return the delays of the channels of a stationary recording over time; None if it is too short."""
    fs, rules, N = recording.sample_rate, SYNCHRONY, recording.count
    count = min(rules.stretches, int(recording.duration / rules.shortest))
    if count < rules.fewest or N < 3:
        return None
    step = recording.samples / count
    span, best = min(step, rules.longest * fs), np.full((N, count), np.nan)
    level = np.sum(read_samples(recording, 0, min(recording.samples, 100_000)) ** 2, axis=1)
    order = np.argsort(level, kind="stable").tolist()
    for reference in dict.fromkeys(order[int(q * N)] for q in rules.references):
        delays = _against(recording, reference, np.arange(count) * step, span)
        known = np.isfinite(delays)
        best = delays if known.sum() > np.isfinite(best).sum() else best
        if (known.sum(axis=0) > N / 2).all():  # with a faulty reference most other delays would be unknown
            break
    best[:, np.isfinite(best).sum(axis=0) < 3] = np.nan  # with two channels it is unknown which one is faulty
    best -= [_median(row) for row in best.T]
    changes = np.diff(best)  # for a drift all are equal; for a jump all but one are zero
    scatter = np.array([_median(np.abs(row - _median(row))) for row in changes]) * 1.4826 / np.sqrt(2)
    limit = np.maximum(rules.min_change, rules.scatter * np.maximum(scatter, np.median(scatter)))
    return ChannelDelays((np.arange(count) * step + span / 2) / fs, best, limit)


def _median(values: np.ndarray) -> float:
    """Return the median of the finite values; 0 if there are none."""
    return float(np.median(values[np.isfinite(values)])) if np.isfinite(values).any() else 0.0


def _against(recording: Recording, reference: int, starts: np.ndarray, span: float) -> np.ndarray:
    """Return the delays (N, G), s, relative to one channel; NaN where none is found.

    The stretches begin at the samples `starts` (G,) and are `span` samples long.
    """
    fs, rules = recording.sample_rate, SYNCHRONY
    length = int(rules.segment * fs)
    window, padded = np.hanning(length), fast_length(length)
    kept = np.arange(padded // 2 + 1) * fs / padded <= 0.45 * fs  # below the cutoff of the converter's filter
    first, delays = np.zeros(0), np.zeros((recording.count, len(starts)))
    for g, begin in enumerate(starts):
        cross, power = np.zeros((recording.count, len(kept)), complex), np.zeros((recording.count, len(kept)))
        for start in np.arange(begin, begin + span - length + 1, length / 2).astype(int):
            X = rfft(window * read_samples(recording, start, start + length), padded)
            cross += X * X[reference].conj()
            power += np.abs(X) ** 2
        coherence = kept * cross / np.maximum(np.sqrt(power * power[reference]), np.finfo(float).tiny)
        if g == 0:
            first = coherence.conj()
        else:
            delays[:, g] = [_delay(row, padded, fs) for row in coherence * first]
    delays[reference] = 0.0
    return delays


def _delay(product: np.ndarray, padded: int, fs: float) -> float:
    """Return the lag of the greatest correlation, s; NaN if this correlation does not stand out from the others."""
    correlation = irfft(product * np.abs(product), SYNCHRONY.fine * padded)
    best = int(np.argmax(correlation))
    if not correlation[best] > SYNCHRONY.peak * np.sqrt(np.mean(correlation**2)):  # both are 0 if it is silent
        return np.nan
    left, middle, right = (correlation[(best + k) % len(correlation)] for k in (-1, 0, 1))
    bend = left - 2 * middle + right
    lag = best + (0.5 * (left - right) / bend if bend < 0 else 0.0)
    lag -= len(correlation) if lag > len(correlation) / 2 else 0
    return float(lag / (SYNCHRONY.fine * fs))
