"""Pressures from an impulse response, a clap or a whole sweep, recorded from silence to the end of the sound.

The transform of such a recording is a solution of the Helmholtz equation at each frequency, whatever the source
emitted, if the sound has decayed before the recording ends, or else has been weighted with exp(-s t) (see
`fdcal.acoustics.spectrum`). The weight is no stronger than needed: it supplies the part of the decay that the room
itself lacks.

    d    rate at which the sound decays, nepers per second
    s    rate of the exponential window: (d + s) T = 12 nepers, where T is the length of the recording
    c    time, seconds, after which the sound may be over; the part from c on is compared with the end of the recording

The decay is measured from the level of the sound in successive segments. Only the band in use counts, since noise at
other frequencies lasts to the end of a recording and says nothing about the room. The mean level of the band shows when
most of the sound is gone; a mode that decays more slowly than the others rings on. The sound therefore counts as over
at the time after which no frequency is louder than it is at the end of the recording.

Where the signal S that the source emitted is given, `deconvolve` divides the recording X by it. X / S, regularised
where S is weak, is the transform of the response, apart from a factor at each frequency that is the same for all
channels and does no harm. The response starts `lead` seconds late, so that it contains the ringing of the band-limited
spectrum, which comes before the sound as well as after it. The division distributes the noise of the recording over its
whole length; if S is a sweep, the division shifts the noise of each frequency by a different time. The noise inside the
response is therefore estimated from all that is outside of it, and not from the end of the recording alone.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtri

from ..acoustics.spectrum import SPECTRUM, fast_length, irfft, laplace_transform, rfft, wavenumber_continuous
from ..model.validation import InputError
from .frequencies import ROWS, Pressures, Spacing, choose_frequencies
from .recording import GROUP_SAMPLES, Band, Noise, Recording, channel_groups, read_samples, recording_of


@dataclass(frozen=True)
class DecaySettings:
    """Settings of the measurement of the decay."""

    channels: int = 24  # number of channels of which the decay is measured
    segments: int = 48  # number of segments of the recording in which the level is measured
    above_floor: float = 2.0  # nepers of power above the last tenth of the recording; a lower level counts as noise
    min_power: float = 1e-6  # relative to the greatest power; lower powers are not used
    # fraction of the recording; a sound that fills less of it is measured again, in shorter segments
    zoom: float = 0.25
    extension: float = 1.2  # factor by which the end of the sound is moved until no mode rings on
    max_ringing: float = 4.0  # longest part after the sound that is searched for modes that ring on, seconds
    max_loss: float = 0.5  # power that the cut may leave out, relative to the noise of a pressure
    false_alarm: float = 0.05  # probability that noise alone is taken for a mode that rings on
    # The noise is estimated if it fills the end of the recording for at least min_tail seconds, or for the fraction
    # min_tail_fraction of the recording if that is shorter
    min_tail_fraction: float = 0.1
    min_tail: float = 0.25

    def last_tail(self, duration: float) -> float:
        """Return the latest start of a tail that is long enough to estimate the power of the noise, seconds."""
        return duration - min(self.min_tail_fraction * duration, self.min_tail)


DECAY = DecaySettings()


@dataclass(frozen=True)
class Decay:
    """The decay of a sound."""

    rate: float  # d, nepers per second
    tail: float | None  # time after which there is only noise, seconds; None if the sound lasts to the end
    noisy: bool = True  # whether the sound ends in noise, and not at the numerical floor of the level


def estimate_decay(recording: Recording, band: Band) -> Decay:
    """Measure the decay of the sound in a band, Hz, from the level of a few channels."""
    decay = _decay_by_level(recording, band)
    while decay.tail is not None and decay.tail < DECAY.zoom * recording.duration:
        recording = replace(recording, samples=int(2 * decay.tail * recording.sample_rate) + 1)
        nearer = _decay_by_level(recording, band) if recording.samples > 4 * DECAY.segments else decay
        if nearer.tail is None or nearer.tail >= decay.tail:
            break
        decay = nearer
    return decay


def extend_to_last_mode(recording: Recording, band: Band, decay: Decay, noise: Noise | None) -> Decay:
    """Return `decay` with a later tail, so that no mode of the band rings on in it.

    `noise`: power of the noise's transform per time sample, if it is known. Noise that varies in time is then not
    mistaken for a mode.
    """
    if decay.tail is None:
        return decay
    c, fs, last = decay.tail, recording.sample_rate, DECAY.last_tail(recording.duration)
    while c < last and _rings_on(recording, band, int(c * fs) + 1, noise):
        c *= DECAY.extension
    if c > decay.tail:
        # A mode that can no longer be distinguished from noise may still be as strong as the noise. The tail therefore
        # begins later.
        c = min(DECAY.extension**2 * c, max(last, decay.tail))
    return replace(decay, tail=c)


def _measured_channels(recording: Recording, count: int = DECAY.channels) -> np.ndarray:
    """Return the indices (n,) of `count` channels, or of all where they are fewer."""
    return np.unique(np.linspace(0, recording.count - 1, count).astype(int))


def _rings_on(recording: Recording, band: Band, start: int, noise) -> bool:
    """Return whether a mode that is inaudible at the end of the recording is audible after the sample `start`."""
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
    by_chance = fdtri(N := 2 * len(channels), N, 1 - DECAY.false_alarm / max(1, np.sum(inside))) - 1
    return bool(np.any(first - end > end * max(DECAY.max_loss * start / length, by_chance)))


def _decay_by_level(recording: Recording, band: Band) -> Decay:
    """Measure the decay in a band from the level of a few channels in equal segments of the recording."""
    level = segment_levels(recording, band)
    if not level.max() > 0:
        problem = f"{recording.path} is silent between {band[0]:g} and {band[1]:g} Hz"
        raise InputError(problem, "choose another band: <frequencies>", key="frequencies")
    nepers = np.log(np.maximum(level, 1e-30 * level.max()))
    tenth, quiet = (float(np.mean(level[-count:])) for count in (DECAY.segments // 10 + 1, 2))
    if quiet >= np.exp(-DECAY.above_floor) * tenth:  # else the sound ended just before the last two segments
        quiet = tenth
    noisy = bool(quiet > DECAY.min_power * level.max())
    floor = np.log(max(quiet, DECAY.min_power * level.max()))
    top, above = int(np.argmax(level)), nepers > floor + DECAY.above_floor
    end = int(np.flatnonzero(above)[-1]) + 1 if np.any(above) else top
    high = int(np.flatnonzero(nepers >= (nepers[top] + floor) / 2)[-1])  # a sweep decays only after its end
    segment = recording.duration / DECAY.segments
    reached = (end + 1) * segment
    if end - high >= 3:
        rate = max(0.0, -float(np.polyfit(segment * np.arange(high, end), nepers[high:end], 1)[0]) / 2)
        reached += DECAY.above_floor / max(2 * rate, 1e-9)
    elif nepers[top] - nepers[-1] > 2 * DECAY.above_floor:  # too fast to be measured
        rate = DECAY.above_floor / segment
    else:
        rate, reached = 0.0, np.inf  # no decay at all
    return Decay(rate, reached if reached <= DECAY.last_tail(recording.duration) else None, noisy)


def segment_levels(recording: Recording, band: Band, count: int = DECAY.channels) -> np.ndarray:
    """Return the power in the band in each segment, averaged over `count` channels : (segments,) float64."""
    reduced, fs = _reduced(recording, band, count)
    samples = reduced.shape[1]
    padded = fast_length(SPECTRUM.padding * samples)  # so that nothing of the start wraps round to the end
    # The filter removes all above 2 band[1], so that a lower sampling rate represents the signal and its square.
    f = np.arange(min(padded // 2 + 1, int(2 * band[1] * padded / fs) + 1)) * fs / padded
    smooth = np.float32(np.sin(np.pi / 2 * np.clip(2 - f / band[1], 0, 1) * np.clip(f / band[0], 0, 1)) ** 2)
    shorter = min(padded, fast_length(4 * len(f)))
    total = np.zeros(DECAY.segments)
    for row in reduced:
        kept = irfft(rfft(row, padded)[: len(f)] * smooth, shorter)[: round(samples * shorter / padded)]
        parts = np.array_split(kept * np.float32(shorter / padded), DECAY.segments)
        total += np.array([np.mean(part**2) if len(part) else 0.0 for part in parts])
    return total / len(reduced)


def _reduced(recording: Recording, band: Band, count: int = DECAY.channels) -> tuple[np.ndarray, float]:
    """Return means (n, t) float32 of successive samples of `count` channels, and their rate, Hz, for a band."""
    channels, factor = _measured_channels(recording, count), max(1, int(recording.sample_rate / (16 * band[1])))
    step = factor * max(1, GROUP_SAMPLES // (4 * factor * len(channels)))
    rows = []
    for start in range(0, recording.samples - factor + 1, step):
        stop = start + (min(step, recording.samples - start) // factor) * factor
        values = read_samples(recording, start, stop, channels)
        rows.append(values.reshape(len(channels), -1, factor).mean(axis=2, dtype=np.float32))
    return np.concatenate(rows, axis=1), recording.sample_rate / factor


RISE = 10.0  # ratio of powers up to which the level of noise may vary
GRID = 6  # points of the spectrum per useful distance of two frequencies
MAX_SAMPLES = 20_000_000  # length of the longest impulse response; longer recordings count as stationary


def impulse_response_pressures(
    recording: Recording, band: Band, sound_speed: float, max_rows: int = ROWS.max_rows, noise: Noise | None = None
) -> Pressures:
    """Return the pressures of an impulse response; the part in which the sound is below the noise is left out.

    `max_rows`: maximum number of frequencies; `noise`: power of the noise's transform per time sample, if it is
    known; otherwise it is estimated from the tail.
    """
    if recording.samples > MAX_SAMPLES:
        problem = f"{recording.path} lasts {recording.duration:.0f} s, which is too long for an impulse response"
        raise InputError(problem, "give <kind> stationary", key="kind")
    decay = extend_to_last_mode(recording, band, estimate_decay(recording, band), noise)
    s = max(0.0, SPECTRUM.decay / recording.duration - decay.rate)
    if noise is None and decay.tail is not None:
        start = int(decay.tail * recording.sample_rate)
        channels, hann = _measured_channels(recording, 4 * DECAY.channels), np.hanning(recording.samples - start)
        tail = np.zeros(len(hann) // 2 + 1)
        for n in channels:
            tail += np.abs(rfft(read_samples(recording, start, recording.samples, [n])[0] * hann)) ** 2
        bins = np.arange(len(tail)) * recording.sample_rate / len(hann)
        noise = smoothed(bins, tail / len(channels) / np.sum(hann**2))
    used = recording
    if decay.tail is not None and decay.noisy:
        used = replace(recording, samples=min(recording.samples, int(decay.tail * recording.sample_rate) + 1))
    spacing = _spacing(used, band, s, noise, decay.rate)
    grid, power = mean_power(used, band, s, spacing.step / GRID)
    gain = used.sample_rate * -np.expm1(-2 * s * used.duration) / (2 * s) if s > 0 else used.samples
    density = np.zeros(len(grid)) if noise is None else noise(grid) * gain
    chosen = choose_frequencies(grid, power, density, spacing.step, max_rows)
    f = grid[chosen]
    pressures = np.empty((len(f), used.count), dtype=complex)
    for channels, samples in channel_groups(used):
        pressures[:, channels] = laplace_transform(samples, used.sample_rate, s, f)
    how = f"exponential window of {s:.2g}/s" if s > 0 else "no window: the sound has decayed"
    if used is not recording:
        how += f"; the recording is cut off at {used.duration:.3g} s, after which there is only noise"
    k = wavenumber_continuous(f, s, sound_speed)
    return Pressures(f, k, pressures, None if noise is None else density[chosen], how, spacing)


def _spacing(recording: Recording, band: Band, s: float, noise: Noise | None, rate: float) -> Spacing:
    """Return the useful spacing of frequencies, from the energy of a few channels over time in the band.

    A sweep lasts longer than the response of the room; then the decay rate of the room gives the spacing.
    """
    samples, fs = recording.samples, recording.sample_rate
    padded = fast_length(SPECTRUM.padding * samples)
    first, last = int(np.ceil(band[0] * padded / fs)), int(np.floor(band[1] * padded / fs))
    bins = np.arange(first, max(last, first + 1) + 1)
    taper = np.hanning(len(bins) + 2)[1:-1]  # so that the direct sound does not spread over the times after it
    interval = padded / fs / len(bins)
    times = interval * np.arange(int(recording.duration / interval))
    channels = _measured_channels(recording)
    weight, energy = np.exp(-s / fs * np.arange(samples)), np.zeros(len(times))
    for row in read_samples(recording, 0, samples, channels):
        spectrum = taper * rfft(row * weight, padded)[bins]
        energy += np.abs(np.fft.ifft(spectrum)[: len(times)]) ** 2 / len(channels)
    level = 0.0 if noise is None else np.mean(taper**2 * noise(bins * fs / padded)) * interval * fs
    silence = level * np.exp(-2 * s * times)
    e = np.maximum(energy - silence, 0.0)
    step = decorrelation = 1 / max(interval * len(energy), 1e-9)
    if e.max(initial=0.0) > 0:  # e, v, 1 / T and 1 / T_eq of `fdcal.recordings.frequencies`
        v = np.maximum(silence, ROWS.unexplained * np.sum(e**2) / np.sum(e))
        step, decorrelation = 1 / (interval * np.sum(e / (e + v))), np.sum(e**2) / np.sum(e) ** 2 / interval
    # the spacing of a response that decays evenly at `rate + s`
    step = max(float(step), 2 * (rate + s) / float(np.log(2 / ROWS.unexplained)), 1 / recording.duration)
    return Spacing(step, max(float(decorrelation), rate + s))


class WrapsRound(InputError):
    """Error: an impulse response wraps round, so that its beginning stands at its end."""


def require_quiet_end(recording: Recording, band: Band) -> None:
    """Raise WrapsRound if the sound rises again before the end, as an impulse response that wraps round does.

    Such a response rises at all frequencies. The rumble of a building rises at the lowest frequencies alone: it has
    most of the noise power within a few Hz, and so few degrees of freedom that its level varies by 10 dB from one
    segment to the next. Therefore the level must also rise at higher frequencies, each compared with its own noise.
    """
    level = segment_levels(recording, band)
    top, last = int(np.argmax(level)), len(level) - 2
    end, lowest = float(level[last:].mean()), float(level[min(top, last) :].min())
    if top >= last:  # the direct sound stands at the end, and what follows it at the beginning
        end, lowest = float(level[0]), float(level.min())
    rises = end > max(RISE * lowest, DECAY.min_power * level.max())
    if rises and top < last:
        reduced, fs = _reduced(recording, band)
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
        floor = 1e-12 * max(power.max(), 1e-300)
        quiet = np.percentile(power, 25, axis=0)
        even = np.exp(np.mean(np.log(np.maximum(power, floor) / np.maximum(quiet, floor)), axis=1))
        count = len(even) // DECAY.segments
        rises = bool(even[-2 * count :].max() > RISE * even[min(top * count, len(even) - 2) :].min())
    if rises:
        rise = f"{10 * np.log10(end / max(lowest, 1e-300)):.0f} dB before the end of {recording.duration:.3g} s"
        problem = f"{recording.path}: the sound decays and rises again by {rise}: the response wraps round, as it does"
        problem += " after a circular deconvolution, or another sound begins"
        raise WrapsRound(problem, "move that part to the beginning (numpy.roll), or cut it off", key="kind")


def mean_power(recording: Recording, band: Band, s: float, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies (B,), Hz, and the mean power (B,) of the weighted channels at each of them.

    The frequencies are at most `step` Hz apart.
    """
    samples, fs = recording.samples, recording.sample_rate
    padded = fast_length(int(max(SPECTRUM.padding * samples, fs / step)))
    first, last = int(np.ceil(band[0] * padded / fs)), int(np.floor(band[1] * padded / fs))
    if last - first < 2:
        problem = f"{recording.path} lasts {recording.duration:g} s, too short for {band[0]:g} to {band[1]:g} Hz"
        raise InputError(problem, "record longer or widen <frequencies>", key="frequencies")
    weight = np.exp(-s / fs * np.arange(samples))
    power = np.zeros(last - first + 1)
    for _, values in channel_groups(recording):
        for row in values:
            power += np.abs(rfft(row * weight, padded)[first : last + 1]) ** 2
    return np.arange(first, last + 1) * fs / padded, power / recording.count


