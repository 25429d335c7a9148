"""Recordings of N microphones, the common form of all file formats: samples are read only when they are needed.

A recording is of one of two kinds:

impulse      an impulse response, a clap or a whole sweep: it begins in silence and ends when the sound has decayed, or
             earlier, while the room still rings
stationary   a part of a continuous sound, such as noise, music, speech or a machine

The options of an import are declared here once: for Python, the command line and the documentation.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Annotated, Literal, get_args

import numpy as np

from ..model.quantities import MetresPerSecond, Seconds, option, positive
from ..model.validation import LIMITS, InputError, check, frozen_array, require_array, within

Kind = Literal["impulse", "stationary"]
KINDS = get_args(Kind)
CALLED = {"sample_rate": "sampling rate", "count": "channels", "samples": "samples a channel"}  # words for messages
ZERO_CELSIUS = 273.15  # K
GROUP_SAMPLES = 16_000_000  # samples read at a time: 128 MB as float64; `in_memory` keeps up to four times as many
BLOCK_SAMPLES = GROUP_SAMPLES // 4  # number of samples of a block of all channels
RANGE_SAMPLES = 500_000  # samples read at a time from a file with interleaved channels, so that they fit a CPU cache


Band = tuple[float, float]  # lowest and highest frequency, Hz
Noise = Callable[[np.ndarray], np.ndarray]  # maps frequencies, Hz, to power of the noise's transform per time sample
Block = Callable[[int, int, np.ndarray], np.ndarray]  # reads samples of the channels (n,) int64
MIN_SAMPLES = 16  # least number of samples of a channel


@dataclass(frozen=True)
class Recording:
    """N channels of T samples."""

    path: str  # name of the recording in messages
    kind: Kind | None  # None if the file does not state it
    sample_rate: Annotated[float, within(100.0, 1e7, "Hz")]
    # count, samples: N and T
    count: Annotated[int, within(1, 10_000)]
    samples: Annotated[int, within(MIN_SAMPLES)]
    block: Block
    names: tuple[str, ...] = ()  # each different; "0", "1", ... unless given
    positions: np.ndarray | None = None  # (N, D) float64, metres, of the microphones; None if the file has none
    sound_speed: MetresPerSecond | None = None  # None if the file does not state it
    full_scale: float | None = None  # greatest value that a sample can have
    lowest: float = 0.0  # lowest frequency that the recording contains, Hz

    def __post_init__(self):
        check(self, f"{self.path}: ", CALLED)
        names = tuple(self.names) or tuple(str(n) for n in range(self.count))
        if len(names) != self.count or len(set(names)) < len(names):
            raise InputError(f"{self.path}: its channels must have {self.count} different names", key="names")
        object.__setattr__(self, "names", names)
        if self.positions is not None:
            positions = require_array(f"{self.path}: positions", self.positions, "real", (self.count, None), "m")
            object.__setattr__(self, "positions", positions)

    @property
    def duration(self) -> float:
        """Duration, seconds."""
        return self.samples / self.sample_rate


def sound_speed(celsius: float) -> float:
    """Return the speed of sound in dry air, m/s: proportional to the square root of the temperature (ISO 9613-1)."""
    return 343.2 * math.sqrt((celsius + ZERO_CELSIUS) / 293.15)


def recording_of(path: str, kind: Kind | None, sample_rate: float, values, **others) -> Recording:
    """Return a recording of an array (N, T), in memory or memory-mapped; `others`: further fields of `Recording`."""
    count, samples = values.shape
    return Recording(path, kind, float(sample_rate), int(count), int(samples), block_of(values), **others)


def block_of(values: np.ndarray) -> Block:
    """Return the function that reads samples of an array (N, T)."""
    return lambda start, stop, channels: values[channels, start:stop]


def select_channels(recording: Recording, channels) -> Recording:
    """Return the recording of some channels (n,) only, in the order given."""
    channels = frozen_array(channels, np.int64)
    return replace(
        recording,
        count=len(channels),
        block=lambda start, stop, chosen: recording.block(start, stop, channels[chosen]),
        names=tuple(recording.names[n] for n in channels),
        positions=None if recording.positions is None else recording.positions[channels],
    )


def read_samples(recording: Recording, start: int, stop: int, channels=None) -> np.ndarray:
    """Return samples `start` to `stop` (exclusive) of all channels, or of some (n,) : (n, stop - start) float64."""
    channels = np.arange(recording.count) if channels is None else np.asarray(channels, np.int64)
    values = np.asarray(recording.block(start, stop, channels))
    if values.shape != (len(channels), stop - start):
        raise InputError(f"{recording.path} is truncated between the samples {start} and {stop}", "copy it again")
    values = values.astype(float)
    # both comparisons are False for NaN
    if not (np.max(values, initial=0) <= LIMITS.strongest and np.min(values, initial=0) >= -LIMITS.strongest):
        row, column = np.argwhere(~(np.abs(values) <= LIMITS.strongest))[0]
        name, wrong = recording.names[channels[row]], values[row, column]
        what = f"{wrong:.3g}, too large for a sound" if np.isfinite(wrong) else "not a finite number"
        problem = f'{recording.path}: sample {start + int(column)} of channel "{name}" is {what}'
        raise InputError(problem, f"repair the file, or leave out the channel: <leave_out> {name}", key="leave_out")
    return values


def ranges(count: int, step: int) -> Iterator[tuple[int, int]]:
    """Yield (start, stop) of successive ranges of length `step` that cover `count` items."""
    for first in range(0, count, max(1, step)):
        yield first, min(first + max(1, step), count)


def in_memory(recording: Recording, takes: int = 1) -> Recording:
    """Return the recording in memory, with the precision of its file; return one that is too long for that unchanged.

    takes : number of recordings of this length that are in memory together
    """
    if takes * recording.count * recording.samples > 4 * GROUP_SAMPLES:
        return recording
    every = np.arange(recording.count)
    blocks = (recording.block(*at, every) for at in ranges(recording.samples, BLOCK_SAMPLES // recording.count))
    return replace(recording, block=block_of(np.concatenate(list(blocks), axis=1)))


def channel_groups(recording: Recording) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield channels (n,) and all of their samples (n, T), a few channels at a time."""
    for first, last in ranges(recording.count, GROUP_SAMPLES // recording.samples):
        channels = np.arange(first, last)
        yield channels, read_samples(recording, 0, recording.samples, channels)


@dataclass(frozen=True)
class ImportLimits:
    """Defaults and limits of an import."""

    # low, high: default band, Hz, of an array of unknown or large radius
    low: float = 20.0
    high: float = 500.0
    phase: float = 7.0  # largest k R of the default band of a small array, radians; solvers fail with larger ones
    # least k R of the default band, radians; below it the gains of the channels differ more than the pressures
    min_phase: float = 0.13
    min_periods: float = 4.0  # periods of the lowest frequency in a recording, by default
    max_frequency: float = 0.45  # highest frequency of a band, relative to the sampling rate
    celsius: float = 20.0  # default temperature, degrees Celsius
    known_radius_factor: float = 1.2  # assumed radius of an array relative to that of its known microphones
    coherent_radius_factor: float = 1.25  # assumed radius of an array relative to the estimate from its coherence


IMPORT_LIMITS = ImportLimits()


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """How a recording is imported; with None the file or fdcal chooses.

    Attributes
    ----------
    frequencies : str
        "auto" or "LO:HI", Hz.
    windows : str
        "auto", "none" or "LO:HI", Hz: band of the short windows, which are used with at most 32 microphones, or 64 in a
        plane.
    kind : str
        "auto", or one of `fdcal.recordings.recording.KINDS`.
    max_rows : int or None
        Largest number of rows of all takes together; each take has one at least. A row is one pressure of every
        microphone at one frequency of one take. The default is that of
        `fdcal.recordings.frequencies.default_max_rows`.
    temperature : float or None
        Air temperature, degrees Celsius, from which the sound speed follows.
    sound_speed : float or None
        Sound speed, m/s, instead of a temperature.
    source : int, str or None
        Number, from 0, of the source to use in a file with several; "all" makes a take of each of them.
    files : str
        Whether several files are "takes" of the same channels, or "channels" of one take; "auto" stands for channels if
        every file has one channel, and for takes otherwise.
    split : float or None
        Length of the takes into which a stationary recording is cut, s.
    dimension : int
        Dimension of the sound field, 2 or 3.
    array_dimension : int or None
        Number of coordinates of a microphone, 2 or 3. The default is 2 if the heights of all microphones are known and
        equal, or if short windows show that the array is flat.
    subset, leave_out, known : str or None
        See `fdcal.recordings.channels`.
    reference : str or None
        File with the signal that the source emitted.
    rate : float or None
        Sampling rate, Hz, for a file that does not contain one.
    array_radius : float or None
        Radius of the array, metres, from which the highest usable frequency follows.
    """

    # In the order in which `fdcal import --help` lists them; the command line declares the last three.
    frequencies: str = option("auto", "Band from which frequencies are chosen, Hz.", "auto|LO:HI")
    # the bound limits time and memory; it is five times the default for 32 microphones
    max_rows: Annotated[int, within(1, 2000)] | None = option(
        None, "Largest number of frequencies, all takes together.  [default: 112 to 800]", "M"
    )
    kind: Literal["auto", Kind] = option(
        "auto", "impulse: an impulse response, from silence to silence; stationary: a continuous sound."
    )
    windows: str = option("auto", "Band of the additional short windows, Hz; none: no windows.", "auto|none|LO:HI")
    temperature: Annotated[float, within(-60, 80, "degrees Celsius")] | None = option(
        None, "Air temperature, degrees Celsius; determines the sound speed.", "C"
    )
    # the bounds include heavy gases and solids
    sound_speed: Annotated[float, within(100, 6000, "m/s")] | None = option(None, "Sound speed, m/s.", "M/S")
    dimension: Literal[2, 3] = option(3, "Dimension of the sound field: 3 in a room, 2 in a plate.")
    array_dimension: Literal[2, 3] | None = option(None, "2 if the array is plane, else 3.  [default: detected]")
    subset: str | None = option(None, "Use only these microphones, e.g. 0,3,8:12, or ::4 for every fourth.", "I,J,...")
    leave_out: str | None = option(None, "Leave out these channels; bad: all that are faulty.", "NAMES|bad")
    known: str | None = option(None, "Known microphones: names, or a table name,x,y[,z].", "NAMES|none|FILE")
    reference: str | None = option(None, "Signal that the source emitted, for deconvolution.", "FILE.wav")
    rate: Annotated[float, within(100.0, 1e7, "Hz")] | None = option(
        None, "Sampling rate, Hz, for a file that does not contain one.", "HZ"
    )
    array_radius: Annotated[float, positive("m")] | None = option(
        None, "Radius of the array, metres; determines the highest usable frequency.", "R"
    )
    source: int | str | None = None
    files: Literal["auto", "takes", "channels"] = "auto"
    split: Seconds | None = None

    def __post_init__(self):
        object.__setattr__(self, "known", None if self.known == "none" else self.known)
        check(self)
        if isinstance(self.source, str) and self.source != "all":
            raise InputError(f'source = "{self.source}" is not a source', "use a number from 0, or all", key="source")
        if self.split is not None and (self.kind == "impulse" or self.reference):
            problem = f"split = {self.split:.3g} s is for a stationary recording without a reference"
            raise InputError(problem, "leave out <split>, or record each take separately", key="split")
        if self.reference and self.kind == "stationary":
            raise InputError("kind = stationary uses no reference", "leave out <reference> or <kind>", key="kind")
        if self.array_dimension == 3 and self.dimension == 2:
            raise InputError("array_dimension = 3 needs dimension = 3", "use 2", key="array_dimension")
        if self.temperature is not None and self.sound_speed is not None:
            remedy = "give one of <temperature> and <sound_speed>"
            raise InputError("a temperature and a sound speed are both given", remedy, key="sound_speed")

    def speed(self, in_file: float | None) -> tuple[float, str]:
        """Return the sound speed, and where its value comes from.

        Parameters
        ----------
        in_file : float or None
            Speed that the file states, m/s; None if it states none.

        Returns
        -------
        speed : float
            m/s.
        source : str
            Where the value comes from, in words.
        """
        if self.sound_speed is not None:
            return self.sound_speed, "as given"
        if self.temperature is None and in_file is not None:
            return in_file, "according to the file"
        if self.temperature is not None:
            return sound_speed(self.temperature), f"at {self.temperature:g} degrees Celsius"
        assumed = IMPORT_LIMITS.celsius
        return sound_speed(assumed), f"at an assumed temperature of {assumed:g} degrees Celsius"


def number_in(text: str) -> float:
    """Return the number in a text, or NaN if it is not a number."""
    try:
        return float(text)
    except ValueError:
        return math.nan
