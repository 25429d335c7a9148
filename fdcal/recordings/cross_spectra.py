"""Pressures from a stationary source: noise, music, speech or a machine, whose signal is unknown.

Over one segment of length T, under a smooth window, the transforms of all channels at one frequency are p s + noise:
the field p at the microphones times the spectrum s of what the source emitted. Their cross-spectral matrix over K
segments is

    C = |s|^2 p p^H + v I,

and its dominant eigenvector is p, up to a factor, with a noise power of v / K. A window has a bandwidth of about 2 / T,
though, and a resonance narrower than that rings at its own frequency, not at that of the window. So the frequency of p,
and with it k, is the mean frequency within the window. With w' the slope of the window, and X and X' the transforms
under w and w',

    f_p = f + Re sum(j X' conj X) / (2 pi sum |X|^2).

Several independent sources, or one that moves, make C a sum of such terms: any linear combination of their fields is a
sound field, too. So each leading eigenvector is a row of this frequency, once it is multiplied by the root of the
difference between its eigenvalue and the noise. With a single source the second eigenvalue is not zero either: noise
makes it up to (1 + sqrt(N / K))^2 v, and a room that rings on beyond a segment makes it about 3.3 / (T d)^2 of the
first one. The eigenvalue of a further row must be well above both.

    w    Hann's window, whose transforms follow from those without a window at three neighbouring bins
    d    rate at which the sound decays, nepers per second; 1 / d = T_eq of `fdcal.recordings.frequencies`
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..acoustics.spectrum import fast_length, rfft
from ..model.validation import Complexes, InputError, Integers, Reals
from .frequencies import MIN_SNR, ROWS, NothingAboveNoise, Pressures, Spacing, choose_frequencies, spread_over_band
from .recording import Band, Recording, in_memory, read_samples


@dataclass(frozen=True)
class DecimationSettings:
    """Settings of the filter that is applied before the sampling rate is reduced."""

    oversampling: float = 4.0  # least new sampling rate, divided by the highest frequency
    stop_db: float = 110.0  # attenuation of what would alias into the band, decibels
    min_sample_rate: float = 200.0  # Hz
    block_samples: int = 8_000_000  # samples of all channels that are filtered at a time


DECIMATION = DecimationSettings()


def decimate(recording: Recording, highest: float, settings: DecimationSettings = DECIMATION) -> Recording:
    """Return the recording at a lower sampling rate, unchanged up to `highest`, Hz; blocks are filtered when read."""
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
            until = min(begin + step, end)
            first, last = begin * factor - half, (until - 1) * factor + half + 1
            inside = max(first, 0), min(last, recording.samples)
            values = np.zeros((len(channels), last - first), dtype=np.float32)
            values[:, inside[0] - first : inside[1] - first] = recording.block(*inside, channels)
            for row, samples in zip(out[:, begin - start : until - start], values, strict=True):
                row[:] = upfirdn(taps, samples, 1, factor)[2 * half // factor :][: until - begin]
        return out

    return replace(recording, sample_rate=fs / factor, samples=recording.samples // factor, block=block)


@dataclass(frozen=True)
class SegmentSettings:
    """How a recording is divided into segments over which cross-spectra are averaged."""

    count: int = 15  # number of segments of which a mean is taken, unless the limits of their duration change it
    # min_duration, max_duration: of a segment, seconds
    min_duration: float = 0.5
    max_duration: float = 8.0
    max_samples: int = 20_000_000  # largest number of samples of all channels in one segment
    max_matrix: int = 10_000_000  # largest number of values in all cross-spectral matrices together
    max_count: int = 600  # largest number of segments; in a longer recording they are spread evenly
    # each segment counts as this number of independent ones: Hann's windows that overlap by half are nearly independent
    independence: float = 0.95


SEGMENTS = SegmentSettings()
# Limits for a further eigenvector, which gives one more row:
MAX_RANK = 8  # largest number of rows of one frequency
OVER_NOISE = 2.0  # least ratio of its eigenvalue to the largest one that noise alone causes
OVER_LEAKAGE = 4.0  # least ratio of its eigenvalue to the one that the window causes for a single source
LAGS = (2, 4)  # distances, bins, of neighbouring frequencies whose windows do not overlap in frequency
# rows per bandwidth 1 / T_eq: 5 for a room that decays evenly (`fdcal.recordings.frequencies`), times 1.5, because rows
# at close frequencies have the same field but independent noise
OVERSAMPLING = 7.6
# Ratio of the second eigenvalue to the first one, times (T d)^2. It is a quarter of the mean square of w' divided by
# that of w.
LEAKAGE = 3.3


def stationary_pressures(
    recording: Recording, band: Band, sound_speed: float, max_rows: int = ROWS.max_rows
) -> Pressures:
    """Return at most `max_rows` rows of pressures from a recording of one or several stationary sources."""
    recording = in_memory(decimate(recording, band[1]))
    length, starts = segments(recording, band)
    fs = recording.sample_rate
    first, last = max(2, int(np.ceil(band[0] * length / fs))), int(np.floor(band[1] * length / fs))
    if last - first < 2:
        problem = f"{recording.path}: segments of {length / fs:.3g} s are too short for {band[0]:g} to {band[1]:g} Hz"
        raise InputError(problem, "widen <frequencies>", key="frequencies")
    total = np.zeros((recording.count, last - first + 1))
    for bare in _bare_spectra(recording, length, starts, first - 1, last + 1):
        total += np.abs(bare[:, 1:-1] / 2 - (bare[:, :-2] + bare[:, 2:]) / 4) ** 2
    grid, powers = np.arange(first, last + 1) * fs / length, total / len(starts)
    window = 2 * fs / length
    spacing = room_spacing(powers, window)
    spare = max(20, min(2 * max_rows, SEGMENTS.max_matrix // recording.count**2))  # some will be too noisy
    chosen = choose_frequencies(grid, powers.mean(axis=0), np.zeros(len(grid)), spacing.step, spare)
    C, seen = cross_spectra(recording, np.round(grid[chosen] * length / fs).astype(int), length, starts)
    independent = SEGMENTS.independence * len(starts)
    row, p, noise, snr = eigenvectors(C, independent, LEAKAGE * (fs / length / spacing.decorrelation) ** 2)
    keep = np.flatnonzero(snr * independent >= 10 ** (MIN_SNR / 10))
    if not len(keep):
        problem = f"{recording.path}: no frequency from {band[0]:g} to {band[1]:g} Hz is coherent at the microphones"
        raise NothingAboveNoise(problem, "record one source only, louder than the noise")
    f = seen[row]
    rows = _within(row, keep[np.argsort(-snr[keep], kind="stable")], seen, band, max_rows, 0.25 * window)
    how = f"eigenvectors of the mean over {len(starts)} segments of {length / fs:.3g} s"
    k = 2 * np.pi * f[rows] / sound_speed
    return Pressures(f[rows], k.astype(complex), p[rows], noise[rows] / independent, how, spacing)


def _within(row: np.ndarray, keep: np.ndarray, seen: np.ndarray, band, max_rows: int, apart: float) -> np.ndarray:
    """Return at most `max_rows` of the rows `keep`, ascending in frequency.

    `row` (R,), index of the frequency of each row in `seen` (M,), Hz; `keep` (n,), rows above the noise, best first;
    `apart`, Hz: different frequencies are at least 3/4 of it apart.
    """
    counts = np.bincount(row[keep], minlength=len(seen))
    used = np.flatnonzero(counts)
    used = used[np.argsort(seen[used], kind="stable")]
    kept = used[spread_over_band(seen[used], band, max(1, int(max_rows * len(used) / len(keep))), apart)]
    while counts[kept].sum() > max_rows and len(kept) > 1:  # the frequencies may have several rows each
        kept = np.delete(kept, np.argmax(counts[kept]))
    chosen = keep[np.isin(row[keep], kept)]
    return chosen[np.lexsort((np.arange(len(chosen)), seen[row[chosen]]))][:max_rows]


def segments(recording: Recording, band: Band) -> tuple[int, np.ndarray]:
    """Return the length of a segment and the samples at which the segments start, half overlapping."""
    fs = recording.sample_rate
    wanted = np.clip(2 * recording.duration / (SEGMENTS.count + 1), SEGMENTS.min_duration, SEGMENTS.max_duration)
    length = fast_length(int(min(wanted * fs, SEGMENTS.max_samples / recording.count)))
    # A recording of `min_duration` may be shorter than 4 segments, whose lengths are rounded.
    if length / fs < 3.9 / band[0] or recording.duration < 0.99 * min_duration(band[0]):
        problem = f"{recording.path} lasts {recording.duration:.3g} s, too short for a mean at {band[0]:g} Hz"
        least = max(8 / band[0], SEGMENTS.min_duration) * SEGMENTS.count
        raise InputError(problem, f"record {least:.0f} s or more; for an impulse response, give <kind> impulse")
    starts = np.arange(0, recording.samples - length + 1, length // 2)
    if len(starts) > SEGMENTS.max_count:
        starts = starts[np.linspace(0, len(starts) - 1, SEGMENTS.max_count).astype(int)]
    return length, starts


def min_duration(low: float) -> float:
    """Return the shortest duration, seconds, of a recording from which a mean can be taken at `low` Hz."""
    return 4 * max(SEGMENTS.min_duration, 8 / low)


def room_spacing(powers: np.ndarray, window: float) -> Spacing:
    """Return the useful spacing of frequencies, from the power of the channels over frequency.

    The field of a room that decays evenly decorrelates as |r|^2 = 1 / (1 + (x / h)^2) over a distance of x Hz, and so
    does its power; 1 / T_eq is pi h. A width below that of the window cannot be measured; the width of the window is
    used instead.

    `powers` (N, B): power of N channels at B frequencies, `window` / 2 apart; `window`: width of the window, Hz.
    """
    step = window / 2
    relative = powers / np.maximum(powers.mean(axis=0), 1e-300)  # the source's spectrum is common to all channels
    varying = relative - relative.mean(axis=1, keepdims=True)
    low, high = LAGS
    lags = np.arange(low, max(low + 1, powers.shape[1] // 2))
    alike = np.array([np.mean(varying[:, lag:] * varying[:, :-lag]) for lag in lags])
    near = float(alike[: high - low + 1].mean())
    below = np.flatnonzero(alike < near / 2)
    half = lags[below[0]] * step if near > 0 and len(below) else 0.0
    half = half if half > lags[min(1, len(lags) - 1)] * step else 0.0  # 0: not wider than the window
    decorrelation = max(float(np.pi * half), window)
    return Spacing(max(decorrelation / OVERSAMPLING, window), decorrelation)


def cross_spectra(recording: Recording, number, length: int, starts) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean cross-spectral matrices (M, N, N) and the mean frequencies within the window (M,), Hz.

    `number` (M,), bins of the transform of one segment of `length` samples; `starts` (K,), first sample of each.
    """
    count, fs = recording.count, recording.sample_rate
    C = np.zeros((len(number), count, count), dtype=complex)
    moment, total = np.zeros(len(number)), np.zeros(len(number))
    first = int(number.min()) - 1
    at = number - first
    for bare in _bare_spectra(recording, length, starts, first, int(number.max()) + 1):
        before, here, after = bare[:, at - 1].T, bare[:, at].T, bare[:, at + 1].T
        X = here / 2 - (before + after) / 4
        slope = np.pi / (2j * length) * (before - after)
        for m, row in enumerate(X):  # all at once would need twice the memory
            C[m] += np.outer(row, row.conj())
        moment += np.sum((1j * slope * X.conj()).real, axis=1)
        total += np.sum(np.abs(X) ** 2, axis=1)
    return C / len(starts), number * fs / length + moment / (2 * np.pi * np.maximum(total, 1e-300)) * fs


