"""How the sound of a recording decays, by its level in pieces of time.

The band in use alone tells it, for noise at other frequencies lasts to the end of a recording and says nothing of the
room. The mean level of the band says when most of it is gone; a mode that decays more slowly than the others rings on.
So the sound ends where what follows is at no frequency louder than the end of the recording.

    c    s, where the sound may be over; what follows is looked at as long again, and so is the end of the recording
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import fdtri

from ..acoustics.spectrum import PADDING
from ..model.validation import InputError
from .recording import GROUP_SAMPLES, Recording, read_samples

DECAY_CHANNELS = 24  # channels by which the decay is told
PIECES = 48  # of the recording, in each of which the level is told
ABOVE_FLOOR = 2.0  # nepers of power above the last tenth: nearer to it a level is noise
FAINTEST = 1e-6  # of the greatest power: what is below tells nothing of the decay
NEARER = 0.25  # of a recording: a sound that fills less of it is looked at again, in shorter pieces
LATER = 1.2  # factor by which the end of the sound is set later until no mode rings on
LONGEST_RING = 4.0  # s, of what follows the sound, in which modes are looked for that ring on
HARMLESS = 0.5  # of the noise of a pressure: what the cut may leave out
CHANCE = 0.05  # that noise alone is taken for a mode that rings on
LEAST_TAIL = 0.1, 0.25  # of the recording, or in seconds if that is less, that noise must fill to be told


@dataclass(frozen=True)
class Decay:
    """Of a sound: `rate` d, 1/s; `tail`, s from which on there is noise alone, or None where the sound lasts; `noisy`,
    whether that noise is what ends the sound, and not the precision of what is looked at."""

    rate: float
    tail: float | None
    noisy: bool = True


def estimate_decay(recording: Recording, band: tuple[float, float]) -> Decay:
    """How the sound in a band (Hz, Hz) decays, by the level of a few channels in pieces of the part that sounds.

    Raises InputError for a recording that is silent in the band.
    """
    decay = _by_level(recording, band)
    while decay.tail is not None and decay.tail < NEARER * recording.duration:
        recording = replace(recording, samples=int(2 * decay.tail * recording.sample_rate) + 1)
        nearer = _by_level(recording, band) if recording.samples > 4 * PIECES else decay
        if nearer.tail is None or nearer.tail >= decay.tail:
            break
        decay = nearer
    return decay


def extend_to_last_mode(
    recording: Recording, band: tuple[float, float], decay: Decay, noise: Callable[[np.ndarray], np.ndarray] | None
) -> Decay:
    """`decay` with its tail set so late that no mode of the band rings on in it, or as late as tells the noise.

    `noise`, a function of (B,) Hz, is the power (B,) of one sample of the transform where that is known already: noise
    that is not the same at all times is then no mode.
    """
    if decay.tail is None:
        return decay
    c, fs = decay.tail, recording.sample_rate
    last = recording.duration - min(LEAST_TAIL[0] * recording.duration, LEAST_TAIL[1])
    while c < last and _rings_on(recording, band, int(c * fs) + 1, noise):
        c *= LATER
    if c > decay.tail:
        c = min(LATER**2 * c, max(last, decay.tail))  # a mode not told from noise any more is not yet below it
    return replace(decay, tail=c)


def _rings_on(recording: Recording, band: tuple[float, float], start: int, noise) -> bool:
    """Whether a mode is heard after the sample `start` that is not heard any more at the end."""
    fs = recording.sample_rate
    length = min(start, (recording.samples - start) // 2, int(LONGEST_RING * fs))
    channels = np.unique(np.linspace(0, recording.count - 1, DECAY_CHANNELS).astype(int))
    padded = next_fast_len(PADDING * length, real=True)
    f = np.arange(padded // 2 + 1) * fs / padded
    inside = (f >= band[0]) & (f <= band[1])
    first, end = (
        np.mean(np.abs(rfft(read_samples(recording, at, at + length, channels), padded)[:, inside]) ** 2, axis=0)
        for at in (start, recording.samples - length)
    )
    if noise is not None:
        end = np.maximum(end, noise(f[inside]) * length)
    chance = CHANCE / max(1, np.sum(inside))
    by_chance = fdtri(2 * len(channels), 2 * len(channels), 1 - chance) - 1
    return bool(np.any(first - end > end * max(HARMLESS * start / length, by_chance)))


def _by_level(recording: Recording, band: tuple[float, float]) -> Decay:
    """The decay in a band by the level of a few channels in equal pieces of the recording."""
    level = segment_levels(recording, band)
    if not level.max() > 0:
        raise InputError(f"{recording.path} is silent between {band[0]:g} and {band[1]:g} Hz; name another band")
    nepers = np.log(np.maximum(level, 1e-30 * level.max()))
    last = [np.mean(level[-pieces:]) for pieces in (PIECES // 10 + 1, 2)]
    quiet = last[1] if last[1] < np.exp(-ABOVE_FLOOR) * last[0] else last[0]  # the sound may have ended only just now
    noisy = bool(quiet > FAINTEST * level.max())
    floor = np.log(max(quiet, FAINTEST * level.max()))
    top, above = int(np.argmax(level)), nepers > floor + ABOVE_FLOOR
    end = int(np.flatnonzero(above)[-1]) + 1 if np.any(above) else top
    high = int(np.flatnonzero(nepers >= (nepers[top] + floor) / 2)[-1])  # a sweep only falls when it is over
    piece = recording.duration / PIECES
    if end - high < 3:  # too quick to be followed, or none at all
        quick = nepers[top] - nepers[-1] > 2 * ABOVE_FLOOR
        tail = _told(recording, (end + 1) * piece) if quick else None
        return Decay(ABOVE_FLOOR / piece if quick else 0.0, tail, noisy)
    slope = np.polyfit(piece * np.arange(high, end), nepers[high:end], 1)[0]
    rate = max(0.0, -float(slope) / 2)
    reached = (end + 1) * piece + ABOVE_FLOOR / max(2 * rate, 1e-9)
    return Decay(rate, _told(recording, reached), noisy)


def _told(recording: Recording, reached: float) -> float | None:
    """`reached`, s, if what follows is long enough to tell the noise."""
    least = min(LEAST_TAIL[0] * recording.duration, LEAST_TAIL[1])
    return reached if recording.duration - reached >= least else None


def segment_levels(recording: Recording, band: tuple[float, float]) -> np.ndarray:
    """Power in the band, mean over a few channels, in each of PIECES pieces : (PIECES,) float64."""
    channels = np.unique(np.linspace(0, recording.count - 1, DECAY_CHANNELS).astype(int))
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
        values = read_samples(recording, start, stop, channels)
        rows.append(values.reshape(len(channels), -1, factor).mean(axis=2))
    return np.concatenate(rows, axis=1), recording.sample_rate / factor
