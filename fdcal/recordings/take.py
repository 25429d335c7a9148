"""Record a take: sound from a sound card, or from a file instead, is written to a file while its channels are checked.

`SoundStream` gives the sound in blocks. `record_take` writes them and asks after each whether to continue. If a take
ends early, because of the user or a fault, what was recorded remains as a valid file.
"""

import queue
import sys
from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..model.libraries import needs
from ..model.storage import write_atomically
from ..model.validation import InputError, StorageError
from . import formats
from .channels import ChannelHealth, ChannelWatch
from .formats.sound import open_for_writing, require_whole_rate
from .recording import MIN_SAMPLES, ranges, read_samples, select_channels

SUFFIXES = (".wav", ".w64")  # endings of files that a take is written to
WAV_BYTES = 4e9  # largest size of a WAV file
BLOCK = 0.1  # s, length of a block of sound
PATIENCE = 5.0  # s; a sound card that gives no block for so long counts as disconnected
FULL_SCALE = 2.0**31  # full scale of the whole numbers that a sound card delivers
REPLAY = "or replay a recording: <replay>"

Block = tuple[np.ndarray, bool]  # samples (N, t), and whether samples were lost before them


@dataclass(frozen=True)
class SoundStream:
    """Sound of N channels that arrives in blocks."""

    name: str  # name of the sound card or the file
    sample_rate: float  # Hz
    names: tuple[str, ...]  # (N,) of the channels
    full_scale: float | None  # greatest value that a sample can take
    blocks: Callable[[], Generator[Block, None, None]]  # opens the stream; closing the iterator closes it


@dataclass(frozen=True, eq=False)
class Take:
    """A take that was recorded."""

    path: Path
    seconds: float
    sample_rate: float  # Hz
    names: tuple[str, ...]  # (N,) of the channels
    health: ChannelHealth
    gaps: int = 0  # how often samples were lost, in all channels alike
    stopped: bool = False  # whether the user ended it early
    fault: str = ""  # the error that ended it early, if any

    @property
    def text(self) -> str:
        """What was recorded, in words."""
        names, bad = self.names, self.health.bad
        faults = "; ".join(f"channel {names[n]}: {self.health.fault(n, names)}" for n in bad)
        parts = [f"{self.path}: {self.seconds:.3g} s at {self.sample_rate:g} Hz, {len(names)} channels"]
        parts.append(faults or "none of them is silent, clipped or a copy")
        if self.gaps:
            parts.append(f"samples were lost {self.gaps} times, in all channels alike: close other programs")
        if self.fault:
            parts.append(f"it ended early: {self.fault}")
        return "; ".join(parts) + ("; stopped early, and kept" if self.stopped else "")