def _bare_spectra(recording: Recording, length: int, starts, first: int, last: int) -> Iterator[np.ndarray]:
    """Yield the bins `first` to `last` of every channel of each segment, without a window : (N, last - first + 1)."""
    for start in starts:
        values = read_samples(recording, int(start), int(start) + length).astype(np.float32)
        yield np.array([rfft(row)[first : last + 1] for row in values], complex)


def eigenvectors(C: Complexes, independent: float, leakage: float) -> tuple[Integers, Complexes, Reals, Reals]:
    """Return the rows above noise and leakage, at least one for each frequency, sorted by the number of the eigenvalue.

    `C` (M, N, N) are means over K `independent` segments; `leakage` is the ratio of the second to the first eigenvalue
    of a single source.
    Returns the index of the frequency (R,), the eigenvector (R, N) scaled to the power of the source, the noise power v
    of one segment (R,) and the SNR (R,) as a ratio of powers.
    """
    values, vectors = np.linalg.eigh(C)
    values, vectors = np.maximum(values[:, ::-1], 0), vectors[:, :, ::-1]
    count = C.shape[1]
    edge = OVER_NOISE * (1 + np.sqrt(count / independent)) ** 2
    rank = np.ones(len(C), dtype=np.int64)
    for k in range(1, min(MAX_RANK, count // 2)):
        noise = values[:, k + 1 :].mean(axis=1)
        more = (values[:, k] > edge * noise) & (values[:, k] > OVER_LEAKAGE * leakage * values[:, 0])
        rank[more & (rank == k)] += 1
    noise = np.array([one[k:].mean() for one, k in zip(values, rank, strict=True)])
    row = np.concatenate([np.flatnonzero(rank > k) for k in range(rank.max())])
    order = np.concatenate([np.full(np.count_nonzero(rank > k), k) for k in range(rank.max())])
    power = np.maximum(values[row, order] - noise[row], 0)
    p = np.sqrt(power)[:, None] * vectors[row, :, order]
    return row, p, noise[row], power / count / np.maximum(noise[row], 1e-300)
