"""Pressures from complete recordings: an impulse response, a clap, a whole sweep, from silence to the end of the sound.

The transform of such a recording is a Helmholtz solution at each frequency whatever the source did, if the sound has
decayed before the cut, or else has been weighted with exp(-s t) (see `fdcal.acoustics.spectrum`). The weight is no
greater than
needed: what the room has not decayed by itself (see `fdcal.recordings.reverberation`).

    d    rate at which the sound decays, nepers per second
    s    rate of the exponential window; (d + s) T = DECAY
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import next_fast_len, rfft

from ..acoustics.spectrum import DECAY, PADDING, laplace_transform, wavenumber_continuous
from ..model.validation import InputError
from . import frequency_selection
from .recording import Recording, channel_groups, read_samples
from .reverberation import DECAY_CHANNELS, Decay, estimate_decay, extend_to_last_mode

LONGEST = 20_000_000  # samples of a complete recording: longer ones are recordings at work


@dataclass(frozen=True)
class Pressures:
    """What was taken from a recording.

    Attributes
    ----------
    frequencies : (M,) float64, Hz, ascending
    wavenumbers : (M,) complex128, rad/m
    pressures : (M, N) complex128
    noise_power : (M,) float64, unit of abs(pressures)**2, or None where it cannot be told
    how : str, in words
    """

    frequencies: np.ndarray
    wavenumbers: np.ndarray
    pressures: np.ndarray
    noise_power: np.ndarray | None
    how: str


def impulse_response_pressures(
    recording: Recording,
    band: tuple[float, float],
    sound_speed: float,
    window: float | None = None,
    most: int = frequency_selection.MOST,
    noise: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Pressures:
    """Pressures of a complete recording. What follows when the sound is gone in the noise is left out.

    Parameters
    ----------
    recording : Recording
    band : Hz, the lowest and highest frequency
    sound_speed : m/s
    window : s, 1/s; as much as needed unless given
    most : greatest number of frequencies
    noise : callable((B,) Hz) -> (B,) noise power of one sample of the transform, where that is known; else the tail
        tells it

    Raises InputError for a recording too short for the band or too long to be complete, and for one without sound.
    """
    if recording.samples > LONGEST:
        raise InputError(
            f"{recording.path} lasts {recording.duration:.0f} s, which is no impulse response; use --kind work"
        )
    decay = extend_to_last_mode(recording, band, estimate_decay(recording, band), noise)
    s = max(0.0, DECAY / recording.duration - decay.rate) if window is None else window
    told = noise or noise_of_tail(recording, decay)
    heard = recording
    if decay.tail is not None and decay.noisy:
        heard = replace(recording, samples=min(recording.samples, int(decay.tail * recording.sample_rate) + 1))
    resolution = max(1 / heard.duration, min(decay.rate + s, DECAY / heard.duration) / np.pi)
    grid, power = mean_power(heard, band, s)
    gain = heard.sample_rate * -np.expm1(-2 * s * heard.duration) / (2 * s) if s > 0 else heard.samples
    density = np.zeros(len(grid)) if told is None else told(grid) * gain
    chosen = frequency_selection.choose_frequencies(grid, power, density, resolution, most)
    f = grid[chosen]
    pressures = np.empty((len(f), heard.count), dtype=complex)
    for channels, samples in channel_groups(heard):
        pressures[:, channels] = laplace_transform(samples, heard.sample_rate, s, f)
    how = f"exponential window of {s:.2g}/s" if s > 0 else "no window: the sound has decayed"
    if heard is not recording:
        how += f" after {heard.duration:.3g} s, where the rest is left out"
    k = wavenumber_continuous(f, s, sound_speed)
    return Pressures(f, k, pressures, None if told is None else density[chosen], how)


def mean_power(recording: Recording, band: tuple[float, float], s: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (B,), Hz, and the power (B,) of the weighted recordings there, mean over the microphones."""
    samples, fs = recording.samples, recording.sample_rate
    padded = next_fast_len(PADDING * samples, real=True)
    first, last = int(np.ceil(band[0] * padded / fs)), int(np.floor(band[1] * padded / fs))
    if last - first < 2:
        raise InputError(
            f"{recording.path} lasts {recording.duration:g} s, too short for {band[0]:g} to {band[1]:g} Hz; record"
            " longer or widen --frequencies"
        )
    weight = np.exp(-s / fs * np.arange(samples))
    power = np.zeros(last - first + 1)
    for _, values in channel_groups(recording):
        for row in values:
            power += np.abs(rfft(row * weight, padded)[first : last + 1]) ** 2
    return np.arange(first, last + 1) * fs / padded, power / recording.count


def noise_of_tail(recording: Recording, decay: Decay) -> Callable[[np.ndarray], np.ndarray] | None:
    """Noise power of one sample of the transform at (B,) Hz, told by the tail : function of them; None without one."""
    if decay.tail is None:
        return None
    start = int(decay.tail * recording.sample_rate)
    length = recording.samples - start
    channels = np.unique(np.linspace(0, recording.count - 1, 4 * DECAY_CHANNELS).astype(int))
    hann = np.hanning(length)
    power = np.zeros(length // 2 + 1)
    for n in channels:
        power += np.abs(rfft(read_samples(recording, start, recording.samples, [n])[0] * hann)) ** 2
    grid = np.arange(len(power)) * recording.sample_rate / length
    return smoothed(grid, power / len(channels) / np.sum(hann**2))


def smoothed(grid: np.ndarray, density: np.ndarray, width: int = 5) -> Callable[[np.ndarray], np.ndarray]:
    """Mean of `width` neighbours of a density (G,) at `grid` (G,) Hz, as a function of frequencies."""
    mean = np.convolve(np.pad(density, width // 2, mode="edge"), np.full(width, 1 / width), mode="valid")
    return lambda frequencies: np.interp(frequencies, grid, mean)
