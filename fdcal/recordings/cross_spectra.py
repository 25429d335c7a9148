"""Pressures from a stationary source: noise, music, speech or a machine, whose signal is unknown.

Over one segment T of the recording, under a smooth window, the transforms of all channels at one frequency are the
field there times the spectrum of what the source emitted: p s + noise. Their cross-spectral matrix over K segments is

    C = |s|^2 p p^H + v I,

and its dominant eigenvector is p, up to a factor, with a noise power of v / K. A window has a bandwidth of about 2 / T,
though, and a resonance narrower than that rings at its own frequency, not at that of the window. So the frequency of p,
and with it k, is the mean frequency within the window. With w' the slope of the window, and X and X' the transforms
under w and w',

    f_p = f + Re sum(j X' conj X) / (2 pi sum |X|^2).

    w    Hann's window, whose transforms follow from those without a window at three neighbouring bins
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..acoustics.fft import fast_length, rfft
from ..model.problem import mode_power
from ..model.validation import InputError
from . import frequency_selection
from .decimation import decimate
from .impulse_response import Pressures
from .recording import Recording, in_memory, read_samples


@dataclass(frozen=True)
class SegmentSettings:
    """How a recording is divided into segments over which cross-spectra are averaged.

    Attributes
    ----------
    min_count : int
        Least number of segments of which a mean is taken.
    min_duration, max_duration : float
        Of a segment, seconds.
    max_samples : int
        Of all channels in one segment.
    max_matrix : int
        Numbers in all cross-spectral matrices together.
    max_count : int
        Segments read from a long recording, evenly spread.
    independence : float
        Independent segments per segment: Hann's windows that overlap by half are nearly independent.
    """

    min_count: int = 15
    min_duration: float = 0.5
    max_duration: float = 8.0
    max_samples: int = 20_000_000
    max_matrix: int = 10_000_000
    max_count: int = 600
    independence: float = 0.95


SEGMENTS = SegmentSettings()


def stationary_pressures(
    recording: Recording,
    band: tuple[float, float],
    sound_speed: float,
    most: int = frequency_selection.DEFAULT_COUNT,
    reference: int | None = None,
) -> Pressures:
    """Return the pressures of a recording of a stationary source.

    Parameters
    ----------
    recording : Recording
    band : (float, float)
        Hz.
    sound_speed : float
        m/s.
    most : int
        Greatest number of frequencies.
    reference : int, optional
        Channel against which cross-spectra are taken; without one, the dominant eigenvector is.

    Raises
    ------
    InputError
        The recording is too short, or no frequency rises above the noise.
    """
    recording = in_memory(decimate(recording, band[1]))
    length, starts = segments(recording, band)
    grid, power = mean_power(recording, band, length, starts)
    resolution = 2 * recording.sample_rate / length
    spare = max(20, min(2 * most, SEGMENTS.max_matrix // recording.count**2))  # some will prove too noisy
    chosen = frequency_selection.choose_frequencies(grid, power, np.zeros(len(grid)), resolution, spare)
    number = np.round(grid[chosen] * length / recording.sample_rate).astype(int)
    C, seen = cross_spectra(recording, number, length, starts)
    independent = SEGMENTS.independence * len(starts)
    p, noise, snr = dominant(C) if reference is None else against(C, reference)
    keep = np.flatnonzero(snr * independent >= 10 ** (frequency_selection.THRESHOLDS.min_snr / 10))
    if not len(keep):
        raise InputError(
            f"{recording.path}: the microphones are not coherent at any frequency between {band[0]:g} and"
            f" {band[1]:g} Hz",
            "record one source only, louder than the noise",
        )
    keep = keep[np.argsort(-snr[keep], kind="stable")]
    keep = keep[frequency_selection.spread_over_band(seen[keep], band, most)]
    keep = keep[np.concatenate([[True], np.diff(seen[keep]) > 0.25 * resolution])]
    how = f"{len(starts)} segments of {length / recording.sample_rate:.3g} s"
    how += ", dominant eigenvector" if reference is None else f", against microphone {recording.names[reference]}"
    k = 2 * np.pi * seen[keep] / sound_speed
    return Pressures(seen[keep], k.astype(complex), p[keep], noise[keep] / independent, how)


def segments(recording: Recording, band: tuple[float, float]) -> tuple[int, np.ndarray]:
    """Return the length of a segment and the samples at which the segments start, half overlapping.

    Raises
    ------
    InputError
        The recording is too short.
    """
    fs = recording.sample_rate
    wanted = np.clip(2 * recording.duration / (SEGMENTS.min_count + 1), SEGMENTS.min_duration, SEGMENTS.max_duration)
    length = fast_length(int(min(wanted * fs, SEGMENTS.max_samples / recording.count)))
    if length / fs < 4 / band[0] or recording.samples < 4 * length:
        raise InputError(
            f"{recording.path} lasts {recording.duration:.3g} s, too short for a mean at {band[0]:g} Hz",
            f"record {max(8 / band[0], SEGMENTS.min_duration) * SEGMENTS.min_count:.0f} s or more; if it is an impulse"
            " response, import it with <kind> impulse",
        )
    starts = np.arange(0, recording.samples - length + 1, length // 2)
    if len(starts) > SEGMENTS.max_count:
        starts = starts[np.linspace(0, len(starts) - 1, SEGMENTS.max_count).astype(int)]
    return length, starts


def mean_power(recording: Recording, band, length: int, starts) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies (B,), Hz, and the power (B,) there, mean over segments and microphones."""
    fs = recording.sample_rate
    first, last = max(2, int(np.ceil(band[0] * length / fs))), int(np.floor(band[1] * length / fs))
    total = np.zeros(last - first + 1)
    for bare in _bare_spectra(recording, length, starts, first - 1, last + 1):
        total += np.sum(np.abs(bare[:, 1:-1] / 2 - (bare[:, :-2] + bare[:, 2:]) / 4) ** 2, axis=0)
    return np.arange(first, last + 1) * fs / length, total / len(starts) / recording.count


