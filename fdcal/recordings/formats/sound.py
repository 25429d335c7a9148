"""Files of samples with interleaved channels, one per microphone, that libsndfile reads: .wav, .flac, ...

The length in a header may be wrong: a program that writes to a pipe does not know it, a recorder that crashes does not
write it, and some programs include the header in it. Such a file is read to its end, with a remark.
"""

import contextlib
import io
import logging
import os
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ...model.validation import InputError
from ..recording import RANGE_SAMPLES, Recording, ranges
from . import Format

# What libsndfile logs about a chunk that is longer than the file, in WAV, AIFF, AU and W64.
LENGTH = re.compile(r"^\s*(?:data|SSND|data\s*chunk|Data Size|riff)\s*:\s*(\d+)\s*\(should be (\d+)\)", re.MULTILINE)
LENGTH_64 = re.compile(r"^\s*Data size : (\d+)$", re.MULTILINE)  # the length in RF64, to which it adds no other
# Lengths that programs write when they do not know the length: sox, ALSA, ffmpeg, 64-bit formats.
UNKNOWN = (range(0x7FFFF000, 0x80000001), range(0xFFFFF000, 0x100000000), range(2**62, 2**64))
READ_ON = "the length in its header is not that of the file, which is read to its end"
LONGEST = 2**36 - 1  # largest number of samples of a FLAC file
_name: Callable[[Path], Any] = os.fsencode  # a path as bytes, which libsndfile opens in any encoding
# Formats by their first bytes: number of bytes before the first chunk, and type of a chunk's length, which follows its
# name of four bytes.
CHUNKS = {b"RIFF": (12, "<I"), b"RF64": (12, "<I"), b"BW64": (12, "<I"), b"RIFX": (12, ">I"), b"caff": (8, ">q")}

log = logging.getLogger(__name__)


class Patched(io.FileIO):
    """A file in which some bytes are replaced when it is read; `changes`: the new bytes by their offset."""

    def __init__(self, path: Path, changes: dict[int, bytes]):
        super().__init__(path)
        self._changes = changes

    def __del__(self) -> None:  # soundfile does not close a file that it has not opened
        self.close()

    def readinto(self, buffer: Any) -> int:
        """Read into a buffer; return the number of bytes."""
        at, count = self.tell(), super().readinto(buffer) or 0
        view = memoryview(buffer).cast("B")
        for place, content in self._changes.items():
            first, last = max(at, place), min(at + count, place + len(content))
            if first < last:
                view[first - at : last - at] = content[first - place : last - place]
        return count


def _with_length(path: Path) -> dict[int, bytes]:
    """Return changes for `Patched` that make the sound end with the file; {} if sound is missing or none are known."""
    size = path.stat().st_size
    with open(path, "rb") as file:
        magic = file.read(4)
        if magic == b".snd":
            return {8: b"\xff" * 4}
        if magic == b"fLaC":  # the number of samples is the last 36 of these 64 bits
            file.seek(18)
            return {18: struct.pack(">Q", struct.unpack(">Q", file.read(8))[0] & ~LONGEST | _counted(path))}
        if magic not in CHUNKS:
            return {}
        at, form = CHUNKS[magic]
        wide = struct.calcsize(form)
        while at < size - 4 - wide:
            file.seek(at)
            name, length = file.read(4), struct.unpack(form, file.read(wide))[0]
            start = at + 4 + wide
            if name == b"data" and _cut_off(length, size - start, start):
                return {}
            if name == b"data" and magic == b"caff":
                return {at + 4: struct.pack(form, size - start)}
            if name == b"data":
                lengths = (struct.pack(form, min(one, 0xFFFFFFFF)) for one in (size - 8, size - start))
                return {0: b"RIFX" if magic == b"RIFX" else b"RIFF", 4: next(lengths), at + 4: next(lengths)}
            at = start + max(length, 0) + (length % 2 if wide == 4 else 0)
    return {}


def _cut_off(stated: int, size: int, before: int) -> bool:
    """Return whether sound is missing at the end of a file.

    stated : bytes of sound according to the header; size : bytes in the file from the beginning of the sound; before :
    bytes before the sound, which some programs include in the stated length
    """
    return before < stated - size and not any(stated in unknown for unknown in UNKNOWN)


