"""The options of an import: `ImportOptions`, plain data, checked by `check_options`, and the sound speed."""

from __future__ import annotations

from dataclasses import dataclass

from ..model.declared import require_positive
from ..model.validation import InputError, require_choice
from .recording import KINDS, OLD_KINDS, sound_speed


@dataclass(frozen=True)
class ImportLimits:
    """What is assumed where nothing is given, and what may be given."""

    # low, high: default band, Hz, of an array of unknown or large radius
    low: float = 20.0
    high: float = 500.0
    phase: float = 7.0  # largest k R of the default band of a small array, radians, which the solvers resolve
    # least k R of the default band, radians. Below it the pressures differ by less than the responses of channels do
    least_phase: float = 0.13
    min_periods: float = 4.0  # periods of the lowest frequency in a recording, by default
    max_frequency: float = 0.45  # relative to the sampling rate
    celsius: float = 20.0  # default temperature
    # min_sound_speed, max_sound_speed: m/s, from that of heavy gases to that of solids
    min_sound_speed: float = 100.0
    max_sound_speed: float = 6000.0
    min_celsius: float = -60.0
    max_celsius: float = 80.0
    known_radius_factor: float = 1.2  # radius of an array relative to that of its known microphones
    coherent_radius_factor: float = 1.25  # radius of an array relative to the one of its coherence, on the safe side
    max_count: int = 2000  # number of rows


IMPORT_LIMITS = ImportLimits()


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
    most : int or None
        Greatest number of rows of all takes together; `fdcal.recordings.frequencies.default_most` unless given.
    temperature : float or None
        Degrees Celsius; gives the sound speed.
    sound_speed : float or None
        m/s, instead of a temperature.
    source : int, str or None
        Which of several sources in a file, from 0; "all" makes each of them a take.
    files : str
        What several files are: "takes", of the same channels; "channels", of one take; "auto", channels if every file
        has one, else takes.
    split : float or None
        Length of the takes into which a stationary recording is cut, s.
    dimension : int
        2 or 3, of the sound field.
    plane, subset, leave_out, known : str or None
        See `fdcal.recordings.channels`.
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
    most: int | None = None
    temperature: float | None = None
    sound_speed: float | None = None
    source: int | str | None = None
    files: str = "auto"
    split: float | None = None
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
    require_choice("files", options.files, ("auto", "takes", "channels"))
    _check_takes(options)
    if options.dimension not in (2, 3):
        raise InputError(f"dimension = {options.dimension} is unknown", "use one of 2, 3", key="dimension")
    if options.most is not None and not 1 <= options.most <= IMPORT_LIMITS.max_count:
        raise InputError(
            f"most = {options.most} is out of range",
            f"use 1 to {IMPORT_LIMITS.max_count}",
            key="most",
            value=options.most,
        )
    if options.temperature is not None and options.sound_speed is not None:
        raise InputError(
            "a temperature and a sound speed say the same",
            "give one of <temperature> and <sound_speed>",
            key="sound_speed",
        )
    if (
        options.temperature is not None
        and not IMPORT_LIMITS.min_celsius <= options.temperature <= IMPORT_LIMITS.max_celsius
    ):
        raise InputError(
            f"temperature = {options.temperature:g} must be in degrees Celsius, {IMPORT_LIMITS.min_celsius:g} to"
            f" {IMPORT_LIMITS.max_celsius:g}",
            key="temperature",
            value=options.temperature,
        )
    if options.sound_speed is not None:
        require_positive("sound_speed", options.sound_speed, "m/s")
        if not IMPORT_LIMITS.min_sound_speed <= options.sound_speed <= IMPORT_LIMITS.max_sound_speed:
            raise InputError(
                f"sound_speed = {options.sound_speed:g} m/s is that of no medium",
                "air at 20 degrees Celsius has 343 m/s",
                key="sound_speed",
                value=options.sound_speed,
            )
    if options.reference is not None and options.reference_microphone is not None:
        raise InputError(
            "a reference signal and a reference microphone exclude each other",
            "give one of <reference> and <reference_microphone>",
            key="reference",
        )


def _check_takes(options: ImportOptions) -> None:
    """Raise InputError where sources, parts or a reference contradict each other."""
    if isinstance(options.source, str) and options.source != "all":
        raise InputError(
            f'source = "{options.source}" is no source',
            "use a number from 0, or all",
            key="source",
            value=options.source,
        )
    if options.split is None:
        return
    require_positive("split", options.split, "s")
    if options.kind == "impulse" or options.reference is not None or options.array is not None:
        what = "kind impulse" if options.kind == "impulse" else "a reference" if options.reference else "an array"
        raise InputError(
            f"split = {options.split:.3g} s cuts a stationary recording, and {what} is given",
            "leave out <split>, or record each take on its own",
            key="split",
            value=options.split,
        )


def sound_speed_of(in_file: float | None, options: ImportOptions) -> tuple[float, str]:
    """Return the sound speed, m/s, given that `in_file`, and where it is from, in words."""
    if options.sound_speed is not None:
        return options.sound_speed, "as given"
    if options.temperature is not None:
        return sound_speed(options.temperature), f"at {options.temperature:g} degrees Celsius"
    if in_file is not None:
        return in_file, "according to the file"
    return sound_speed(IMPORT_LIMITS.celsius), f"at an assumed temperature of {IMPORT_LIMITS.celsius:g} degrees Celsius"
