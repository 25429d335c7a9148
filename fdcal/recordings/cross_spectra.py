"""Pressures from a source at work: noise, music, speech, a machine, known to nobody.

Over one stretch T of the recording, under a smooth window, the transforms of all channels at one frequency are the
field there times what the source happened to say: p s + noise. Their cross-spectral matrix over K stretches is

    C = |s|^2 p p^H + v I,

and its dominant eigenvector is p, up to a factor, with a noise of v / K left. A window sees about 2 / T of bandwidth,
though, and a resonance narrower than that rings at its own frequency, not at the window's. So the frequency of p, and
with it k, is the mean of what the window saw. With w' the window's slope, and X and X' the transforms under w and w',

    f_p = f + Re sum(j X' conj X) / (2 pi sum |X|^2).

    w    Hann's window, whose transforms follow from those without a window at three neighbouring bins
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.fft import next_fast_len, rfft

from ..model.power import mode_power
from ..model.validation import InputError
from . import frequency_selection
from .decimation import decimate
from .impulse_response import Pressures
from .recording import Recording, in_memory, read_samples

STRETCHES = 15  # at least, from which a mean is taken
SHORTEST, LONGEST = 0.5, 8.0  # s, of a stretch
MOST_SAMPLES = 20_000_000  # of all channels in one stretch
MOST_MATRIX = 10_000_000  # numbers of all cross-spectral matrices
MOST_STRETCHES = 600  # read of a long recording, evenly spread


def stationary_pressures(
    recording: Recording,
    band: tuple[float, float],
    sound_speed: float,
    most: int = frequency_selection.MOST,
    reference: int | None = None,
) -> Pressures:
    """Pressures of a recording of a source at work.

    Parameters
    ----------
    recording : Recording
    band : Hz
    sound_speed : m/s
    most : greatest number of frequencies
    reference : channel against which cross-spectra are taken; without one, the dominant eigenvector

    Raises InputError for a recording too short, and where nothing rises above the noise.
    """
    recording = in_memory(decimate(recording, band[1]))
    length, starts = stretches(recording, band)
    grid, power = mean_power(recording, band, length, starts)
    resolution = 2 * recording.sample_rate / length
    spare = max(20, min(2 * most, MOST_MATRIX // recording.count**2))  # some will prove too noisy
    chosen = frequency_selection.choose_frequencies(grid, power, np.zeros(len(grid)), resolution, spare)
    number = np.round(grid[chosen] * length / recording.sample_rate).astype(int)
    C, seen = cross_spectra(recording, number, length, starts)
    independent = 0.95 * len(starts)  # Hann's stretches that overlap by half are nearly so
    p, noise, snr = dominant(C) if reference is None else against(C, reference)
    keep = np.flatnonzero(snr * independent >= 10 ** (frequency_selection.LEAST_SNR / 10))
    if not len(keep):
        raise InputError(
            f"{recording.path}: no frequency between {band[0]:g} and {band[1]:g} Hz is heard alike by the microphones;"
            " one source alone may sound, and it must be louder than the noise"
        )
    keep = keep[np.argsort(-snr[keep], kind="stable")]
    keep = keep[frequency_selection.spread_over_band(seen[keep], band, most)]
    keep = keep[np.concatenate([[True], np.diff(seen[keep]) > 0.25 * resolution])]
    how = f"{len(starts)} stretches of {length / recording.sample_rate:.3g} s"
    how += ", dominant eigenvector" if reference is None else f", against microphone {recording.names[reference]}"
    k = 2 * np.pi * seen[keep] / sound_speed
    return Pressures(seen[keep], k.astype(complex), p[keep], noise[keep] / independent, how)


def stretches(recording: Recording, band: tuple[float, float]) -> tuple[int, np.ndarray]:
    """Length of a stretch and the samples where they start, half overlapping. Raises InputError for too short a one."""
    fs = recording.sample_rate
    wanted = np.clip(2 * recording.duration / (STRETCHES + 1), SHORTEST, LONGEST)
    length = next_fast_len(int(min(wanted * fs, MOST_SAMPLES / recording.count)), real=True)
    if length / fs < 4 / band[0] or recording.samples < 4 * length:
        raise InputError(
            f"{recording.path} lasts {recording.duration:.3g} s: too short to take means at {band[0]:g} Hz; record"
            f" {max(8 / band[0], SHORTEST) * STRETCHES:.0f} s or more"
        )
    starts = np.arange(0, recording.samples - length + 1, length // 2)
    if len(starts) > MOST_STRETCHES:
        starts = starts[np.linspace(0, len(starts) - 1, MOST_STRETCHES).astype(int)]
    return length, starts


def mean_power(recording: Recording, band, length: int, starts) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (B,), Hz, and the power (B,) there, mean over stretches and microphones."""
    fs = recording.sample_rate
    first, last = max(2, int(np.ceil(band[0] * length / fs))), int(np.floor(band[1] * length / fs))
    total = np.zeros(last - first + 1)
    for bare in _bare_spectra(recording, length, starts, first - 1, last + 1):
        total += np.sum(np.abs(bare[:, 1:-1] / 2 - (bare[:, :-2] + bare[:, 2:]) / 4) ** 2, axis=0)
    return np.arange(first, last + 1) * fs / length, total / len(starts) / recording.count


