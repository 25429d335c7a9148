"""The options of an import, and what follows from them for a recording: sound speed, highest frequency and band.

ImportOptions       plain data
check_options       refuse values that are out of range
sound_speed_of      the sound speed, m/s
coordinate_count    number of coordinates of a microphone
highest_frequency   the highest frequency that the array can interpolate
frequency_band      the band from which frequencies are chosen
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..acoustics.fourier_bessel import f_max
from ..model.validation import InputError, require_choice, require_positive
from .frequency_selection import DEFAULT_COUNT
from .recording import KINDS, OLD_KINDS, Recording, sound_speed


@dataclass(frozen=True)
class ImportLimits:
    """What is assumed where nothing is given, and what may be given.

    Attributes
    ----------
    low, high : float
        Default band, Hz.
    min_periods : float
        Periods of the lowest frequency in a recording, by default.
    max_frequency : float
        Relative to the sampling rate.
    celsius : float
        Default temperature.
    min_celsius, max_celsius : float
    known_radius_factor : float
        Radius of an array relative to that of its known microphones.
    max_count : int
        Number of frequencies.
    """

    low: float = 20.0
    high: float = 500.0
    min_periods: float = 4.0
    max_frequency: float = 0.45
    celsius: float = 20.0
    min_celsius: float = -60.0
    max_celsius: float = 80.0
    known_radius_factor: float = 1.2
    max_count: int = 2000


LIMITS = ImportLimits()


@dataclass(frozen=True)
class ImportOptions:
    """How a recording is imported; None leaves a choice to the file or to fdcal.

    Attributes
    ----------
    frequencies : str
        "auto" or "LO:HI", Hz.
    window : str
        "auto", "none" or the rate of the exponential window, 1/s.
    kind : str
        "auto", or one of `fdcal.recordings.recording.KINDS`.
    most : int
        Greatest number of frequencies.
    temperature : float or None
        Degrees Celsius; gives the sound speed.
    sound_speed : float or None
        m/s, instead of a temperature.
    source : int or None
        Which of several sources in a file, from 0.
    dimension : int
        2 or 3, of the sound field.
    plane, subset, leave_out, known : str or None
        See `fdcal.recordings.channel_selection`.
    seed : int
        Of a random `subset`.
    reference : str or None
        File with the signal that the source emitted.
    reference_microphone : str or None
        Name of the channel against which cross-spectra are taken.
    array_radius : float or None, metres
    array : str or None
        Table (.csv) with name,x,y,z of the array that is rendered in the field of a measured room, metres.
    """

    frequencies: str = "auto"
    window: str = "auto"
    kind: str = "auto"
    most: int = DEFAULT_COUNT
    temperature: float | None = None
    sound_speed: float | None = None
    source: int | None = None
    dimension: int = 3
    plane: str | None = None
    subset: str | None = None
    seed: int = 0
    leave_out: str | None = None
    known: str | None = None
    reference: str | None = None
    reference_microphone: str | None = None
    array_radius: float | None = None
    array: str | None = None

    def __post_init__(self):
        object.__setattr__(self, "kind", OLD_KINDS.get(self.kind, self.kind))


def check_options(options: ImportOptions) -> None:
    """Raise InputError for options that are out of range or contradict each other."""
    require_choice("kind", options.kind, ("auto", *KINDS))
    if options.dimension not in (2, 3):
        raise InputError(f"dimension = {options.dimension} is unknown", "use one of 2, 3", key="dimension")
    if not 1 <= options.most <= LIMITS.max_count:
        raise InputError(
            f"most = {options.most} is out of range", f"use 1 to {LIMITS.max_count}", key="most", value=options.most
        )
    if options.temperature is not None and options.sound_speed is not None:
        raise InputError(
            "a temperature and a sound speed say the same",
            "give one of <temperature> and <sound_speed>",
            key="sound_speed",
        )
    if options.temperature is not None and not LIMITS.min_celsius <= options.temperature <= LIMITS.max_celsius:
        raise InputError(
            f"temperature = {options.temperature:g} must be in degrees Celsius, {LIMITS.min_celsius:g} to"
            f" {LIMITS.max_celsius:g}",
            key="temperature",
            value=options.temperature,
        )
    if options.sound_speed is not None:
        require_positive("sound_speed", options.sound_speed, "m/s")
    if options.reference is not None and options.reference_microphone is not None:
        raise InputError(
            "a reference signal and a reference microphone exclude each other",
            "give one of <reference> and <reference_microphone>",
            key="reference",
        )


def sound_speed_of(in_file: float | None, options: ImportOptions) -> tuple[float, str]:
    """Return the sound speed, m/s, given that `in_file`, and where it is from, in words."""
    if options.sound_speed is not None:
        return options.sound_speed, "as given"
    if options.temperature is not None:
        return sound_speed(options.temperature), f"at {options.temperature:g} degrees Celsius"
    if in_file is not None:
        return in_file, "according to the file"
    return sound_speed(LIMITS.celsius), f"at an assumed temperature of {LIMITS.celsius:g} degrees Celsius"


def highest_frequency(
    recording: Recording, options: ImportOptions, known_positions: np.ndarray | None, speed: float
) -> tuple[float | None, str]:
    """Return the highest frequency that the array can interpolate (Eq. 9), and which radius it follows from.

    Parameters
    ----------
    recording : Recording
    options : ImportOptions
    known_positions : (A, D) float64 or None
        Of the known microphones, metres.
    speed : float
        Sound speed, m/s.

    Returns
    -------
    float or None, str
        Hz, None where the radius is unknown; and the radius in words.
    """
    if options.array_radius is not None:
        require_positive("array_radius", options.array_radius, "m")
        radius, words = options.array_radius, "for the radius given"
    else:
        complete = recording.positions is not None
        positions = recording.positions if complete else known_positions
        radius = 0.0
        if positions is not None:
            radius = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
        radius *= 1.0 if complete else LIMITS.known_radius_factor
        share = f"{100 * (LIMITS.known_radius_factor - 1):.0f} % more than that of the known microphones"
        words = f"for a radius of {radius:.2g} m, {'that of the positions in the file' if complete else share}"
    if radius <= 0:
        return None, "unknown without the radius of the array"
    planar = coordinate_count(recording, options, known_positions) == 2
    return f_max(recording.count, radius, speed, options.dimension, planar), words


def coordinate_count(recording: Recording, options: ImportOptions, known_positions: np.ndarray | None) -> int:
    """Return the number of coordinates of a microphone."""
    positions = known_positions if recording.positions is None else recording.positions
    return options.dimension if positions is None else positions.shape[1]


def frequency_band(
    recording: Recording, options: ImportOptions, limit: float | None, limit_from: str
) -> tuple[float, float]:
    """Return the lowest and the highest frequency, Hz.

    Parameters
    ----------
    recording : Recording
    options : ImportOptions
    limit, limit_from
        As of `highest_frequency`.

    Raises
    ------
    InputError
        The band is empty, or beyond what the recording or the array can hold.
    """
    top = min(LIMITS.max_frequency * recording.sample_rate, recording.highest or np.inf)
    if options.frequencies == "auto":
        low, high = max(LIMITS.low, LIMITS.min_periods / recording.duration), LIMITS.high
        if limit is not None:  # a radius that was given may also raise it
            high = limit if options.array_radius is not None else min(limit, LIMITS.high)
        high = min(high, top)
    else:
        low, high = _given_band(options.frequencies)
    if limit is not None and limit <= low:
        raise InputError(
            f"{recording.path}: {recording.count} microphones interpolate up to {limit:.3g} Hz {limit_from}, and the"
            f" band begins at {low:g} Hz",
            "give positions in metres, neither in degrees nor in millimetres",
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


def _given_band(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise InputError(
            f'frequencies = "{text}" is no band', "write auto or LO:HI, as 20:300", key="frequencies", value=text
        ) from None
    return low, high
