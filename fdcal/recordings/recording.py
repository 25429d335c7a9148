"""What N microphones recorded, read when it is needed: what every format is turned into.

Recording   channels of samples and what the file tells of them
select      some of its channels
groups      all samples of a few channels at a time

A `response` is complete: it starts in silence and lasts until the sound is gone or is cut off while the room rings on,
as an impulse response, a clap or a whole sweep does. A recording at `work` is a piece out of a sound that goes on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..model.validation import InputError, frozen_array, require_array, require_positive

KINDS = ("response", "work")
ZERO_CELSIUS = 273.15  # K
GROUP_SAMPLES = 16_000_000  # samples held at a time: 128 MB as float64
PIECE_SAMPLES = 500_000  # likewise, of a file where channels lie side by side: what a processor keeps at hand
MOST_CHANNELS = 10_000
RATES = 100.0, 1e7  # Hz, what a sampling rate may be


@dataclass(frozen=True)
class Recording:
    """N channels of T samples.

    Attributes
    ----------
    path : str, what messages call it
    kind : "response", "work", or None where the file does not say
    sample_rate : Hz
    count, samples : N and T
    block : callable(start, stop, channels) -> (len(channels), stop - start) float array; `channels` (n,) int64
    names : (N,) tuple of str, each different; "0", "1", ... unless given
    positions : (N, D) float64, metres, or None; where the file says that the microphones are
    sound_speed : m/s, or None
    full_scale : greatest value that a sample can take, or None where there is none

    Raises InputError for a number that cannot be.
    """

    path: str
    kind: str | None
    sample_rate: float
    count: int
    samples: int
    block: Callable[[int, int, np.ndarray], np.ndarray]
    names: tuple[str, ...] | None = None
    positions: np.ndarray | None = None
    sound_speed: float | None = None
    full_scale: float | None = None

    def __post_init__(self):
        if not RATES[0] <= self.sample_rate <= RATES[1]:
            raise InputError(
                f"{self.path}: sampling rate = {self.sample_rate:g} Hz cannot be; {RATES[0]:g} to {RATES[1]:g} Hz can"
            )
        if not 1 <= self.count <= MOST_CHANNELS:
            raise InputError(f"{self.path}: {self.count} channels cannot be used; give 1 to {MOST_CHANNELS}")
        if self.samples < 16:
            raise InputError(f"{self.path} holds {self.samples} samples a channel, which is no recording; give more")
        if self.sound_speed is not None:
            require_positive(f"{self.path}: sound speed", self.sound_speed, "m/s")
        names = tuple(str(n) for n in range(self.count)) if self.names is None else tuple(self.names)
        if len(names) != self.count or len(set(names)) < len(names):
            raise InputError(f"{self.path}: its channels must have {self.count} different names")
        object.__setattr__(self, "names", names)
        if self.positions is not None:
            places = require_array(f"{self.path}: positions", self.positions, "real", (self.count, None), "m")
            object.__setattr__(self, "positions", places)

    @property
    def duration(self) -> float:
        """Seconds."""
        return self.samples / self.sample_rate


def sound_speed(celsius: float) -> float:
    """Speed of sound in dry air, m/s; it goes with the square root of the temperature (ISO 9613-1)."""
    return 343.2 * math.sqrt((celsius + ZERO_CELSIUS) / 293.15)


def recording_of(path: str, kind: str | None, sample_rate: float, values, **told) -> Recording:
    """Recording of an array (N, T) that is in memory, or mapped into it."""

    def block(start: int, stop: int, channels: np.ndarray) -> np.ndarray:
        return values[channels, start:stop]

    return Recording(path, kind, float(sample_rate), *map(int, values.shape), block, **told)


def select_channels(recording: Recording, channels) -> Recording:
    """The recording of some channels (n,), in the order given."""
    channels = frozen_array(channels, np.int64)

    def block(start: int, stop: int, chosen: np.ndarray) -> np.ndarray:
        return recording.block(start, stop, channels[chosen])

    return replace(
        recording,
        count=len(channels),
        block=block,
        names=tuple(recording.names[n] for n in channels),
        positions=None if recording.positions is None else recording.positions[channels],
    )


def read_samples(recording: Recording, start: int, stop: int, channels=None) -> np.ndarray:
    """Samples `start` to `stop` of some channels, all unless given : (n, stop - start) float64.

    Raises InputError for a sample that is no finite number, or samples that are missing.
    """
    channels = np.arange(recording.count) if channels is None else np.asarray(channels, np.int64)
    values = np.asarray(recording.block(start, stop, channels))
    if values.shape != (len(channels), stop - start):
        raise InputError(
            f"{recording.path} is truncated: samples {start} to {stop} are not all there; copy the file again"
        )
    values = values.astype(float)
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        name, sample = recording.names[channels[bad[0][0]]], start + int(bad[0][1])
        raise InputError(
            f'{recording.path}: sample {sample} of channel "{name}" is not a finite number; mend it, or leave the'
            f" channel out: --leave-out {name}"
        )
    return values


def sample_ranges(samples: int, channels: int) -> Iterator[tuple[int, int]]:
    """First and last of the stretches in which to read `samples` of a file where channels lie side by side."""
    step = max(1, PIECE_SAMPLES // channels)
    for first in range(0, samples, step):
        yield first, min(first + step, samples)


def in_memory(recording: Recording, most: int = 4 * GROUP_SAMPLES) -> Recording:
    """The recording in memory, as float32, if its samples are not too many; else as it is."""
    if recording.count * recording.samples > most:
        return recording
    values = np.empty((recording.count, recording.samples), dtype=np.float32)
    start = 0
    for part in time_blocks(recording):
        values[:, start : start + part.shape[1]] = part
        start += part.shape[1]

    def block(start: int, stop: int, channels: np.ndarray) -> np.ndarray:
        return values[channels, start:stop]

    return replace(recording, block=block)


def channel_groups(recording: Recording, most: int = GROUP_SAMPLES) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Channels (n,) and all of their samples (n, T), a few channels at a time."""
    step = max(1, most // recording.samples)
    for first in range(0, recording.count, step):
        channels = np.arange(first, min(first + step, recording.count))
        yield channels, read_samples(recording, 0, recording.samples, channels)


def time_blocks(recording: Recording, most: int = GROUP_SAMPLES // 4) -> Iterator[np.ndarray]:
    """All channels, a stretch of samples (N, t) at a time, in order."""
    step = max(1, most // recording.count)
    for start in range(0, recording.samples, step):
        yield read_samples(recording, start, min(start + step, recording.samples))
