"""From a file of somebody's to a measurement: what `fdcal import` does, without a command line.

Wishes     what the user may say
intake     path and wishes to a measurement and a report
report     in words
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from . import choosing, formats
from .bins import MOST, highest_usable
from .checks import InputError, require_choice, require_positive
from .measurement import Measurement
from .recording import KINDS, Recording, inspect, require_usable, sound_speed
from .responses import Pressures, from_response
from .steady import from_work

LOWEST, HIGHEST = 20.0, 500.0  # Hz, unless told
ROOM_CELSIUS = 20.0  # where neither file nor user says
AROUND_KNOWN = 1.2  # times the radius of the known microphones, that of all
COMPLETE_DB = 20.0  # by which a complete recording falls towards its end


@dataclass(frozen=True)
class Wishes:
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
    plane, subset, leave_out, known : see `fdcal.choosing`
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


@dataclass(frozen=True)
class Report:
    """What was read and taken: `recording`, `kind`, `left_out` names, `pressures`, `speed` m/s and where it is from,
    `usable` Hz or None and the radius it is from, in words."""

    recording: Recording
    kind: str
    left_out: tuple[str, ...]
    pressures: Pressures
    speed: float
    speed_from: str
    usable: float | None
    usable_from: str


def intake(path: str | Path, wishes: Wishes = Wishes()) -> tuple[Measurement, Report]:
    """The measurement in a file or folder. Raises InputError and StorageError."""
    _check(wishes)
    recording = formats.read(path, wishes.source)
    recording, left_out = _chosen(recording, wishes)
    if recording.count < 2:
        raise InputError(f"{path} gives one channel; an array needs two microphones at least")
    recording = _flattened(recording, wishes)
    numbers, places = (np.zeros(0, int), None) if wishes.known is None else choosing.known(recording, wishes.known)
    speed, speed_from = _speed(recording, wishes)
    usable, usable_from = _usable(recording, wishes, places, speed)
    band = _band(recording, wishes, usable)
    recording, kind = _complete(recording, wishes, band)
    pressures = _pressures(recording, kind, wishes, band, speed)
    measurement = _measurement(recording, wishes, numbers, places, pressures, speed)
    return measurement, Report(recording, kind, left_out, pressures, speed, speed_from, usable, usable_from)


def _check(wishes: Wishes) -> None:
    require_choice("--kind", wishes.kind, ("auto", *KINDS))
    require_choice("--dimension", wishes.dimension, (2, 3))
    if not 1 <= wishes.most <= 2000:
        raise InputError(f"--most {wishes.most} frequencies cannot be; use 1 to 2000")
    if wishes.temperature is not None and wishes.speed is not None:
        raise InputError("--temperature and --sound-speed say the same; give one of them")
    if wishes.temperature is not None and not -60 <= wishes.temperature <= 80:
        raise InputError(f"--temperature {wishes.temperature:g} must be in degrees Celsius, -60 to 80")
    if wishes.speed is not None:
        require_positive("--sound-speed", wishes.speed, "m/s")
    if wishes.reference is not None and wishes.against is not None:
        raise InputError("--reference is a signal and --reference-microphone a channel; give one of them")


def _chosen(recording: Recording, wishes: Wishes) -> tuple[Recording, tuple[str, ...]]:
    """The channels that the user wants, each found sound, and the names of those left out."""
    if wishes.plane is not None:
        recording = choosing.on_plane(recording, wishes.plane)
    if wishes.subset is not None:
        recording = choosing.subset(recording, wishes.subset, wishes.seed)
    before = recording.names
    listed = [name for name in (wishes.leave_out or "").split(",") if name.strip() not in ("", "bad")]
    if listed:  # before they are looked at: they may hold what cannot be read
        recording = choosing.without(recording, ",".join(listed), np.zeros(0, int))
    health = inspect(recording)
    if "bad" in (wishes.leave_out or "").split(","):
        recording = choosing.without(recording, "bad", health.bad)
    else:
        require_usable(recording, health)
    return recording, tuple(name for name in before if name not in recording.names)


def _speed(recording: Recording, wishes: Wishes) -> tuple[float, str]:
    if wishes.speed is not None:
        return wishes.speed, "as given"
    if wishes.temperature is not None:
        return sound_speed(wishes.temperature), f"at {wishes.temperature:g} degrees Celsius"
    if recording.sound_speed is not None:
        return recording.sound_speed, "as the file says"
    return sound_speed(ROOM_CELSIUS), f"at {ROOM_CELSIUS:g} degrees Celsius, which was supposed; give --temperature"


def _flattened(recording: Recording, wishes: Wishes) -> Recording:
    """Without heights where the field has none. Raises InputError where they differ."""
    positions = recording.positions
    if positions is None or positions.shape[1] <= wishes.dimension:
        return recording
    if np.ptp(positions[:, 2]) > choosing.LEVEL:
        raise InputError("--dimension 2 needs microphones of one height; choose them: --plane z=HEIGHT")
    return replace(recording, positions=positions[:, :2])


def _usable(recording: Recording, wishes: Wishes, places, speed: float) -> tuple[float | None, str]:
    """The highest usable frequency, Hz, and by what radius: as told, of the positions in the file, or the known ones.

    None where nothing tells the radius.
    """
    if wishes.radius is not None:
        require_positive("--array-radius", wishes.radius, "m")
        radius, words = wishes.radius, "for the radius given"
    else:
        told = recording.positions is not None
        some = recording.positions if told else places
        radius = 0.0 if some is None else float(np.linalg.norm(some - some.mean(axis=0), axis=1).max())
        radius *= 1.0 if told else AROUND_KNOWN
        who = "that of the positions in the file" if told else "a fifth more than that of the known microphones"
        words = f"for a radius of {radius:.2g} m, {who}"
    if radius <= 0:
        return None, "unknown without the array's radius; give --array-radius R"
    planar = _axes(recording, wishes, places) == 2
    return highest_usable(recording.count, radius, speed, wishes.dimension, planar), words


def _axes(recording: Recording, wishes: Wishes, places) -> int:
    """Number of coordinates of a microphone."""
    told = recording.positions if recording.positions is not None else places
    return wishes.dimension if told is None else told.shape[1]


def _band(recording: Recording, wishes: Wishes, usable: float | None) -> tuple[float, float]:
    """The lowest and highest frequency, Hz."""
    top = 0.45 * recording.sample_rate
    if wishes.frequencies == "auto":
        low, high = max(LOWEST, 4 / recording.duration), HIGHEST
        if usable is not None:  # a radius that was given may raise it, too
            high = max(usable if wishes.radius is not None else min(usable, HIGHEST), 2 * low)
        high = min(high, top)
    else:
        try:
            low, high = (float(part) for part in wishes.frequencies.split(":"))
        except ValueError:
            raise InputError(
                f'--frequencies "{wishes.frequencies}" is no band; write auto or LO:HI, as 20:300'
            ) from None
    if not 0 < low < high <= top:
        raise InputError(
            f"--frequencies {low:g}:{high:g} is no band that {recording.path} can hold; use 0 < LO < HI <= {top:g} Hz"
        )
    return low, high


def _complete(recording: Recording, wishes: Wishes, band) -> tuple[Recording, str]:
    """The recording, deconvolved where a reference is given, and its kind."""
    if wishes.reference is not None:
        from .deconvolution import deconvolved

        return deconvolved(recording, formats.read(wishes.reference), band), "response"
    if wishes.against is not None:
        return recording, "work"
    if wishes.kind != "auto":
        return recording, wishes.kind
    if recording.kind is not None:
        return recording, recording.kind
    return recording, "response" if _falls(recording, band) else "work"


def _falls(recording: Recording, band) -> bool:
    """Whether the sound is gone, or nearly, at the end: then the recording is complete."""
    from .responses import LONGEST, piece_levels

    if recording.samples > LONGEST:
        return False
    level = piece_levels(recording, band)
    return bool(level[-2:].mean() <= level.max() * 10 ** (-COMPLETE_DB / 10))


def _pressures(recording: Recording, kind: str, wishes: Wishes, band, speed: float) -> Pressures:
    if kind == "work":
        if wishes.window != "auto":
            raise InputError(f"--window {wishes.window} is for --kind response; a source at work needs none")
        if wishes.against is not None and wishes.against not in recording.names:
            raise InputError(f'--reference-microphone "{wishes.against}" is no channel; use a name or number of one')
        reference = None if wishes.against is None else recording.names.index(wishes.against)
        return from_work(recording, band, speed, wishes.most, reference)
    rate = {"auto": None, "none": 0.0}.get(wishes.window, wishes.window)
    try:
        rate = None if rate is None else float(rate)
    except ValueError:
        rate = -1.0
    if rate is not None and not 0 <= rate * recording.duration <= 50:
        raise InputError(
            f'--window "{wishes.window}" must be auto, none or a rate up to {50 / recording.duration:.3g} per second'
        )
    return from_response(recording, band, speed, rate, wishes.most)


def _measurement(recording: Recording, wishes: Wishes, numbers, places, taken: Pressures, speed: float) -> Measurement:
    axes = _axes(recording, wishes, places)
    if places is not None and places.shape[1] != axes:
        raise InputError(f"--known {wishes.known} gives {places.shape[1]} coordinates where the file has {axes}")
    return Measurement(
        frequencies=taken.frequencies,
        pressures=taken.pressures,
        sound_speed=speed,
        dimension=wishes.dimension,
        array_dimension=min(axes, wishes.dimension),
        wavenumbers=taken.wavenumbers,
        noise_power=taken.noise_power,
        names=recording.names,
        positions=recording.positions,
        known=numbers,
        known_positions=places,
    )


def report(measurement: Measurement, told: Report) -> str:
    """What was imported, in words, one fact a line."""
    recording, taken = told.recording, told.pressures
    f = taken.frequencies
    kind = {"response": "complete: from silence to the end of the sound", "work": "a source at work"}[told.kind]
    usable = told.usable_from if told.usable is None else f"{told.usable:.0f} Hz, {told.usable_from}"
    lines = [
        f"channels     {recording.count}, {recording.duration:.3g} s at {recording.sample_rate:g} Hz ({kind})",
        f"left out     {', '.join(told.left_out) or 'none'}; none of the others is silent, clipped or a copy"
        if len(told.left_out) <= 8
        else f"left out     {len(told.left_out)} channels",
        f"taken by     {taken.how}",
        f"frequencies  {len(f)}, {f[0]:.1f} to {f[-1]:.1f} Hz",
        f"highest usable frequency  {usable}",
        f"sound speed  {told.speed:.1f} m/s {told.speed_from}",
        f"known        {len(measurement.known)} of {measurement.count} microphones",
    ]
    return "\n".join(lines + _snr_lines(taken))


def _snr_lines(taken: Pressures) -> list[str]:
    """Signal-to-noise ratio of every frequency, dB, eight to a line."""
    if taken.noise_power is None:
        return ["SNR          not told: the room still rings at the end; record longer to know it"]
    power = np.mean(np.abs(taken.pressures) ** 2, axis=1)
    snr = 10 * np.log10(np.maximum(power / np.maximum(taken.noise_power, 1e-12 * power) - 1, 1e-3))
    cells = [f"{f:7.1f} Hz {s:3.0f} dB" for f, s in zip(taken.frequencies, snr, strict=True)]
    rows = ["  ".join(cells[start : start + 6]) for start in range(0, len(cells), 6)]
    return [f"SNR          {np.median(snr):.0f} dB in the middle, {snr.min():.0f} to {snr.max():.0f} dB", *rows]
