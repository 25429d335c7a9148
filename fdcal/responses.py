"""Pressures from complete recordings: an impulse response, a clap, a whole sweep, from silence to the end of the sound.

The transform of such a recording is a Helmholtz solution at each frequency whatever the source did, if the sound has
decayed before the cut, or else has been weighted with exp(-s t) (see `fdcal.spectrum`). The weight is no greater than
needed: what the room has not decayed by itself. That is told by the band in use alone, for noise at other
frequencies lasts to the end of a recording and says nothing of the room.

    d    rate at which the sound decays, nepers per second
    s    rate of the exponential window; (d + s) T = DECAY
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from . import bins
from .checks import InputError
from .recording import GROUP_SAMPLES, Recording, groups, read
from .spectrum import DECAY, PADDING, transform, wavenumber_continuous

LISTENED = 24  # channels by which the decay is told
PIECES = 48  # of the recording, in each of which the level is told
ABOVE_FLOOR = 2.0  # nepers of power above the last tenth: nearer to it a level is noise
FAINTEST = 1e-6  # of the greatest power: what is below tells nothing of the decay
LEAST_TAIL = 0.1  # of the recording, that noise must fill to be told
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


@dataclass(frozen=True)
class Decay:
    """Of a sound: `rate` d, 1/s; `tail`, s from which on there is noise alone, or None where the sound lasts."""

    rate: float
    tail: float | None


def from_response(
    recording: Recording,
    band: tuple[float, float],
    sound_speed: float,
    window: float | None = None,
    most: int = bins.MOST,
) -> Pressures:
    """Pressures of a complete recording.

    Parameters
    ----------
    recording : Recording
    band : Hz, the lowest and highest frequency
    sound_speed : m/s
    window : s, 1/s; as much as needed unless given
    most : greatest number of frequencies

    Raises InputError for a recording too short for the band or too long to be complete, and for one without sound.
    """
    if recording.samples > LONGEST:
        raise InputError(
            f"{recording.path} lasts {recording.duration:.0f} s, which is no impulse response; use --kind work"
        )
    decay = decay_of(recording, band)
    s = max(0.0, DECAY / recording.duration - decay.rate) if window is None else window
    grid, power = mean_power(recording, band, s)
    density = noise_density(recording, decay, grid)
    gain = recording.sample_rate * -np.expm1(-2 * s * recording.duration) / (2 * s) if s > 0 else recording.samples
    noise = np.zeros(len(grid)) if density is None else density * gain
    resolution = max(1 / recording.duration, min(decay.rate + s, DECAY / recording.duration) / np.pi)
    chosen = bins.choose(grid, power, noise, resolution, most)
    f = grid[chosen]
    pressures = np.empty((len(f), recording.count), dtype=complex)
    for channels, samples in groups(recording):
        pressures[:, channels] = transform(samples, recording.sample_rate, s, f)
    told = f"exponential window of {s:.2g}/s" if s > 0 else "no window: the sound has decayed"
    return Pressures(
        f, wavenumber_continuous(f, s, sound_speed), pressures, None if density is None else noise[chosen], told
    )


def decay_of(recording: Recording, band: tuple[float, float]) -> Decay:
    """How the sound in a band decays, by the level of a few channels in pieces of the recording."""
    level = piece_levels(recording, band)
    if not level.max() > 0:
        raise InputError(f"{recording.path} is silent between {band[0]:g} and {band[1]:g} Hz; name another band")
    nepers = np.log(np.maximum(level, 1e-30 * level.max()))
    floor = np.log(max(np.mean(level[-PIECES // 10 :]), FAINTEST * level.max()))
    top, above = int(np.argmax(level)), nepers > floor + ABOVE_FLOOR
    end = int(np.flatnonzero(above)[-1]) + 1 if np.any(above) else top
    high = int(np.flatnonzero(nepers >= (nepers[top] + floor) / 2)[-1])  # a sweep only falls when it is over
    piece = recording.duration / PIECES
    if end - high < 3:  # too quick to be followed, or none at all
        quick = nepers[top] - nepers[-1] > 2 * ABOVE_FLOOR
        return Decay(ABOVE_FLOOR / piece if quick else 0.0, (end + 1) * piece if quick else None)
    slope = np.polyfit(piece * np.arange(high, end), nepers[high:end], 1)[0]
    rate = max(0.0, -float(slope) / 2)
    reached = (end + 1) * piece + ABOVE_FLOOR / max(2 * rate, 1e-9)
    return Decay(rate, reached if recording.duration - reached >= LEAST_TAIL * recording.duration else None)


def piece_levels(recording: Recording, band: tuple[float, float]) -> np.ndarray:
    """Power in the band, mean over a few channels, in each of PIECES pieces : (PIECES,) float64."""
    channels = np.unique(np.linspace(0, recording.count - 1, LISTENED).astype(int))
    slow, fs = _slow(recording, channels, 16 * band[1])
    samples = slow.shape[1]
    padded = next_fast_len(PADDING * samples, real=True)  # so that nothing of the start wraps round to the end
    f = np.arange(padded // 2 + 1) * fs / padded
    smooth = np.sin(np.pi / 2 * np.clip(2 - f / band[1], 0, 1) * np.clip(f / band[0], 0, 1)) ** 2
    total = np.zeros(PIECES)
    for row in slow:
        kept = irfft(rfft(row, padded) * smooth, padded)[:samples]
        total += [np.mean(piece**2) if len(piece) else 0.0 for piece in np.array_split(kept, PIECES)]
    return total / len(channels)


def _slow(recording: Recording, channels: np.ndarray, least: float) -> tuple[np.ndarray, float]:
    """Channels (n, t), each sample the mean of some, and their sampling rate, at least `least` Hz if may be."""
    factor = max(1, int(recording.sample_rate / least))
    step = factor * max(1, GROUP_SAMPLES // (4 * factor * len(channels)))
    rows = []
    for start in range(0, recording.samples - factor + 1, step):
        stop = start + (min(step, recording.samples - start) // factor) * factor
        values = read(recording, start, stop, channels)
        rows.append(values.reshape(len(channels), -1, factor).mean(axis=2))
    return np.concatenate(rows, axis=1), recording.sample_rate / factor


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
    for _, values in groups(recording):
        for row in values:
            power += np.abs(rfft(row * weight, padded)[first : last + 1]) ** 2
    return np.arange(first, last + 1) * fs / padded, power / recording.count


def noise_density(recording: Recording, decay: Decay, frequencies: np.ndarray) -> np.ndarray | None:
    """Noise power of one sample of the transform at (B,) Hz, told by the tail : (B,) float64; None without a tail."""
    if decay.tail is None:
        return None
    start = int(decay.tail * recording.sample_rate)
    length = recording.samples - start
    channels = np.unique(np.linspace(0, recording.count - 1, 4 * LISTENED).astype(int))
    hann = np.hanning(length)
    power = np.zeros(length // 2 + 1)
    for n in channels:
        power += np.abs(rfft(read(recording, start, recording.samples, [n])[0] * hann)) ** 2
    density = power / len(channels) / np.sum(hann**2)
    grid = np.arange(len(density)) * recording.sample_rate / length
    smooth = np.convolve(np.pad(density, 2, mode="edge"), np.full(5, 0.2), mode="valid")
    return np.interp(frequencies, grid, smooth)
