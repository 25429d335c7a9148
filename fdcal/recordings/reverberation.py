"""How the sound of a recording decays, from its level in successive segments.

Only the band in use counts, since noise at other frequencies lasts to the end of a recording and says nothing about the
room. The mean level of the band shows when most of the sound is gone; a mode that decays more slowly than the others
rings on. So the sound ends where what follows is at no frequency louder than the end of the recording.

    c    s, where the sound may be over; an equally long part after it is compared with the end of the recording
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtri

from ..acoustics.spectrum import SPECTRUM, fast_length, irfft, rfft
from ..model.validation import InputError
from .recording import GROUP_SAMPLES, Recording, read_samples


@dataclass(frozen=True)
class DecaySettings:
    """How the decay is measured."""

    channels: int = 24  # number of channels of which the decay is measured
    segments: int = 48  # of the recording, in each of which the level is measured
    above_floor: float = 2.0  # nepers of power above the last tenth of the recording; a level nearer to it is noise
    min_power: float = 1e-6  # relative to the greatest power; what is below says nothing about the decay
    zoom: float = 0.25  # share of the recording; a sound that fills less of it is measured again, in shorter segments
    extension: float = 1.2  # factor by which the end of the sound is moved until no mode rings on
    max_ringing: float = 4.0  # length of the part after the sound in which modes are sought that ring on, seconds
    max_loss: float = 0.5  # power that the cut may leave out, relative to the noise of a pressure
    false_alarm: float = 0.05  # probability that noise alone is taken for a mode that rings on
    # min_tail_share, min_tail: share of the recording, or seconds if that is less, that noise must fill to be estimated
    min_tail_share: float = 0.1
    min_tail: float = 0.25


DECAY = DecaySettings()


@dataclass(frozen=True)
class Decay:
    """The decay of a sound."""

    rate: float  # d, nepers per second
    tail: float | None  # from where on there is noise only, seconds; None where the sound lasts
    noisy: bool = True  # whether the sound ends in noise, and not at the numerical floor of the level


def estimate_decay(recording: Recording, band: tuple[float, float]) -> Decay:
    """Return how the sound in a band, Hz, decays, from the level of a few channels."""
    decay = _decay_by_level(recording, band)
    while decay.tail is not None and decay.tail < DECAY.zoom * recording.duration:
        recording = replace(recording, samples=int(2 * decay.tail * recording.sample_rate) + 1)
        enough = recording.samples > 4 * DECAY.segments
        nearer = _decay_by_level(recording, band) if enough else decay
        if nearer.tail is None or nearer.tail >= decay.tail:
            break
        decay = nearer
    return decay


def extend_to_last_mode(
    recording: Recording, band: tuple[float, float], decay: Decay, noise: Callable[[np.ndarray], np.ndarray] | None
) -> Decay:
    """Return `decay` with its tail moved until no mode of the band rings on in it, as far as noise can be estimated.

    `noise`: power of one sample of the transform where it is known: noise that varies in time is then no mode.
    """
    if decay.tail is None:
        return decay
    c, fs = decay.tail, recording.sample_rate
    last = recording.duration - _min_tail(recording)
    while c < last and _rings_on(recording, band, int(c * fs) + 1, noise):
        c *= DECAY.extension
    if c > decay.tail:
        # A mode that can no longer be distinguished from noise is not yet below it.
        c = min(DECAY.extension**2 * c, max(last, decay.tail))
    return replace(decay, tail=c)


def _min_tail(recording: Recording) -> float:
    """Return how much noise is needed to estimate its power, seconds."""
    return min(DECAY.min_tail_share * recording.duration, DECAY.min_tail)


def _measured_channels(recording: Recording) -> np.ndarray:
    return np.unique(np.linspace(0, recording.count - 1, DECAY.channels).astype(int))


def _rings_on(recording: Recording, band: tuple[float, float], start: int, noise) -> bool:
    """Return whether a mode is audible after the sample `start` that is no longer audible at the end."""
    fs = recording.sample_rate
    length = min(start, (recording.samples - start) // 2, int(DECAY.max_ringing * fs))
    channels = _measured_channels(recording)
    padded = fast_length(SPECTRUM.padding * length)
    f = np.arange(padded // 2 + 1) * fs / padded
    inside = (f >= band[0]) & (f <= band[1])
    first, end = (
        np.mean(np.abs(rfft(read_samples(recording, at, at + length, channels), padded)[:, inside]) ** 2, axis=0)
        for at in (start, recording.samples - length)
    )
    if noise is not None:
        end = np.maximum(end, noise(f[inside]) * length)
    chance = DECAY.false_alarm / max(1, np.sum(inside))
    by_chance = fdtri(2 * len(channels), 2 * len(channels), 1 - chance) - 1
    return bool(np.any(first - end > end * max(DECAY.max_loss * start / length, by_chance)))


def _decay_by_level(recording: Recording, band: tuple[float, float]) -> Decay:
    """Return the decay in a band by the level of a few channels in equal segments of the recording."""
    level = segment_levels(recording, band)
    if not level.max() > 0:
        problem = f"{recording.path} is silent between {band[0]:g} and {band[1]:g} Hz"
        raise InputError(problem, "choose another band: <frequencies>", key="frequencies")
    nepers = np.log(np.maximum(level, 1e-30 * level.max()))
    tenth, quiet = (float(np.mean(level[-count:])) for count in (DECAY.segments // 10 + 1, 2))
    if quiet >= np.exp(-DECAY.above_floor) * tenth:  # else the sound has ended only just before
        quiet = tenth
    noisy = bool(quiet > DECAY.min_power * level.max())
    floor = np.log(max(quiet, DECAY.min_power * level.max()))
    top, above = int(np.argmax(level)), nepers > floor + DECAY.above_floor
    end = int(np.flatnonzero(above)[-1]) + 1 if np.any(above) else top
    high = int(np.flatnonzero(nepers >= (nepers[top] + floor) / 2)[-1])  # a sweep decays only after its end
    segment = recording.duration / DECAY.segments
    if end - high < 3:  # too fast to be measured, or no decay at all
        fast = nepers[top] - nepers[-1] > 2 * DECAY.above_floor
        tail = _tail_at(recording, (end + 1) * segment) if fast else None
        return Decay(DECAY.above_floor / segment if fast else 0.0, tail, noisy)
    slope = np.polyfit(segment * np.arange(high, end), nepers[high:end], 1)[0]
    rate = max(0.0, -float(slope) / 2)
    reached = (end + 1) * segment + DECAY.above_floor / max(2 * rate, 1e-9)
    return Decay(rate, _tail_at(recording, reached), noisy)


def _tail_at(recording: Recording, reached: float) -> float | None:
    """Return `reached`, s, if what follows is long enough to estimate the noise."""
    return reached if recording.duration - reached >= _min_tail(recording) else None


def segment_levels(recording: Recording, band: tuple[float, float]) -> np.ndarray:
    """Return the power in the band in each segment, mean over a few channels : (segments,) float64."""
    reduced, fs = _reduced(recording, _measured_channels(recording), 16 * band[1])
    samples = reduced.shape[1]
    padded = fast_length(SPECTRUM.padding * samples)  # so that nothing of the start wraps round to the end
    f = np.arange(padded // 2 + 1) * fs / padded
    smooth = np.sin(np.pi / 2 * np.clip(2 - f / band[1], 0, 1) * np.clip(f / band[0], 0, 1)) ** 2
    total = np.zeros(DECAY.segments)
    for row in reduced:
        kept = irfft(rfft(row, padded) * smooth, padded)[:samples]
        parts = np.array_split(kept, DECAY.segments)
        total += np.array([np.mean(part**2) if len(part) else 0.0 for part in parts])
    return total / len(reduced)


def whitened_levels(recording: Recording, band: tuple[float, float]) -> np.ndarray:
    """Return the power in half-overlapping segments, each frequency of the band relative to its own quiet quarter.

    It is a mean over a few channels, a geometric one over the frequencies : (2 segments,), about 1 for noise alone.
    Frequencies with less than three periods in a segment are left out, down to a third of the band.
    """
    reduced, fs = _reduced(recording, _measured_channels(recording), 16 * band[1])
    samples = reduced.shape[1]
    length = max(8, samples // DECAY.segments)
    low = max(band[0], min(3 * fs / length, band[1] / 3))
    starts = np.linspace(0, samples - length, 2 * DECAY.segments).astype(int)
    whole, padded = fast_length(SPECTRUM.padding * samples), fast_length(SPECTRUM.padding * length)
    above = np.sin(np.pi / 2 * np.clip(2 * np.arange(whole // 2 + 1) * fs / whole / low - 1, 0, 1)) ** 2
    f = np.arange(padded // 2 + 1) * fs / padded
    inside = (f >= low) & (f <= max(band[1], low + fs / length))
    edge = np.clip(np.arange(1, length + 1) / (length / 8), 0, 1)
    taper = np.sin(np.pi / 2 * np.minimum(edge, edge[::-1])) ** 2
    power = np.zeros((len(starts), int(inside.sum())))
    for row in reduced:
        kept = irfft(rfft(row, whole) * above, whole)
        for at, start in enumerate(starts):
            power[at] += np.abs(rfft(kept[start : start + length] * taper, padded)[inside]) ** 2
    least = 1e-12 * max(power.max(), 1e-300)
    quiet = np.percentile(power, 25, axis=0)
    return np.exp(np.mean(np.log(np.maximum(power, least) / np.maximum(quiet, least)), axis=1))


def _reduced(recording: Recording, channels: np.ndarray, least: float) -> tuple[np.ndarray, float]:
    """Return channels (n, t) averaged over neighbouring samples, at a rate of at least `least` Hz if possible."""
    factor = max(1, int(recording.sample_rate / least))
    step = factor * max(1, GROUP_SAMPLES // (4 * factor * len(channels)))
    rows = []
    for start in range(0, recording.samples - factor + 1, step):
        stop = start + (min(step, recording.samples - start) // factor) * factor
        values = read_samples(recording, start, stop, channels)
        rows.append(values.reshape(len(channels), -1, factor).mean(axis=2))
    return np.concatenate(rows, axis=1), recording.sample_rate / factor
