"""The options of an import, each declared once: in Python, on the command line and in the documentation."""

import math
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from ..model.validation import InputError, Seconds, check, positive, within
from .recording import sound_speed


@dataclass(frozen=True)
class ImportLimits:
    """What is assumed where nothing is given, and what may be given."""

    # low, high: default band, Hz, of an array of unknown or large radius
    low: float = 20.0
    high: float = 500.0
    phase: float = 7.0  # largest k R of the default band of a small array, radians, which the solvers resolve
    # least k R of the default band, radians. Below it the pressures differ by less than the responses of channels do
    min_phase: float = 0.13
    min_periods: float = 4.0  # periods of the lowest frequency in a recording, by default
    max_frequency: float = 0.45  # relative to the sampling rate
    celsius: float = 20.0  # default temperature
    known_radius_factor: float = 1.2  # radius of an array relative to that of its known microphones
    coherent_radius_factor: float = 1.25  # radius of an array relative to the one of its coherence, on the safe side


IMPORT_LIMITS = ImportLimits()


def _option(default: Any, text: str, metavar: str | None = None) -> Any:
    """Return a field that is an option of `fdcal import`, with its help and placeholder."""
    return field(default=default, metadata={"help": text, "metavar": metavar})


@dataclass(frozen=True, kw_only=True)
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
        Greatest number of rows of all takes together; `fdcal.recordings.frequencies.default_max_rows` unless given.
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
    array_dimension : int or None
        2 or 3, coordinates of a microphone; 2 unless given where the heights of all microphones are known and agree.
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

    # In the order in which `fdcal import --help` lists them; the command line declares the last three.
    frequencies: str = _option("auto", "Band to choose from, Hz.", "auto|LO:HI")
    # bound of time and memory, five times what an import takes by itself
    most: Annotated[int, within(1, 2000)] | None = _option(
        None, "Greatest number of rows of all takes.  [default: 400]", "M"
    )
    kind: Literal["auto", "impulse", "stationary"] = _option(
        "auto",
        "impulse: an impulse response, from silence to silence; stationary: a continuous sound.",
    )
    window: str = _option("auto", "Exponential window, 1/s.", "auto|none|RATE")
    temperature: Annotated[float, within(-60, 80, "degrees Celsius")] | None = _option(
        None, "Of the air, degrees Celsius; gives the sound speed.", "C"
    )
    # bounds: heavy gases to solids
    sound_speed: Annotated[float, within(100, 6000, "m/s")] | None = _option(None, "Instead of a temperature.", "M/S")
    dimension: Literal[2, 3] = _option(3, "Of the sound field.")
    array_dimension: Literal[2, 3] | None = _option(
        None,
        "Of the microphones: 2 in a plane.  [default: 2 where all heights are given and agree]",
    )
    plane: str | None = _option(None, "Use the microphones in a plane only, by the positions in the file.", "z=Z")
    subset: str | None = _option(None, "Use N microphones drawn at random, or those in a list.", "N|I,J,...")
    seed: Annotated[int, within(0)] = _option(0, "Random seed of --subset.", "S")
    leave_out: str | None = _option(None, "Leave out these channels, or all that are faulty.", "NAMES|bad")
    known: str | None = _option(
        None, "Known microphones; a table has the columns name,x,y[,z].", "NAMES|corners|none|FILE.csv"
    )
    reference: str | None = _option(None, "Signal that the source emitted, for deconvolution.", "FILE.wav")
    reference_microphone: str | None = _option(None, "Take cross-spectra against this channel.", "NAME")
    array: str | None = _option(None, "Positions to render a measured room at: name,x,y,z from its centre.", "FILE.csv")
    array_radius: Annotated[float, positive("m")] | None = _option(
        None, "Metres; determines the highest usable frequency.", "R"
    )
    source: int | str | None = None
    files: Literal["auto", "takes", "channels"] = "auto"
    split: Seconds | None = None

    def __post_init__(self):
        object.__setattr__(self, "known", None if self.known == "none" else self.known)


def refused_option(options: ImportOptions, key: str, problem: str, remedy: str = "") -> InputError:
    """Return the error of the option `key`."""
    return InputError(problem, remedy, key=key, value=getattr(options, key))


def number_in(text: str) -> float:
    """Return the number that a text of an option holds; NaN for any other text."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def check_options(options: ImportOptions) -> None:
    """Raise InputError for options that are out of range or contradict each other."""
    check(options)
    if isinstance(options.source, str) and options.source != "all":
        raise refused_option(
            options, "source", f'source = "{options.source}" is no source', "use a number from 0, or all"
        )
    if options.split is not None and (options.kind == "impulse" or options.reference or options.array):
        what = "kind impulse" if options.kind == "impulse" else "a reference" if options.reference else "an array"
        problem = f"split = {options.split:.3g} s cuts a stationary recording, and {what} is given"
        raise refused_option(options, "split", problem, "leave out <split>, or record each take on its own")
    if options.array_dimension == 3 and options.dimension == 2:
        raise refused_option(options, "array_dimension", "array_dimension = 3 is not possible in a field of 2", "use 2")
    if options.temperature is not None and options.sound_speed is not None:
        remedy = "give one of <temperature> and <sound_speed>"
        raise InputError("a temperature and a sound speed say the same", remedy, key="sound_speed")
    if options.reference is not None and options.reference_microphone is not None:
        remedy = "give one of <reference> and <reference_microphone>"
        raise InputError("a reference signal and a reference microphone exclude each other", remedy, key="reference")


def sound_speed_of(in_file: float | None, options: ImportOptions) -> tuple[float, str]:
    """Return the sound speed, m/s, given that `in_file`, and where it is from, in words."""
    if options.sound_speed is not None:
        return options.sound_speed, "as given"
    if options.temperature is not None:
        return sound_speed(options.temperature), f"at {options.temperature:g} degrees Celsius"
    if in_file is not None:
        return in_file, "according to the file"
    return sound_speed(IMPORT_LIMITS.celsius), f"at an assumed temperature of {IMPORT_LIMITS.celsius:g} degrees Celsius"