def cross_spectra(recording: Recording, number, length: int, starts) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean cross-spectral matrices and the mean frequencies within the window.

    Parameters
    ----------
    recording : Recording
    number : (M,) int
        Bins of the transform of one segment.
    length : int
        Samples of a segment.
    starts : (K,) int
        First samples of the segments.

    Returns
    -------
    (M, N, N) complex128, (M,) float64
        Mean of X X^H; frequencies, Hz.
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
    shift = moment / (2 * np.pi * np.maximum(total, 1e-300)) * fs
    return C / len(starts), number * fs / length + shift


def _bare_spectra(recording: Recording, length: int, starts, first: int, last: int) -> Iterator[np.ndarray]:
    """Yield the bins `first` to `last` of every channel of each segment, without a window : (N, last - first + 1)."""
    bare = np.empty((recording.count, last - first + 1), dtype=complex)
    for start in starts:
        values = read_samples(recording, int(start), int(start) + length).astype(np.float32)
        for n, row in enumerate(values):
            bare[n] = rfft(row)[first : last + 1]
        yield bare


def dominant(C: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the scaled dominant eigenvector (M, N), the noise power v of one segment (M,) and their ratio (M,).

    The power of the eigenvector is that of the source.
    """
    values, vectors = np.linalg.eigh(C)
    count = C.shape[1]
    noise = np.maximum(values[:, :-1], 0).mean(axis=1)
    power = np.maximum(values[:, -1] - noise, 0)
    return np.sqrt(power)[:, None] * vectors[:, :, -1], noise, power / count / np.maximum(noise, 1e-300)


def against(C: np.ndarray, reference: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the same as `dominant`, by cross-spectra against one microphone; noise is what is not coherent with it."""
    diagonal = np.maximum(np.einsum("mii->mi", C).real, 1e-300)
    own = diagonal[:, reference]
    p = C[:, :, reference] / np.sqrt(own)[:, None]
    others = np.arange(C.shape[1]) != reference
    noise = np.mean(np.maximum(diagonal - np.abs(p) ** 2, 0)[:, others], axis=1)
    return p, noise, mode_power(p) / np.maximum(noise, 1e-300)
