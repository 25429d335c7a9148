"""Short windows of a recording, for the covariance of `fdcal.cost.short_windows`.

Of a stationary sound windows are taken all over the recording, of an impulse response from what follows the direct
sound by SKIP until the sound is lost in noise. A window whose sound is in a gap of speech or music does not count.
"""

import numpy as np

from ..model.measurement import Measurement
from ..model.problem import ShortWindows
from .recording import IMPORT_LIMITS, ImportOptions, Recording, read_samples, refused_option

WINDOW = 0.03  # seconds
MAX_COUNT = 32  # microphones: the time of a fit grows with their cube
MAX_FLAT = 12  # microphones of which it is found out whether they are flat
SKIP = 0.02  # seconds after the direct sound
MAX_WINDOWS = 400  # of all takes together
MAX_GROUPS = 120  # of all takes together
MIN_WINDOWS = 30
SPACING = 1.5  # of the frequencies, over that of independent ones, 1 / WINDOW
LOWEST, HIGHEST = 100.0, 4000.0  # Hz, unless another band is asked for
OCTAVE = 2.0  # least ratio of the ends of the band
QUIET = 1e-3  # of the mean power at a frequency; a window with less is in a gap
ONSET = 0.3  # of the peak, where the direct sound begins
OVER_NOISE = 4.0  # power over that of the end of the recording, where an impulse response ends
SHORTEST = 0.2  # seconds after the onset that count in any case


def short_windows(
    recording: Recording, kind: str, options: ImportOptions, takes: int = 1, number: int = 0
) -> ShortWindows | None:
    """Return the windows of a take; None where none are wanted, or it cannot have any.

    That is a plate, more than MAX_COUNT channels, and a recording that is too short or holds low frequencies alone.

    kind : one of `fdcal.recordings.recording.KINDS`; takes, number : how many takes there are, and which one this is:
    each has frequencies of its own. Raises InputError for a band that the recording cannot hold.
    """
    if options.dimension != 3 or options.windows == "none" or recording.count > MAX_COUNT:
        return None
    band = _band(recording, options)
    if options.windows == "auto" and band[1] < OCTAVE * band[0]:  # the recording holds lower frequencies
        return None
    fs, n = recording.sample_rate, int(WINDOW * recording.sample_rate)
    first, last = (0, recording.samples - n) if kind == "stationary" else _decay(recording, n)
    if last <= first:
        return None
    spacing = max(SPACING / WINDOW, (band[1] - band[0]) / max(1, MAX_GROUPS // takes))
    f = np.arange(band[0] + spacing * number / takes, band[1], spacing)
    transform = np.exp(-2j * np.pi * np.outer(np.arange(n), f) / fs) * np.hanning(n)[:, None]
    count = int(min(max(MIN_WINDOWS, MAX_WINDOWS // takes), (last - first) / (n / 2) + 1))
    p = np.empty((len(f), count, recording.count), np.complex64)
    for window, start in enumerate(np.linspace(first, last, count).astype(int)):
        p[:, window] = (read_samples(recording, int(start), int(start) + n) @ transform).T
    power = np.mean(np.abs(p) ** 2, axis=2)
    p /= np.sqrt(np.maximum(power, np.finfo(np.float32).tiny))[..., None]
    p[power <= QUIET * power.mean(axis=1, keepdims=True)] = 0
    return ShortWindows(f, np.zeros(len(f), np.int64), p, WINDOW)


def found_flat(measurement: Measurement) -> bool:
    """Return whether the windows show a flat array (`fdcal.solvers.robust.windows.is_flat`).

    Only of few microphones of which no position is reported: more of them determine their heights by themselves, and
    the time of a fit grows with the cube of their number.
    """
    windows, unknown = measurement.windows, measurement.positions is None and not len(measurement.known)
    if windows is None or not unknown or measurement.array_dimension != 3 or measurement.count > MAX_FLAT:
        return False
    from ..solvers.robust.windows import is_flat  # loads the solver, which other imports do not need

    return is_flat(windows, measurement.sound_speed)


def _band(recording: Recording, options: ImportOptions) -> tuple[float, float]:
    """Return the lowest and the highest frequency of short windows, Hz."""
    top = IMPORT_LIMITS.max_frequency * recording.sample_rate
    if options.windows == "auto":
        return LOWEST, min(HIGHEST, top)
    try:
        low, high = (float(part) for part in options.windows.split(":"))
    except ValueError:
        problem = f'windows = "{options.windows}" is not a band'
        raise refused_option(options, "windows", problem, "write auto, none or LO:HI, as 100:4000") from None
    if not 0 < low < high <= top:
        problem = f"windows = {low:g}:{high:g} is not a band that {recording.path} can hold"
        raise refused_option(options, "windows", problem, f"use 0 < LO < HI <= {top:g} Hz")
    return low, high


def _decay(recording: Recording, n: int) -> tuple[int, int]:
    """First samples of the first and the last window of an impulse response."""
    fs = recording.sample_rate
    x = read_samples(recording, 0, recording.samples)
    peak = np.abs(x).max(axis=1, keepdims=True)
    onset = int(np.median(np.argmax(np.abs(x) > ONSET * peak, axis=1)))
    energy = np.convolve(np.sum(x**2, axis=0), np.ones(n), "same")
    floor = np.median(energy[-max(1, len(energy) // 10) :])
    end = onset + int(np.argmax(np.append(energy[onset:] < OVER_NOISE * floor, True)))
    return onset + int(SKIP * fs), min(recording.samples, max(end, onset + int(SHORTEST * fs))) - n