def cross_spectra(recording: Recording, number, length: int, starts) -> tuple[np.ndarray, np.ndarray]:
    """Mean of X X^H at the bins `number` (M,), and the mean frequency seen : (M, N, N) complex128, (M,) Hz."""
    count, fs = recording.count, recording.sample_rate
    C = np.zeros((len(number), count, count), dtype=complex)
    moment, total = np.zeros(len(number)), np.zeros(len(number))
    first = int(number.min()) - 1
    at = number - first
    for bare in _bare_spectra(recording, length, starts, first, int(number.max()) + 1):
        before, here, after = bare[:, at - 1].T, bare[:, at].T, bare[:, at + 1].T
        X = here / 2 - (before + after) / 4
        slope = np.pi / (2j * length) * (before - after)
        for m, row in enumerate(X):  # all at once would take the memory twice
            C[m] += np.outer(row, row.conj())
        moment += np.sum((1j * slope * X.conj()).real, axis=1)
        total += np.sum(np.abs(X) ** 2, axis=1)
    shift = moment / (2 * np.pi * np.maximum(total, 1e-300)) * fs
    return C / len(starts), number * fs / length + shift


def _bare_spectra(recording: Recording, length: int, starts, first: int, last: int) -> Iterator[np.ndarray]:
    """Of each stretch, the bins `first` to `last` of every channel without a window : (N, last - first + 1)."""
    bare = np.empty((recording.count, last - first + 1), dtype=complex)
    for start in starts:
        values = read_samples(recording, int(start), int(start) + length).astype(np.float32)
        for n, row in enumerate(values):
            bare[n] = rfft(row)[first : last + 1]
        yield bare


def dominant(C: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Dominant eigenvector with its power (M, N), the noise power v of one stretch (M,), and their ratio (M,)."""
    values, vectors = np.linalg.eigh(C)
    count = C.shape[1]
    noise = np.maximum(values[:, :-1], 0).mean(axis=1)
    power = np.maximum(values[:, -1] - noise, 0)
    return np.sqrt(power)[:, None] * vectors[:, :, -1], noise, power / count / np.maximum(noise, 1e-300)


def against(C: np.ndarray, reference: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `dominant`, by cross-spectra against one microphone; the noise is what is not coherent with it."""
    diagonal = np.maximum(np.einsum("mii->mi", C).real, 1e-300)
    own = diagonal[:, reference]
    p = C[:, :, reference] / np.sqrt(own)[:, None]
    others = np.arange(C.shape[1]) != reference
    noise = np.mean(np.maximum(diagonal - np.abs(p) ** 2, 0)[:, others], axis=1)
    return p, noise, mode_power(p) / np.maximum(noise, 1e-300)
