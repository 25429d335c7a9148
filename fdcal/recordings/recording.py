"""What N microphones recorded, with samples read only when they are needed: the common form of every file format.

A recording is of one of two kinds:

impulse      an impulse response, a clap or a whole sweep: it starts in silence and lasts until the sound is gone, or is
             cut off while the room still rings
stationary   a part of a continuous sound, such as noise, music, speech or a machine
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..model.validation import LIMITS, InputError, frozen_array, require_array, require_positive

KINDS = ("impulse", "stationary")
ZERO_CELSIUS = 273.15  # K
GROUP_SAMPLES = 16_000_000  # samples held in memory at a time: 128 MB as float64
BLOCK_SAMPLES = GROUP_SAMPLES // 4  # of a block of all channels
RANGE_SAMPLES = 500_000  # samples read at a time from a file with interleaved channels, so that they fit a CPU cache


Block = Callable[[int, int, np.ndarray], np.ndarray]  # reads samples of the channels (n,) int64
SAMPLE_RATES = (100.0, 1e7)  # Hz
MAX_CHANNELS = 10_000
MIN_SAMPLES = 16  # of a channel
SHORTER = 0.05  # fraction by which the channels of one take may be shorter than the longest; the rest is left out
SAME_PLACE = 1e-3  # distance of two positions of one microphone that are the same, metres


@dataclass(frozen=True)
class Recording:
    """N channels of T samples."""

    path: str  # what messages call it
    kind: str | None  # one of KINDS; None where the file does not say
    sample_rate: float  # Hz
    # count, samples: N and T
    count: int
    samples: int
    block: Block
    names: tuple[str, ...] = ()  # each different; "0", "1", ... unless given
    positions: np.ndarray | None = None  # (N, D) float64 or None, of the microphones according to the file, metres
    sound_speed: float | None = None  # according to the file, m/s
    full_scale: float | None = None  # greatest value that a sample can take
    # up to which the samples represent the sound, Hz, if below what the sampling rate allows
    highest: float | None = None
    modelled: str = ""  # what is modelled, not measured, as a sentence; "" for a recording that is all measured

    def __post_init__(self):
        low, high = SAMPLE_RATES
        if not low <= self.sample_rate <= high:
            span = f"between {low:g} Hz and {high / 1e6:g} MHz"
            problem = f"{self.path}: sampling rate = {self.sample_rate:g} Hz must be {span}"
            raise InputError(problem, key="sample_rate", value=self.sample_rate)
        if not 1 <= self.count <= MAX_CHANNELS:
            problem = f"{self.path}: {self.count} channels cannot be used"
            raise InputError(problem, f"give 1 to {MAX_CHANNELS}", key="count")
        if self.samples < MIN_SAMPLES:
            problem = f"{self.path} holds {self.samples} samples per channel, which is too short for a recording"
            raise InputError(problem, f"give {MIN_SAMPLES} or more", key="samples", value=self.samples)
        if self.sound_speed is not None:
            require_positive(f"{self.path}: sound speed", self.sound_speed, "m/s")
        names = tuple(self.names) or tuple(str(n) for n in range(self.count))
        if len(names) != self.count or len(set(names)) < len(names):
            raise InputError(f"{self.path}: its channels must have {self.count} different names", key="names")
        object.__setattr__(self, "names", names)
        if self.positions is not None:
            places = require_array(f"{self.path}: positions", self.positions, "real", (self.count, None), "m")
            object.__setattr__(self, "positions", places)

    @property
    def duration(self) -> float:
        """Seconds."""
        return self.samples / self.sample_rate


def sound_speed(celsius: float) -> float:
    """Return the speed of sound in dry air, m/s: proportional to the square root of the temperature (ISO 9613-1)."""
    return 343.2 * math.sqrt((celsius + ZERO_CELSIUS) / 293.15)


def recording_of(path: str, kind: str | None, sample_rate: float, values, **others) -> Recording:
    """Return a recording of an array (N, T) that is in memory or memory-mapped; the others are of `Recording`."""

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
    """Return the samples `start` to `stop`, without the last, of all channels, or some (n,) : (n, stop - start)."""
    channels = np.arange(recording.count) if channels is None else np.asarray(channels, np.int64)
    values = np.asarray(recording.block(start, stop, channels))
    if values.shape != (len(channels), stop - start):
        problem = f"{recording.path} is truncated: some of the samples {start} to {stop} are missing"
        raise InputError(problem, "copy the file again")
    values = values.astype(float)
    usable = np.abs(values) <= LIMITS.strongest  # False for NaN
    if not np.all(usable):
        row, column = np.argwhere(~usable)[0]
        name, wrong = recording.names[channels[row]], values[row, column]
        what = f"{wrong:.3g}, too large for a sound" if np.isfinite(wrong) else "not a finite number"
        problem = f'{recording.path}: sample {start + int(column)} of channel "{name}" is {what}'
        remedy = f"repair the file, or leave out the channel: <leave_out> {name}"
        raise InputError(problem, remedy, key="leave_out", value=name)
    return values


def ranges(count: int, step: int) -> Iterator[tuple[int, int]]:
    """Yield the beginnings and ends of ranges of `step` that make up a count."""
    for first in range(0, count, max(1, step)):
        yield first, min(first + max(1, step), count)


def in_memory(recording: Recording, max_samples: int = 4 * GROUP_SAMPLES) -> Recording:
    """Return the recording held in memory as float32 if it has at most `max_samples`, else as it is."""
    if recording.count * recording.samples > max_samples:
        return recording
    values = np.empty((recording.count, recording.samples), dtype=np.float32)
    for start, stop in ranges(recording.samples, BLOCK_SAMPLES // recording.count):
        values[:, start:stop] = read_samples(recording, start, stop)
    return replace(recording, block=block_of(values))


def channel_groups(recording: Recording) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield channels (n,) and all of their samples (n, T), a few channels at a time."""
    for first, last in ranges(recording.count, GROUP_SAMPLES // recording.samples):
        channels = np.arange(first, last)
        yield channels, read_samples(recording, 0, recording.samples, channels)


def join_channels(files: Sequence[Recording]) -> Recording:
    """Return the channels of files that recorded at the same time as one recording, named after the files."""
    shortest, longest = (pick(files, key=lambda one: one.samples) for pick in (min, max))
    other = next((one for one in files if one.sample_rate != files[0].sample_rate), None)
    if other is not None:
        problem = f"{files[0].path} has {files[0].sample_rate:g} Hz and {other.path} {other.sample_rate:g} Hz"
        problem += ", and the channels of one take need one sampling rate"
        remedy = "convert one of them, from a recording that was made at the same time"
        raise InputError(problem, remedy, key="sample_rate")
    if shortest.samples < (1 - SHORTER) * longest.samples:
        problem = f"{shortest.path} lasts {shortest.duration:.3g} s and {longest.path} {longest.duration:.3g} s"
        problem += ": they are not channels of one take"
        raise InputError(problem, "give files that were recorded at the same time, of one length", key="files")
    owner = np.repeat(np.arange(len(files)), [one.count for one in files])
    local = np.concatenate([np.arange(one.count) for one in files])

    def block(start: int, stop: int, channels: np.ndarray) -> np.ndarray:
        values = np.empty((len(channels), stop - start))
        for number in np.unique(owner[channels]):
            rows = np.flatnonzero(owner[channels] == number)
            values[rows] = files[number].block(start, stop, local[channels[rows]])
        return values

    def common(key: str):
        values = [getattr(one, key) for one in files]
        return values[0] if all(value == values[0] for value in values) else None

    # Each channel is named after its file, with its folder where files have the same name.
    stems = [Path(one.path).stem for one in files]
    if len(set(stems)) < len(stems):
        stems = [f"{Path(one.path).parent.name}/{stem}" for one, stem in zip(files, stems, strict=True)]
    pairs = zip(files, stems, strict=True)
    names = tuple(stem if one.count == 1 else f"{stem}.{name}" for one, stem in pairs for name in one.names)
    placed = [one.positions for one in files if one.positions is not None]
    rest = f" and {len(files) - 1} other {'file' if len(files) == 2 else 'files'}"
    return Recording(
        f"{files[0].path}{rest if len(files) > 1 else ''}",
        common("kind"),
        files[0].sample_rate,
        len(owner),
        shortest.samples,
        block,
        names=names,
        positions=np.concatenate(placed) if len(placed) == len(files) else None,
        sound_speed=common("sound_speed"),
        full_scale=common("full_scale"),
        highest=min((one.highest for one in files if one.highest is not None), default=None),
    )


def split(recording: Recording, seconds: float, min_seconds: float) -> list[Recording]:
    """Return parts of `seconds`, not less than `min_seconds`; a remainder below half a part is joined to the last."""
    if seconds < min_seconds:
        problem = f"split = {seconds:.3g} s is too short for a mean over segments of {recording.path}"
        raise InputError(problem, f"use {min_seconds:.3g} s or more", key="split", value=seconds)
    length = int(seconds * recording.sample_rate)
    starts = list(range(0, recording.samples, length))
    if len(starts) > 1 and recording.samples - starts[-1] < max(length / 2, min_seconds * recording.sample_rate):
        starts.pop()
    if len(starts) < 2:
        problem = f"split = {seconds:.3g} s leaves {recording.path}, {recording.duration:.3g} s, in one part"
        longest = recording.duration / 1.5
        remedy = f"use {longest:.3g} s or less" if longest >= min_seconds else "leave out <split>"
        raise InputError(problem, remedy, key="split", value=seconds)
    return [_part(recording, a, b) for a, b in zip(starts, [*starts[1:], recording.samples], strict=True)]


def _part(recording: Recording, first: int, last: int) -> Recording:
    fs = recording.sample_rate
    return replace(
        recording,
        path=f"{recording.path}, {first / fs:.4g} to {last / fs:.4g} s",
        kind="stationary",
        samples=last - first,
        block=lambda start, stop, channels: recording.block(first + start, first + stop, channels),
    )
