"""Short windows of a recording, for the covariance of `fdcal.cost.short_windows`.

The windows of a stationary sound lie at even distances in the whole recording. Those of an impulse response begin SKIP
after the direct sound and end where the sound falls below the noise. A window in a pause of speech or music is set to
zero.
"""

import numpy as np

from ..acoustics.coherence import squared_coherence
from ..model.measurement import Measurement
from ..model.problem import MAX_COUNT, ShortWindows
from .frequencies import given_band
from .recording import IMPORT_LIMITS, ImportOptions, Recording, read_samples

WINDOW = 0.03  # seconds, length of a window
# Largest number of microphones of an array that is tested for being flat by its windows alone; more determine their
# heights by themselves. At most TESTED of them are tested.
MAX_FLAT, TESTED = 12, 16
SKIP = 0.02  # seconds from the direct sound of an impulse response to its first window
MAX_WINDOWS = 400  # largest number of windows of all takes together
# Largest number of groups of all takes together, and number of microphones above which it is lower, because the time
# for a group grows with the square of their number
MAX_GROUPS, MANY = 120, 32
MIN_WINDOWS = 30  # smallest number of windows of a take, unless it is too short for so many
SPACING = 1.5  # spacing of the frequencies relative to that of independent ones, 1 / WINDOW
LOWEST, HIGHEST = 100.0, 4000.0  # Hz, default band
OCTAVE = 2.0  # least ratio of the upper to the lower end of the default band
QUIET = 1e-3  # ratio of the power to the mean power at a frequency, below which a window is in a pause
# Least level of a frequency, relative to the highest level (-50 dB), and least squared coherence of a microphone with
# another one, beyond that of independent noise. Frequencies below these limits are not used. This decreases the errors
# of a spiral of 64 microphones whose recordings end at 2 and 0.9 kHz from 7.9 to 6.5 and from 5.6 to 4.6 mm.
STOPBAND, COHERENT = 1e-5, 0.03
# Largest difference between the frequency of a window and the mean frequency of the sound in it, Hz, if this is lower,
# in the upper half of the band. Rooms cause differences up to 9. In a chamber with sound up to 900 Hz they are 15 to 50
# at the end of the band. If these frequencies are used, a spiral of 64 microphones is found 0.7 % too small, and is 3.3
# and 3.7 mm off instead of 2.3 and 2.7.
OFF = 12.0
ONSET = 0.3  # fraction of the peak at which the direct sound begins
OVER_NOISE = 4.0  # ratio of the power to that at the end of the recording, below which an impulse response has ended
SHORTEST = 0.2  # seconds after the onset that are always used