def _counted(path: Path) -> int:
    """Return the number of samples of a file whose header does not state it, by reading all of them."""
    import soundfile

    class Forward(soundfile.SoundFile):
        def seekable(self):
            return False

    count = 0
    with Forward(_name(path)) as file:
        while read := len(file.read(RANGE_SAMPLES // file.channels, dtype="float32")):
            count += read
    return count


def _opened(path: Path, changes: dict[int, bytes]):
    import soundfile

    return soundfile.SoundFile(Patched(path, changes) if changes else _name(path))


def _read_sound(path: Path, source: int | None = None, rate: float | None = None) -> Recording:
    """Return the recording of a sound file, read in pieces; raise InputError for a file that is damaged."""
    with open(path, "rb") as file:  # libsndfile does not know BW64, which is RF64 under another name
        changes = {0: b"RF64"} if file.read(4) == b"BW64" else {}
    try:
        opened, fault, mended = _opened(path, changes), None, {}
    except (RuntimeError, ValueError) as error:  # LibsndfileError is a RuntimeError
        opened, fault, mended = None, error, {}
    with contextlib.suppress(RuntimeError, ValueError, struct.error):
        if (opened is None or not 0 < opened.frames <= LONGEST) and (mended := _with_length(path)):
            opened, changes = _opened(path, mended), mended
    if opened is None:
        # soundfile puts the name of the file before the reason, as Python writes bytes
        reason = str(getattr(fault, "error_string", fault)) if path.stat().st_size else "the file is empty"
        raise InputError(f"{path} is not a sound file that can be read: {reason}") from fault
    with opened as file:
        channels, samples, hertz = file.channels, file.frames, file.samplerate
        note, note_64, seekable = LENGTH.search(file.extra_info), LENGTH_64.search(file.extra_info), file.seekable()
        whole = "FLOAT" not in file.subtype and file.subtype != "DOUBLE"
        dtype = "float64" if file.subtype == "DOUBLE" else "float32"
    if not seekable or samples > LONGEST:
        raise InputError(f"the length of {path} is unknown", "convert it to WAV or FLAC")
    size = path.stat().st_size
    announced, there = (int(note[1]), int(note[2])) if note else (int(note_64[1]) if note_64 else 0, size)
    if _cut_off(announced, there, size - there):
        raise InputError(f"{path} is truncated: it has {there} of {announced} bytes of sound", "copy it again")
    if note or mended:
        log.warning("%s: %s", path, READ_ON)

    def block(start: int, stop: int, chosen: np.ndarray) -> np.ndarray:
        values = np.empty((len(chosen), stop - start), dtype=dtype)
        try:
            with _opened(path, changes) as file:
                file.seek(start)
                for first, last in ranges(stop - start, RANGE_SAMPLES // channels):
                    part = file.read(last - first, dtype=dtype, always_2d=True)
                    values[:, first:last] = part.T[chosen]  # raises where the file ends too soon
        except (RuntimeError, ValueError, IndexError) as error:
            raise InputError(f"{path} is truncated near sample {start}: {error}", "copy the file again") from error
        return values

    return Recording(str(path), None, float(hertz), channels, samples, block, full_scale=1.0 if whole else None)


def require_whole_rate(rate: float) -> None:
    """Raise InputError for a sampling rate, Hz, that a sound file cannot have."""
    if rate != round(rate):
        raise InputError(f"a sound file cannot have a sampling rate of {rate} Hz", "resample the recording")


def open_for_writing(path: Path, rate: float, channels: int, subtype: str = "FLOAT"):
    """Open a sound file of 32-bit floats, or of another subtype of libsndfile; `rate`: a whole number of Hz."""
    import soundfile

    require_whole_rate(rate)
    return soundfile.SoundFile(_name(path), "w", round(rate), channels, subtype)


READ = (
    ".wav .wave .bwf .bw64 .rf64 .w64 .flac .aiff .aif .aifc .caf .au .snd .ogg .oga .opus .mp3 .sph .nist .voc .paf"
    " .pvf .avr .htk .iff .8svx .svx .sds .sf .ircam .mpc .xi .wve"
)
FORMATS = (Format(tuple(READ.split()), read=_read_sound),)
