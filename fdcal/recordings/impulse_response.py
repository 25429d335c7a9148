"""Pressures from an impulse response, a clap or a whole sweep, recorded from silence to the end of the sound.

The transform of such a recording is a solution of the Helmholtz equation at each frequency, whatever the source
emitted, if the sound has decayed before the recording ends, or else has been weighted with exp(-s t) (see
`fdcal.acoustics.spectrum`). The weight is no stronger than needed: it adds what the room has not decayed by itself (see
`fdcal.recordings.reverberation`).

    d    rate at which the sound decays, nepers per second
    s    rate of the exponential window; (d + s) T = 12 nepers

Where the signal S that the source emitted is given, `deconvolve` divides the recording X by it. X / S, regularised
where S is weak, is the transform of the response, apart from a factor at each frequency that is the same for all
channels and does no harm. The response starts `lead` seconds late, so that the ringing of the band-limited spectrum,
which comes before the sound as well as after it, lies inside. 1 / S spreads the noise of the recording over as long a
time as was recorded, at each frequency another time where S is a sweep. So the noise inside the response is estimated
from what lies outside of it, and not from its end alone.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..acoustics.spectrum import SPECTRUM, fast_length, irfft, laplace_transform, rfft, wavenumber_continuous
from ..model.validation import InputError
from .frequencies import ROWS, Pressures, Spacing, choose_frequencies, spacing_of, spacing_of_decay
from .recording import Recording, channel_groups, read_samples, recording_of
from .reverberation import DECAY, Decay, estimate_decay, extend_to_last_mode, segment_levels, whitened_levels

RISE = 10.0  # factor of power by which the level may differ in what is noise
GRID = 6  # points of the spectrum per least distance of two frequencies
MAX_SAMPLES = 20_000_000  # of an impulse response: longer recordings are of a stationary source


def impulse_response_pressures(
    recording: Recording,
    band: tuple[float, float],
    sound_speed: float,
    window: float | None = None,
    most: int = ROWS.max_rows,
    noise: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Pressures:
    """Return the pressures of an impulse response; what follows once the sound is below the noise is left out.

    `window`: rate s, 1/s; as much as needed unless given; `most`: greatest number of frequencies; `noise`: noise power
    of one sample of the transform, where it is known; else it is estimated from the tail.
    """
    if recording.samples > MAX_SAMPLES:
        problem = f"{recording.path} lasts {recording.duration:.0f} s, which is too long for an impulse response"
        raise InputError(problem, "give <kind> stationary", key="kind")
    if recording.modelled:
        return _complete_pressures(recording, band, sound_speed, most)
    decay = extend_to_last_mode(recording, band, estimate_decay(recording, band), noise)
    s = max(0.0, SPECTRUM.decay / recording.duration - decay.rate) if window is None else window
    noise = noise or noise_of_tail(recording, decay)
    used = recording
    if decay.tail is not None and decay.noisy:
        used = replace(recording, samples=min(recording.samples, int(decay.tail * recording.sample_rate) + 1))
    spacing = _spacing(used, band, s, noise, decay.rate)
    grid, power = mean_power(used, band, s, spacing.step / GRID)
    gain = used.sample_rate * -np.expm1(-2 * s * used.duration) / (2 * s) if s > 0 else used.samples
    density = np.zeros(len(grid)) if noise is None else noise(grid) * gain
    chosen = choose_frequencies(grid, power, density, spacing.step, most)
    f = grid[chosen]
    pressures = np.empty((len(f), used.count), dtype=complex)
    for channels, samples in channel_groups(used):
        pressures[:, channels] = laplace_transform(samples, used.sample_rate, s, f)
    how = f"exponential window of {s:.2g}/s" if s > 0 else "no window: the sound has decayed"
    if used is not recording:
        how += f" after {used.duration:.3g} s, where the rest is left out"
    k = wavenumber_continuous(f, s, sound_speed)
    return Pressures(f, k, pressures, None if noise is None else density[chosen], how, spacing)


def _spacing(
    recording: Recording,
    band: tuple[float, float],
    s: float,
    noise: Callable[[np.ndarray], np.ndarray] | None,
    rate: float,
) -> Spacing:
    """Return how close frequencies are worth taking, from the energy of a few channels over time in the band.

    A sweep lasts longer than the response of the room, whose decay then counts.
    """
    samples, fs = recording.samples, recording.sample_rate
    padded = fast_length(SPECTRUM.padding * samples)
    first, last = int(np.ceil(band[0] * padded / fs)), int(np.floor(band[1] * padded / fs))
    bins = np.arange(first, max(last, first + 1) + 1)
    taper = np.hanning(len(bins) + 2)[1:-1]  # so that the direct sound does not spread over the times after it
    interval = padded / fs / len(bins)
    times = interval * np.arange(int(recording.duration / interval))
    channels = np.unique(np.linspace(0, recording.count - 1, DECAY.channels).astype(int))
    weight, energy = np.exp(-s / fs * np.arange(samples)), np.zeros(len(times))
    for row in read_samples(recording, 0, samples, channels):
        spectrum = taper * rfft(row * weight, padded)[bins]
        energy += np.abs(np.fft.ifft(spectrum)[: len(times)]) ** 2 / len(channels)
    share = 0.0 if noise is None else np.mean(taper**2 * noise(bins * fs / padded)) * interval * fs
    found = spacing_of(energy, share * np.exp(-2 * s * times), interval)
    even = spacing_of_decay(rate + s)
    step = max(found.step, even.step, 1 / recording.duration)
    return replace(found, step=step, decorrelation=max(found.decorrelation, even.decorrelation))


def _complete_pressures(recording: Recording, band: tuple[float, float], sound_speed: float, most: int) -> Pressures:
    """Return the pressures of rendered responses: sums of waves that are complete however they end, without noise.

    All frequencies of the band that are independent of one another are taken, evenly spaced.
    """
    spacing = _spacing(recording, band, 0.0, None, 0.0)
    spacing = replace(spacing, step=1 / recording.duration)
    step = max(spacing.step, (band[1] - band[0]) / most)
    f = np.arange(band[0], band[1], step)
    pressures = laplace_transform(read_samples(recording, 0, recording.samples), recording.sample_rate, 0.0, f)
    how = "rendering at the positions given: no window is needed, and there is no noise but that of the response"
    return Pressures(f, wavenumber_continuous(f, 0.0, sound_speed), pressures, None, how, spacing)


class WrapsRound(InputError):
    """An impulse response whose beginning stands at its end."""


def require_quiet_end(recording: Recording, band: tuple[float, float]) -> None:
    """Check that the sound does not rise again before the end, as a response does that wraps round.

    A response that wraps round rises at all frequencies. The rumble of a building has most of the power of the noise
    in a few Hz, and so few degrees of freedom that its level varies by 10 dB from one segment to the next. So the level
    must also rise above the lowest frequencies, where each of them counts by its own noise.
    """
    level = segment_levels(recording, band)
    top, last = int(np.argmax(level)), len(level) - 2
    end, lowest = float(level[last:].mean()), float(level[min(top, last) :].min())
    if top >= last:  # the direct sound stands at the end, and what follows it at the beginning
        end, lowest = float(level[0]), float(level.min())
    rises = end > max(RISE * lowest, DECAY.min_power * level.max())
    if rises and top < last:
        even = whitened_levels(recording, band)
        count = len(even) // DECAY.segments
        rises = bool(even[-2 * count :].max() > RISE * even[min(top * count, len(even) - 2) :].min())
    if rises:
        rise = f"{10 * np.log10(end / max(lowest, 1e-300)):.0f} dB before the end of {recording.duration:.3g} s"
        problem = f"{recording.path}: the sound has decayed and rises again by {rise}: the response wraps round, as"
        problem += " after a circular deconvolution, or another sound begins"
        raise WrapsRound(problem, "move that part to the beginning (numpy.roll), or cut it off", key="kind")


def mean_power(recording: Recording, band: tuple[float, float], s: float, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies (B,), Hz, and the power (B,) of the weighted recordings there, mean over the microphones.

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


def noise_of_tail(recording: Recording, decay: Decay) -> Callable[[np.ndarray], np.ndarray] | None:
    """Return the noise power of one sample of the transform as a function of frequency; None without a tail."""
    if decay.tail is None:
        return None
    start = int(decay.tail * recording.sample_rate)
    length = recording.samples - start
    channels = np.unique(np.linspace(0, recording.count - 1, 4 * DECAY.channels).astype(int))
    hann = np.hanning(length)
    power = np.zeros(length // 2 + 1)
    for n in channels:
        power += np.abs(rfft(read_samples(recording, start, recording.samples, [n])[0] * hann)) ** 2
    grid = np.arange(len(power)) * recording.sample_rate / length
    return smoothed(grid, power / len(channels) / np.sum(hann**2))


def smoothed(grid: np.ndarray, density: np.ndarray, width: int = 5) -> Callable[[np.ndarray], np.ndarray]:
    """Return the moving average over `width` values of a density (G,) at `grid` (G,) Hz, as a function of frequency."""
    mean = np.convolve(np.pad(density, width // 2, mode="edge"), np.full(width, 1 / width), mode="valid")
    return lambda frequencies: np.interp(frequencies, grid, mean)


@dataclass(frozen=True)
class DeconvolutionSettings:
    """How a recording is divided by the signal of its source."""

    # lead, length: of a response: before the sound, and in all, seconds
    lead: float = 0.25
    length: float = 2.25
    max_samples: int = 16_000_000  # of one channel; what is longer is cut: 5 min at 48 kHz
    regularisation: float = 1e-3  # relative to the greatest power of the reference
    # widening, max_widening: factor by which the band is widened, but by no more than so many Hz at its upper end,
    # where a sweep may end
    widening: float = 1.5
    max_widening: float = 50.0
    min_outside: float = 0.25  # fraction of the recording that must lie outside of the response to estimate the noise
    smoothing: int = 31  # neighbouring frequencies over which the noise is averaged


DECONVOLUTION = DeconvolutionSettings()


def deconvolve(
    recording: Recording, reference: Recording, band: tuple[float, float]
) -> tuple[Recording, Callable[[np.ndarray], np.ndarray] | None]:
    """Return the impulse responses of all channels, in memory, and the noise power of one sample of the transform.

    `reference`: one channel with the signal that the source emitted. The noise of a short recording is None.
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
    lead = int(DECONVOLUTION.lead * fs)
    length = min(int(DECONVOLUTION.length * fs), padded)
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
    density = outside / recording.count / (samples - length)
    return made, smoothed(f, density, DECONVOLUTION.smoothing)


def _inverse(S: np.ndarray, f: np.ndarray, band: tuple[float, float]) -> np.ndarray | None:
    """Return conj(S) / |S|^2 within the band, falling smoothly to zero outside; None if S is silent in the band."""
    low = band[0] / DECONVOLUTION.widening
    high = min(band[1] * DECONVOLUTION.widening, band[1] + DECONVOLUTION.max_widening)
    rise, fall = np.clip((f - low) / (band[0] - low), 0, 1), np.clip((high - f) / (high - band[1]), 0, 1)
    taper = np.sin(np.pi / 2 * np.minimum(rise, fall)) ** 2
    power = np.abs(S) ** 2
    inside = taper > 0
    if not np.any(inside) or not power[inside].max() > 1e-20 * max(power.max(), 1e-300):
        return None
    inverse, least = np.zeros_like(S), DECONVOLUTION.regularisation * power[inside].max()
    inverse[inside] = taper[inside] * S[inside].conj() / (power[inside] + least)
    return inverse
