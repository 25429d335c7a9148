"""Which frequencies of a recording to use: evenly over a band, as closely spaced as is useful.

The method does not need eigenfrequencies. Any frequency can be used, as long as no source inside the array emits it.
Frequencies are chosen without regard to the level. At a peak of the level the pressure is at a maximum where the array
stands, so that its gradient is small. If an array much smaller than the wavelength is calibrated with peaks alone, the
result has 0.5 to 0.8 of its size. Two frequencies that are close carry the same information. With e(t) the energy of
the response at time t, and v its noise or the part that no model of the field explains, whichever is larger,

    T_eq = (sum e)^2 / sum e^2     the pressure decorrelates over a bandwidth of 1 / T_eq
    T    = sum e / (e + v)         the time during which the response exceeds v

Samples at a spacing of 1 / T hold all information in the band, as for any response of length T. The late part of a
response is weak, so T is about 5 T_eq where a room decays evenly, and more where the direct sound is strong.
"""

from dataclasses import dataclass

import numpy as np

from ..acoustics.coherence import array_radius
from ..acoustics.dictionary import f_max
from ..acoustics.spectrum import fast_length, rfft
from ..model.validation import InputError
from .recording import IMPORT_LIMITS, Band, ImportOptions, Recording, channel_groups, number_in

MIN_SNR = 10.0  # decibels, least signal-to-noise ratio of a frequency that is used
DYNAMIC_RANGE = 60.0  # decibels from the strongest frequency down to the assumed floor, above which MIN_SNR is required


@dataclass(frozen=True)
class RowLimits:
    """Limits of the number of rows and of their spacing."""

    # max_rows: default number of rows of all takes with `usual_count` microphones: about 5 s of processor time.
    # The time for a row grows with the square of the number of microphones
    max_rows: int = 400
    usual_count: int = 32
    # min_of_array, max_of_array, min_of_take: bounds of that default, for an array and for each take
    min_of_array: int = 112
    max_of_array: int = 800
    min_of_take: int = 20
    unexplained: float = 1e-4  # power, relative to the response, that no model of the field explains


ROWS = RowLimits()