def short_windows(
    recording: Recording, kind: str, options: ImportOptions, takes: int = 1, number: int = 0, axes: int = 3
) -> ShortWindows | None:
    """Return the windows of a take; None if the options exclude them or the take is not suitable.

    A take is not suitable if its sound field is two-dimensional, if it has more than MAX_COUNT channels, is too short,
    or has low frequencies only. Raises InputError for a band that the recording cannot contain.

    `kind`: one of `fdcal.recordings.recording.KINDS`; `takes`: number of takes; `number`: number of this take, from 0,
    because each take uses other frequencies; `axes`: number of coordinates of a microphone.
    """
    largest = MAX_COUNT[2 if options.array_dimension is None else axes]
    if options.dimension != 3 or options.windows == "none" or recording.count > largest:
        return None
    automatic = options.windows == "auto"
    band = LOWEST, min(HIGHEST, IMPORT_LIMITS.max_frequency * recording.sample_rate)
    if not automatic:
        band = given_band(recording, "windows", options.windows)
    n = int(WINDOW * recording.sample_rate)
    first, last = (0, recording.samples - n) if kind == "stationary" else _decay(recording, n)
    if last <= first:
        return None
    count = int(min(max(MIN_WINDOWS, MAX_WINDOWS // takes), (last - first) / (n / 2) + 1))
    starts = np.linspace(first, last, count).astype(int)
    groups = int(MAX_GROUPS * min(1.0, (MANY / recording.count) ** 2))
    while True:
        if automatic and band[1] < OCTAVE * band[0]:
            return None
        spacing = max(SPACING / WINDOW, (band[1] - band[0]) / max(1, groups // takes))
        f = np.arange(band[0] + spacing * number / takes, band[1], spacing)
        p = _spectra(recording, starts, np.hanning(n), f)
        kept = _with_sound(p) if automatic else np.ones(len(f), bool)
        f, p = f[kept], p[kept]
        if not len(f):
            return None
        if f[-1] + 2 * spacing >= band[1]:
            break
        band = band[0], float(f[-1]) + spacing  # the sound ends earlier: begin again, with frequencies closer together
    slope = _spectra(recording, starts, np.gradient(np.hanning(n)), f) * recording.sample_rate
    power = np.maximum(np.mean(np.abs(p) ** 2, axis=2), np.finfo(np.float32).tiny)
    loud = power > QUIET * power.mean(axis=1, keepdims=True)
    # f minus the mean frequency of the sound in a window (Auger and Flandrin, "Improving the readability of
    # time-frequency and time-scale representations by the reassignment method", IEEE Trans. Signal Process. 43, 1995)
    off = np.mean(np.mean((slope * np.conj(p)).imag, axis=2) / power, axis=1, where=loud) / (2 * np.pi)
    p *= (loud / np.sqrt(power))[..., None]
    kept = (off < OFF) | (f < f[-1] / 2) | (not automatic)
    return ShortWindows(f[kept], np.zeros(np.sum(kept), np.int64), p[kept], WINDOW) if np.any(kept) else None


def _spectra(recording: Recording, starts: np.ndarray, window: np.ndarray, frequencies: np.ndarray) -> np.ndarray:
    """Return the spectra (F, W, N) complex64 with a `window` (n,) that begins at each of the samples `starts` (W,)."""
    turns = np.outer(np.arange(len(window)), frequencies) / recording.sample_rate
    transform = np.exp(-2j * np.pi * turns) * window[:, None]
    p = np.empty((len(frequencies), len(starts), recording.count), np.complex64)
    for number, start in enumerate(starts):
        p[:, number] = (read_samples(recording, int(start), int(start) + len(window)) @ transform).T
    return p


def _with_sound(p: np.ndarray) -> np.ndarray:
    """Return which frequencies of the spectra (F, W, N) hold sound : (F,) bool.

    A band can end below the sampling rate's limit: the source has no more, or the recording was resampled. Beyond its
    end there is noise without coherence, or the mirrored spectrum that a filter leaves at a low level.
    """
    level, (windows, count) = np.mean(np.abs(p) ** 2, axis=(1, 2)), p.shape[1:]
    nearest = np.median(squared_coherence(p).max(axis=2), axis=1) - (1 + np.log(count)) / windows
    return (level > STOPBAND * level.max()) & (nearest > COHERENT)


def found_flat(measurement: Measurement) -> bool:
    """Return whether the windows show a flat array (`fdcal.solvers.robust.windows.is_flat`).

    Only arrays without any reported position are tested. One of more than MAX_FLAT microphones counts as flat only if
    it would be refused in space: with heights that are nearly equal it is found more accurately than with equal ones.
    """
    windows, N = measurement.windows, measurement.count
    unknown = measurement.positions is None and not len(measurement.known)
    if windows is None or not unknown or measurement.array_dimension != 3:
        return False
    # Imported here: they load the solver, which most takes do not need.
    from ..solvers.requirements import seem_in_line
    from ..solvers.robust.windows import is_flat

    possible = N <= MAX_FLAT or seem_in_line(measurement.problem(), len(measurement.frequencies))
    tested = np.linspace(0, N - 1, min(N, TESTED)).astype(int)
    return possible and is_flat(windows.of_microphones(tested), measurement.sound_speed)


def _decay(recording: Recording, n: int) -> tuple[int, int]:
    """Return the first samples of the first and of the last window of an impulse response."""
    fs = recording.sample_rate
    x = read_samples(recording, 0, recording.samples)
    onset = int(np.median(np.argmax(np.abs(x) > ONSET * np.abs(x).max(axis=1, keepdims=True), axis=1)))
    energy = np.convolve(np.sum(x**2, axis=0), np.ones(n), "same")
    floor = np.median(energy[-max(1, len(energy) // 10) :])
    end = onset + int(np.argmax(np.append(energy[onset:] < OVER_NOISE * floor, True)))
    return onset + int(SKIP * fs), min(recording.samples, max(end, onset + int(SHORTEST * fs))) - n
