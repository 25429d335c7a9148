"""What the user of `fdcal import` may say, and what follows of it for a recording: sound speed and band.

ImportOptions      plain data, checked
sound_speed_of    the speed of sound, m/s
coordinate_count     number of coordinates of a microphone
usable_limit   the highest usable frequency
frequency_band     where to take frequencies
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..acoustics.fourier_bessel import f_max
from ..model.validation import InputError, require_choice, require_positive
from .frequency_selection import MOST
from .recording import KINDS, Recording, sound_speed

LOWEST, HIGHEST = 20.0, 500.0  # Hz, unless told
ROOM_CELSIUS = 20.0  # where neither file nor user says
AROUND_KNOWN = 1.2  # times the radius of the known microphones, that of all


@dataclass(frozen=True)
class ImportOptions:
    """What the user may say; None is for what the file or fdcal decides.

    Attributes
    ----------
    frequencies : "auto" or "LO:HI", Hz
    window : "auto", "none" or the rate of the exponential window, 1/s
    kind : "auto", "response" or "work"
    most : greatest number of frequencies
    temperature : degrees Celsius, or `speed`, m/s
    source : which of several, from 0
    dimension : 2 or 3, of the sound field
    plane, subset, leave_out, known : see `fdcal.recordings.channel_selection`
    reference : file with the signal that the source was given
    against : name of the microphone against which cross-spectra are taken
    radius : of the array, metres
    """

    frequencies: str = "auto"
    window: str = "auto"
    kind: str = "auto"
    most: int = MOST
    temperature: float | None = None
    speed: float | None = None
    source: int | None = None
    dimension: int = 3
    plane: str | None = None
    subset: str | None = None
    seed: int = 0
    leave_out: str | None = None
    known: str | None = None
    reference: str | None = None
    against: str | None = None
    radius: float | None = None


def check(options: ImportOptions) -> None:
    require_choice("--kind", options.kind, ("auto", *KINDS))
    require_choice("--dimension", options.dimension, (2, 3))
    if not 1 <= options.most <= 2000:
        raise InputError(f"--most {options.most} frequencies cannot be; use 1 to 2000")
    if options.temperature is not None and options.speed is not None:
        raise InputError("--temperature and --sound-speed say the same; give one of them")
    if options.temperature is not None and not -60 <= options.temperature <= 80:
        raise InputError(f"--temperature {options.temperature:g} must be in degrees Celsius, -60 to 80")
    if options.speed is not None:
        require_positive("--sound-speed", options.speed, "m/s")
    if options.reference is not None and options.against is not None:
        raise InputError("--reference is a signal and --reference-microphone a channel; give one of them")


def sound_speed_of(recording: Recording, options: ImportOptions) -> tuple[float, str]:
    if options.speed is not None:
        return options.speed, "as given"
    if options.temperature is not None:
        return sound_speed(options.temperature), f"at {options.temperature:g} degrees Celsius"
    if recording.sound_speed is not None:
        return recording.sound_speed, "as the file says"
    return sound_speed(ROOM_CELSIUS), f"at {ROOM_CELSIUS:g} degrees Celsius, which was supposed; give --temperature"


def usable_limit(recording: Recording, options: ImportOptions, places, speed: float) -> tuple[float | None, str]:
    """The highest usable frequency, Hz, and by what radius: as told, of the positions in the file, or the known ones.

    None where nothing tells the radius.
    """
    if options.radius is not None:
        require_positive("--array-radius", options.radius, "m")
        radius, words = options.radius, "for the radius given"
    else:
        told = recording.positions is not None
        some = recording.positions if told else places
        radius = 0.0 if some is None else float(np.linalg.norm(some - some.mean(axis=0), axis=1).max())
        radius *= 1.0 if told else AROUND_KNOWN
        who = "that of the positions in the file" if told else "a fifth more than that of the known microphones"
        words = f"for a radius of {radius:.2g} m, {who}"
    if radius <= 0:
        return None, "unknown without the array's radius; give --array-radius R"
    planar = coordinate_count(recording, options, places) == 2
    return f_max(recording.count, radius, speed, options.dimension, planar), words


def coordinate_count(recording: Recording, options: ImportOptions, places) -> int:
    """Number of coordinates of a microphone."""
    told = recording.positions if recording.positions is not None else places
    return options.dimension if told is None else told.shape[1]


def frequency_band(
    recording: Recording, options: ImportOptions, usable: float | None, usable_from: str
) -> tuple[float, float]:
    """The lowest and highest frequency, Hz."""
    top = 0.45 * recording.sample_rate
    if options.frequencies == "auto":
        low, high = max(LOWEST, 4 / recording.duration), HIGHEST
        if usable is not None:  # a radius that was given may raise it, too
            high = usable if options.radius is not None else min(usable, HIGHEST)
        high = min(high, top)
    else:
        try:
            low, high = (float(part) for part in options.frequencies.split(":"))
        except ValueError:
            raise InputError(
                f'--frequencies "{options.frequencies}" is no band; write auto or LO:HI, as 20:300'
            ) from None
    if usable is not None and usable <= low:
        raise InputError(
            f"{recording.path}: {recording.count} microphones interpolate up to {usable:.3g} Hz {usable_from}, and the"
            f" band begins at {low:g} Hz; tell positions in metres, neither in degrees nor in millimetres"
        )
    if not 0 < low < high <= top:
        raise InputError(
            f"--frequencies {low:g}:{high:g} is no band that {recording.path} can hold; use 0 < LO < HI <= {top:g} Hz"
        )
    return low, high