def smoothed(grid: np.ndarray, density: np.ndarray, width: int = 5) -> Noise:
    """Return the moving average over `width` values of a density (G,) at `grid` (G,) Hz, as a function of frequency."""
    mean = np.convolve(np.pad(density, width // 2, mode="edge"), np.full(width, 1 / width), mode="valid")
    return lambda frequencies: np.interp(frequencies, grid, mean)


@dataclass(frozen=True)
class DeconvolutionSettings:
    """Settings of the division of a recording by the signal of its source."""

    # lead, length: time before the sound in a response, and length of the whole response, seconds
    lead: float = 0.25
    length: float = 2.25
    max_samples: int = 16_000_000  # largest number of samples of a channel, 5 min at 48 kHz; the rest is not used
    regularisation: float = 1e-3  # relative to the greatest power of the reference
    # widening, max_widening: factor by which the band is widened at both ends, and the largest widening, Hz, of its
    # upper end, above which a sweep may have no power
    widening: float = 1.5
    max_widening: float = 50.0
    # least fraction of the recording outside the response from which the noise is estimated
    min_outside: float = 0.25
    smoothing: int = 31  # neighbouring frequencies over which the noise is averaged


DECONVOLUTION = DeconvolutionSettings()


def deconvolve(recording: Recording, reference: Recording, band: Band) -> tuple[Recording, Noise | None]:
    """Return the impulse responses of all channels, in memory, and the power of their noise.

    `reference`: one channel with the signal that the source emitted. The power is that of the noise's transform per
    time sample; it is None if the recording is too short to estimate it.
    """
    if reference.sample_rate != recording.sample_rate:
        problem = f"{reference.path} has {reference.sample_rate:g} Hz and {recording.path} {recording.sample_rate:g} Hz"
        raise InputError(problem, "convert one of them to the sampling rate of the other", key="reference")
    if reference.count != 1:
        problem = f"{reference.path} has {reference.count} channels"
        raise InputError(problem, "give a reference signal of one channel", key="reference")
    fs, samples = recording.sample_rate, min(recording.samples, DECONVOLUTION.max_samples)
    emitted = min(reference.samples, samples)
    padded = fast_length(samples + emitted)
    f = np.arange(padded // 2 + 1) * fs / padded
    inverse = _inverse(rfft(read_samples(reference, 0, emitted)[0], padded), f, band)
    if inverse is None:
        problem = f"{reference.path} is silent between {band[0]:g} and {band[1]:g} Hz"
        raise InputError(problem, "choose another band: <frequencies>", key="frequencies")
    lead, length = int(DECONVOLUTION.lead * fs), min(int(DECONVOLUTION.length * fs), padded)
    responses, outside = np.empty((recording.count, length)), np.zeros(padded // 2 + 1)
    for channels, values in channel_groups(recording):
        for n, row in zip(channels, values, strict=True):
            whole = np.roll(irfft(rfft(row[:samples], padded) * inverse, padded), lead)
            responses[n] = whole[:length]
            outside += np.abs(rfft(whole[length:], padded)) ** 2
    made = recording_of(recording.path, "impulse", fs, responses, names=recording.names)
    made = replace(made, positions=recording.positions, sound_speed=recording.sound_speed)
    if samples - length < DECONVOLUTION.min_outside * samples:
        return made, None
    return made, smoothed(f, outside / recording.count / (samples - length), DECONVOLUTION.smoothing)


def _inverse(S: np.ndarray, f: np.ndarray, band: Band) -> np.ndarray | None:
    """Return conj(S) / |S|^2 within the band, falling smoothly to zero outside; None if S is silent in the band."""
    low = band[0] / DECONVOLUTION.widening
    high = min(band[1] * DECONVOLUTION.widening, band[1] + DECONVOLUTION.max_widening)
    rise, fall = np.clip((f - low) / (band[0] - low), 0, 1), np.clip((high - f) / (high - band[1]), 0, 1)
    taper = np.sin(np.pi / 2 * np.minimum(rise, fall)) ** 2
    power = np.abs(S) ** 2
    inside = taper > 0
    if not np.any(inside) or not power[inside].max() > 1e-20 * max(power.max(), 1e-300):
        return None
    inverse, floor = np.zeros_like(S), DECONVOLUTION.regularisation * power[inside].max()
    inverse[inside] = taper[inside] * S[inside].conj() / (power[inside] + floor)
    return inverse
