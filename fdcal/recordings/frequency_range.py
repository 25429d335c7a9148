"""Which frequencies of a recording to choose from.

highest_frequency   the highest frequency that the array can interpolate (Eq. 9), for the radius that is given, or that
                    of the positions in the file, of the known microphones, or of the coherence between the channels
frequency_band      the band from which frequencies are chosen
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..acoustics.coherence import array_radius
from ..acoustics.dictionary import f_max
from ..acoustics.spectrum import fast_length
from ..model.declared import require_positive
from ..model.validation import InputError
from .import_options import LIMITS, ImportOptions
from .recording import Recording, channel_groups


@dataclass(frozen=True)
class CoherenceSettings:
    """At which frequencies the coherence of a recording is looked at."""

    count: int = 300  # frequencies, in equal ratios
    dynamic_range: float = 40.0  # decibels below the strongest frequency
    samples: int = 2**27  # samples of all channels; a longer recording is not looked at


SETTINGS = CoherenceSettings()


@dataclass(frozen=True)
class FrequencyLimit:
    """The highest frequency that an array can interpolate."""

    limit: float | None  # hz; None where the radius is unknown
    radius: float  # metres; 0 where it is unknown
    words: str  # which radius it follows from, arguments in angle brackets
    estimated: bool = False  # whether the radius is that of the coherence


def highest_frequency(
    recording: Recording, options: ImportOptions, known_positions: np.ndarray | None, speed: float
) -> FrequencyLimit:
    """Return the highest frequency that the array can interpolate (Eq. 9), and which radius it follows from.

    `known_positions` (A, D) float64 or None, of the known microphones, metres; `speed`: sound speed, m/s.
    """
    radius, words = _stated_radius(recording, options, known_positions)
    estimated = False
    if options.array_radius is None and recording.positions is None:  # known microphones may be a part of the array
        seen = _coherent_radius(recording, options.dimension, speed) or 0.0
        estimated = seen > LIMITS.coherent_radius_factor * radius or radius <= 0
        radius = (seen if radius > 0 else LIMITS.coherent_radius_factor * seen) if estimated else radius
    if estimated:
        words = f"for a radius of up to {radius:.2g} m, by the coherence of the channels; <array_radius> sets it"
    if radius <= 0:
        return FrequencyLimit(None, 0.0, "unknown without the radius of the array; <array_radius> gives it")
    planar = coordinate_count(recording, options, known_positions) == 2
    return FrequencyLimit(f_max(recording.count, radius, speed, options.dimension, planar), radius, words, estimated)


def _stated_radius(
    recording: Recording, options: ImportOptions, known_positions: np.ndarray | None
) -> tuple[float, str]:
    """Return the radius, metres, that is given or follows from positions, and where it is from; 0 without one."""
    if options.array_radius is not None:
        require_positive("array_radius", options.array_radius, "m")
        return options.array_radius, "for the radius given"
    complete = recording.positions is not None
    positions = recording.positions if complete else known_positions
    radius = 0.0
    if positions is not None:
        radius = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
    radius *= 1.0 if complete else LIMITS.known_radius_factor
    share = f"{100 * (LIMITS.known_radius_factor - 1):.0f} % more than that of the known microphones"
    return radius, f"for a radius of {radius:.2g} m, {'that of the positions in the file' if complete else share}"


def _coherent_radius(recording: Recording, dimension: int, speed: float) -> float | None:
    """Return the radius that the coherence of the channels shows, metres; None where it shows none."""
    top = min(LIMITS.max_frequency * recording.sample_rate, recording.highest or np.inf)
    low = max(LIMITS.low, LIMITS.min_periods / recording.duration)
    if low >= top or recording.count * recording.samples > SETTINGS.samples:
        return None
    from scipy.fft import rfft

    padded = fast_length(recording.samples)
    bins = np.unique(np.round(np.geomspace(low, top, SETTINGS.count) * padded / recording.sample_rate).astype(int))
    bins = bins[bins <= padded // 2]
    rows = [np.asarray(rfft(samples, padded, axis=1))[:, bins] for _, samples in channel_groups(recording)]
    spectra = np.concatenate(rows).T
    power = np.mean(np.abs(spectra) ** 2, axis=1)
    loud = power >= power.max() * 10 ** (-SETTINGS.dynamic_range / 10)
    wavenumbers = 2 * np.pi * bins * recording.sample_rate / padded / speed
    return array_radius(spectra[loud], wavenumbers[loud], dimension)


def coordinate_count(recording: Recording, options: ImportOptions, known_positions: np.ndarray | None) -> int:
    """Return the number of coordinates of a microphone."""
    positions = known_positions if recording.positions is None else recording.positions
    return options.dimension if positions is None else positions.shape[1]


def frequency_band(
    recording: Recording, options: ImportOptions, found: FrequencyLimit, speed: float
) -> tuple[float, float]:
    """Return the lowest and the highest frequency, Hz.

    `found`: of `highest_frequency`; `speed`: sound speed, m/s. Raises InputError: the band is empty, or beyond what the
    recording or the array can hold.
    """
    top = min(LIMITS.max_frequency * recording.sample_rate, recording.highest or np.inf)
    if options.frequencies == "auto":
        low = max(_usual_bottom(found, speed), LIMITS.min_periods / recording.duration)
        high = min(_usual_top(found, options, speed), top)
    else:
        low, high = _given_band(options.frequencies)
    if found.limit is not None and found.limit <= low and not found.estimated:
        raise InputError(
            f"{recording.path}: an array of {found.radius:.3g} m radius is too large for {recording.count} microphones:"
            f" they interpolate up to {found.limit:.3g} Hz, and the band begins at {low:g} Hz",
            "give positions in metres, not in centimetres, millimetres or degrees",
            key="frequencies",
        )
    if not 0 < low < high <= top:
        raise InputError(
            f"frequencies = {low:g}:{high:g} is no band that {recording.path} can hold",
            f"use 0 < LO < HI <= {top:g} Hz",
            key="frequencies",
            value=options.frequencies,
        )
    return low, high


def _usual_bottom(found: FrequencyLimit, speed: float) -> float:
    """Return the default lower end of the band, Hz: it follows 1 / R for small arrays.

    The gradient of a pressure is about k times it. Where k R is 0.13, a difference of 0.1 dB between two channels is a
    tenth of the radius, and more below; a high-pass differs by that at low frequencies, while the gains of the
    likelihood are the same at all frequencies.
    """
    if found.limit is None or not found.radius:
        return LIMITS.low
    return max(LIMITS.low, LIMITS.least_phase * speed / (2 * np.pi * found.radius))


def _usual_top(found: FrequencyLimit, options: ImportOptions, speed: float) -> float:
    """Return the default upper end of the band, Hz: it follows 1 / R for small arrays."""
    if found.limit is None:
        return LIMITS.high
    if options.array_radius is not None:
        return found.limit
    return min(found.limit, max(LIMITS.high, LIMITS.phase * speed / (2 * np.pi * found.radius)))


def _given_band(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise InputError(
            f'frequencies = "{text}" is no band', "write auto or LO:HI, as 20:300", key="frequencies", value=text
        ) from None
    return low, high