def default_max_rows(microphones: int, takes: int = 1) -> int:
    """Return the default largest number of rows of each take.

    This number only bounds the computing time. It is divided by the number of takes, because rows of another take carry
    more information than rows that are closer in frequency.
    """
    affordable = int(ROWS.max_rows * (ROWS.usual_count / microphones) ** 2)
    return max(ROWS.min_of_take, min(max(ROWS.min_of_array, affordable), ROWS.max_of_array) // takes)


@dataclass(frozen=True)
class Spacing:
    """Useful spacing of the frequencies of a recording, Hz."""

    step: float  # useful distance of two frequencies; chosen ones are at least 3/4 of it apart
    # bandwidth over which the pressures decorrelate, 1 / T_eq; frequencies that are closer are not independent
    decorrelation: float


@dataclass(frozen=True)
class Pressures:
    """Pressures taken from a recording, whatever its kind."""

    frequencies: np.ndarray  # (M,) float64, Hz, ascending
    wavenumbers: np.ndarray  # (M,) complex128 rad/m.
    pressures: np.ndarray  # (M, N) complex128
    # (M,) float64 or None, in the unit of abs(pressures)**2; None where it cannot be estimated
    noise_power: np.ndarray | None
    how: str  # the method, in words
    spacing: Spacing  # useful spacing of the frequencies


class NothingAboveNoise(InputError):
    """A recording without any frequency at which the sound rises above the noise."""


def choose_frequencies(
    frequencies: np.ndarray, power: np.ndarray, noise: np.ndarray, resolution: float, max_rows: int = ROWS.max_rows
) -> np.ndarray:
    """Return the indices of the frequencies to use: the one nearest to the middle of each of equal parts of the band.

    `frequencies` (B,), Hz, are evenly spaced, more closely than `resolution`; chosen ones are at least 3/4 of it
    apart. `power` and `noise` (B,) are means over the microphones; the noise is 0 where it is unknown. Raises
    NothingAboveNoise.
    """
    floor = np.maximum(noise, power.max() * 10 ** (-DYNAMIC_RANGE / 10))
    usable = 10 * np.log10(np.maximum(power - noise, 1e-300) / floor) >= MIN_SNR
    if not np.any(usable):
        band = f"between {frequencies[0]:g} and {frequencies[-1]:g} Hz"
        remedy = "record at a higher level, or choose another band: <frequencies> LO:HI"
        raise NothingAboveNoise(f"no frequency {band} is {MIN_SNR:g} dB above the noise", remedy, key="frequencies")
    at = np.flatnonzero(usable)
    return at[spread_over_band(frequencies[at], (frequencies[0], frequencies[-1]), max_rows, resolution)]


def spread_over_band(frequencies: np.ndarray, band: Band, max_rows: int, apart: float) -> np.ndarray:
    """Return the indices of the frequencies nearest to the middles of equal parts of a band, `max_rows` at most.

    `frequencies` ascend. `apart`: least width of a part, Hz; chosen frequencies are at least 3/4 of it apart.
    """
    count = max(1, min(max_rows, int((band[1] - band[0]) / apart * (1 + 1e-9)) + 1))
    width = (band[1] - band[0]) / max(1, count - 1)
    part = np.round((frequencies - band[0]) / width).astype(int) if count > 1 else np.zeros(len(frequencies), int)
    order = np.lexsort((np.abs(frequencies - band[0] - part * width), part))
    firsts = order[np.unique(part[order], return_index=True)[1]]
    kept = []
    for n in firsts.tolist():
        if not kept or frequencies[n] - frequencies[kept[-1]] >= 0.75 * apart:  # the grid does not contain the middles
            kept.append(n)
    return np.array(kept, np.int64)


# Frequencies at which the coherence of a recording is computed
COHERENCE_COUNT = 300  # number of frequencies, in equal ratios
COHERENCE_RANGE = 40.0  # decibels below the strongest frequency, down to which frequencies are used
COHERENCE_SAMPLES = 2**27  # largest number of samples, all channels together, for which the coherence is computed


@dataclass(frozen=True)
class FrequencyLimit:
    """The highest frequency that an array can interpolate."""

    limit: float | None  # Hz; None if the radius is unknown
    radius: float  # radius of the array, from which the limit follows, metres; 0 if it is unknown
    words: str  # the radius and its origin, arguments in angle brackets
    estimated: bool = False  # whether the radius is estimated from the coherence


def frequency_limit(
    recording: Recording, options: ImportOptions, known_positions: np.ndarray | None, speed: float
) -> FrequencyLimit:
    """Return the highest frequency that the array can interpolate (Eq. 9).

    The radius is the given one, or that of the positions in the file or of the known microphones, or an estimate from
    the coherence of the channels.
    """
    complete, estimated = recording.positions is not None, False
    radius, words = options.array_radius or 0.0, f"{options.array_radius or 0:.2g} m, as given"
    if options.array_radius is None:
        positions, factor = recording.positions if complete else known_positions, IMPORT_LIMITS.known_radius_factor
        if positions is not None:
            radius = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
            radius *= 1.0 if complete else factor
        other = f"{100 * (factor - 1):.0f} % more than that of the known microphones"
        words = f"{radius:.2g} m, {'that of the positions in the file' if complete else other}"
    if options.array_radius is None and not complete:  # known microphones may be a part of the array
        seen = _coherent_radius(recording, options.dimension, speed) or 0.0
        estimated = seen > IMPORT_LIMITS.coherent_radius_factor * radius or radius <= 0
        radius = (seen if radius > 0 else IMPORT_LIMITS.coherent_radius_factor * seen) if estimated else radius
    if estimated:
        words = (
            f"at most {radius:.2g} m by the coherence of the channels, which limits the band; <array_radius> sets it"
        )
    if radius <= 0:
        return FrequencyLimit(None, 0.0, "unknown; <array_radius> sets it")
    planar = coordinate_count(recording, options, known_positions) == 2
    return FrequencyLimit(f_max(recording.count, radius, speed, options.dimension, planar), radius, words, estimated)


def _coherent_radius(recording: Recording, dimension: int, speed: float) -> float | None:
    """Estimate the radius of the array from the coherence of the channels, metres; None if that is not possible."""
    top = IMPORT_LIMITS.max_frequency * recording.sample_rate
    low = max(IMPORT_LIMITS.low, IMPORT_LIMITS.min_periods / recording.duration)
    if low >= top or recording.count * recording.samples > COHERENCE_SAMPLES:
        return None
    padded = fast_length(recording.samples)
    bins = np.unique(np.round(np.geomspace(low, top, COHERENCE_COUNT) * padded / recording.sample_rate).astype(int))
    bins = bins[bins <= padded // 2]
    rows = [rfft(samples.astype(np.float32), padded)[:, bins] for _, samples in channel_groups(recording)]
    spectra = np.concatenate(rows).T
    power = np.mean(np.abs(spectra) ** 2, axis=1)
    loud = power >= power.max() * 10 ** (-COHERENCE_RANGE / 10)
    wavenumbers = 2 * np.pi * bins * recording.sample_rate / padded / speed
    return array_radius(spectra[loud], wavenumbers[loud], dimension)


def coordinate_count(recording: Recording, options: ImportOptions, known_positions: np.ndarray | None) -> int:
    """Return the number of coordinates of a microphone."""
    positions = known_positions if recording.positions is None else recording.positions
    return (options.array_dimension or options.dimension) if positions is None else positions.shape[1]


def given_band(recording: Recording, key: str, text: str) -> Band:
    """Return the band of an option `key`, LO:HI in Hz; raise InputError for one that the recording cannot hold."""
    (low, high), top = map(number_in, text.partition(":")[::2]), IMPORT_LIMITS.max_frequency * recording.sample_rate
    if not 0 < low < high <= top:
        problem = f'{key} = "{text}" is not a band that {recording.path} can hold'
        raise InputError(problem, f"write auto or LO:HI, for example 100:300, up to {top:g} Hz", key=key)
    return low, high


def frequency_band(recording: Recording, options: ImportOptions, found: FrequencyLimit, speed: float) -> Band:
    """Return the given or the default band, Hz; raise InputError for one that the recording cannot hold."""
    top = IMPORT_LIMITS.max_frequency * recording.sample_rate
    if options.frequencies == "auto":
        low, high = IMPORT_LIMITS.low, IMPORT_LIMITS.high
        if found.limit is not None:  # for small arrays both ends are proportional to 1 / R
            # The gradient of a pressure is about k times the pressure. At k R = 0.13 a difference of 0.1 dB between two
            # channels is therefore equivalent to a shift by a tenth of the radius, and at lower frequencies to a larger
            # shift. The high-passes of two channels differ by as much at low frequencies, while the likelihood has one
            # gain for all frequencies.
            radian = 2 * np.pi * found.radius
            low = max(low, IMPORT_LIMITS.min_phase * speed / radian)
            wide = max(high, IMPORT_LIMITS.phase * speed / radian)
            high = found.limit if options.array_radius is not None else min(found.limit, wide)
        low, high = max(low, recording.lowest, IMPORT_LIMITS.min_periods / recording.duration), min(high, top)
    else:
        low, high = given_band(recording, "frequencies", options.frequencies)
    if found.limit is not None and found.limit <= low and not found.estimated:
        problem = f"{recording.path}: {recording.count} microphones in a radius of {found.radius:.3g} m interpolate"
        what = "positions" if options.array_radius is None else "<array_radius>"
        remedy = f"give {what} in metres, not in centimetres, millimetres or degrees"
        problem += f" up to {found.limit:.3g} Hz only, but the band begins at {low:g} Hz"
        raise InputError(problem, remedy, key="frequencies")
    if options.frequencies == "auto" and found.estimated and high <= low:
        problem = f"{recording.path}: its channels are coherent up to {high:.3g} Hz; the band begins at {low:.3g} Hz"
        remedy = "check that all channels record the same sound together, or give <array_radius> or <frequencies>"
        raise InputError(problem, remedy, key="frequencies")
    if not low < high:
        problem = f"{recording.path}: the lowest frequency of the default band, {low:.3g} Hz, is above the highest one,"
        problem += f" {high:.3g} Hz, for its length of {recording.duration:.3g} s and this radius of the array"
        raise InputError(problem, "record longer, or give <frequencies>", key="frequencies")
    return low, high