def sound_card(channels: int | None = None, rate: float | None = None, device: str | None = None) -> SoundStream:
    """Return the stream of the first `channels` inputs of a sound card, all unless given.

    `rate`: Hz, that of the card unless given; `device`: name of the card, a part of it, or its number. Do not call this
    function while something is recorded: it restarts PortAudio, which ends every stream.
    """
    loaded = "sounddevice" in sys.modules
    try:
        sd = needs("sounddevice")
    except InputError as error:
        raise InputError(error.problem, f"{error.remedy}; {REPLAY}", key="device") from error
    except OSError as error:  # on Linux the package sounddevice does not contain PortAudio
        remedy = f"install it: apt-get install libportaudio2, {REPLAY}"
        raise InputError(f"no sound card can be reached ({error})", remedy, key="device") from error
    chosen = int(device) if device is not None and device.isdigit() else device
    try:
        if loaded:  # PortAudio finds cards only when it starts; a restart finds those connected since
            sd._terminate()
            sd._initialize()
        card = sd.query_devices(chosen, "input")
        count, fs = channels or int(card["max_input_channels"]), float(rate or card["default_samplerate"])
        if count > card["max_input_channels"]:
            problem = f'the sound card "{card["name"]}" has {card["max_input_channels"]} inputs, not {count}'
            raise InputError(problem, "give fewer <channels>, or another <device>", key="channels")
        sd.check_input_settings(device=chosen, channels=count, samplerate=fs, dtype="int32")
    except (sd.PortAudioError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        which = "with inputs" if device is None else f'"{device}"'
        remedy = f"{'give another <rate>' if rate else 'connect it'}, {REPLAY}"
        raise InputError(f"no sound card {which} can record this ({error})", remedy, key="device") from error

    def blocks() -> Generator[Block, None, None]:
        arrived: queue.SimpleQueue[Block] = queue.SimpleQueue()  # integers, since a float may be NaN
        size = round(BLOCK * fs)
        try:
            with sd.InputStream(
                device=chosen, channels=count, samplerate=fs, dtype="int32", blocksize=size, latency="high",
                callback=lambda samples, _frames, _time, status: arrived.put(
                    (samples.T.copy(), bool(status.input_overflow))
                ),
            ):  # fmt: skip
                while True:
                    samples, lost = arrived.get(timeout=PATIENCE)
                    yield samples / FULL_SCALE, lost
        except queue.Empty:
            raise StorageError(f'the sound card "{card["name"]}" has stopped delivering sound') from None
        except sd.PortAudioError as error:
            raise StorageError(f'the sound card "{card["name"]}" fails: {error}') from error

    return SoundStream(card["name"], fs, tuple(map(str, range(count))), 1.0, blocks)


def replayed(
    path: str | Path, channels: int | None = None, wait: Callable[[float], object] = lambda seconds: None
) -> SoundStream:
    """Return a recording as a stream.

    `channels`: number of channels to replay, beginning with the first; `wait`: called before each block with its
    length, seconds.
    """
    recording = formats.read(path)
    if channels is not None and channels > recording.count:
        raise InputError(f"{path} has only {recording.count} channels", "give fewer <channels>", key="channels")
    recording = select_channels(recording, np.arange(channels or recording.count))

    def blocks() -> Generator[Block, None, None]:
        for start, stop in ranges(recording.samples, round(BLOCK * recording.sample_rate)):
            wait((stop - start) / recording.sample_rate)
            yield read_samples(recording, start, stop), False

    return SoundStream(str(path), recording.sample_rate, recording.names, recording.full_scale, blocks)


def check_take(stream: SoundStream, path: Path, seconds: float) -> None:
    """Raise InputError if a file of this name cannot hold `seconds` of a stream."""
    count, width = len(stream.names), 3 if stream.full_scale else 4
    if path.suffix.lower() == ".wav" and round(seconds * stream.sample_rate) * count * width > WAV_BYTES:
        problem = f"{count} channels of {seconds:g} s at {stream.sample_rate:g} Hz exceed the 4 GB of a WAV file"
        raise InputError(problem, f"write {path.stem}.w64, or give fewer <seconds>", key="seconds")
    require_whole_rate(stream.sample_rate)


def next_take(path: Path) -> Path:
    """Return the path of the next take: the name of `path` with the next number that no take has."""
    stem = path.stem.rstrip("0123456789")
    digits = path.stem[len(stem) :]
    number = int(digits or 1)
    while True:
        number += 1
        free = path.with_name(f"{stem}{number:0{len(digits)}d}{path.suffix}")
        if not any(free.with_suffix(suffix).exists() for suffix in (path.suffix, *SUFFIXES)):
            return free


def record_take(
    stream: SoundStream,
    path: str | Path,
    seconds: float,
    watch: Callable[[float, ChannelHealth], bool] = lambda seconds, health: True,
    force: bool = False,
) -> Take:
    """Record a take of at most `seconds` to a file of 24 bits, or of floats if the stream has no full scale.

    `watch`: called after each block with the seconds and the state of the channels so far; returns whether to continue.
    What was recorded is kept even if the stream fails.
    """
    path, wanted, count = Path(path), round(seconds * stream.sample_rate), len(stream.names)
    check_take(stream, path, seconds)
    channels, done, gaps, stopped, fault = ChannelWatch(count), 0, 0, False, ""

    def write(temporary: Path) -> None:
        nonlocal done, gaps, stopped, fault
        subtype = "PCM_24" if stream.full_scale else "FLOAT"
        with (
            open_for_writing(temporary, stream.sample_rate, count, subtype) as file,
            closing(stream.blocks()) as blocks,
        ):
            try:
                for samples, lost in blocks:
                    block = np.asarray(samples[:, : wanted - done], float)
                    file.write(block.T)
                    channels.add(block)
                    done, gaps = done + block.shape[1], gaps + lost
                    stopped = not watch(done / stream.sample_rate, channels.health(stream.full_scale))
                    if stopped or done >= wanted:
                        break
            except KeyboardInterrupt:
                stopped = True
            except (InputError, OSError, RuntimeError) as error:  # libsndfile raises RuntimeError when the disk is full
                fault = str(error)
        if done < MIN_SAMPLES:
            why = fault or ("it was stopped before any sound came" if stopped else "the stream is empty")
            raise InputError(f"nothing was recorded: {why}", key="output")

    write_atomically(path, write, force)
    return Take(
        path, done / stream.sample_rate, stream.sample_rate, stream.names, channels.health(stream.full_scale), gaps,
        stopped and done < wanted, fault,
    )  # fmt: skip
