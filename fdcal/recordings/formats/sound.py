"""Files of samples with interleaved channels, one per microphone, that libsndfile reads: .wav, .flac, ...

The length in a header may be wrong: a program that writes to a pipe does not know it, and some count their header.
libsndfile reads such a file to its end, with a remark here; a file that announces no sound at all is refused.
"""

import logging
import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from ...model.validation import InputError
from ..recording import RANGE_SAMPLES, Recording, ranges
from . import Format

# What libsndfile logs about a chunk longer than the file: of WAV, AIFF, AU, W64 and RF64.
LENGTH = re.compile(r"^\s*(?:data|SSND|data\s*chunk|Data Size|riff)\s*:\s*(\d+)\s*\(should be (\d+)\)", re.MULTILINE)
LENGTH_64 = re.compile(r"^\s*Data size : (\d+)$", re.MULTILINE)  # of RF64
# Bytes of sound by which a program says that it did not know them: sox, ALSA, ffmpeg, 64-bit formats.
UNKNOWN = (range(0x7FFFF000, 0x80000001), range(0xFFFFF000, 0x100000000), range(2**62, 2**64))
LONGEST = 2**36 - 1  # samples of a FLAC file
CONVERT = "copy it again, or convert it: ffmpeg -i FILE NEW.wav"

log = logging.getLogger(__name__)


def _name(path: Path) -> Any:
    """The name as bytes, which libsndfile opens whatever their encoding; its type stubs know texts only."""
    return os.fsencode(path)


def _read_sound(path: Path, source: int | None = None, rate: float | None = None) -> Recording:
    """Return the recording of a sound file, read in pieces; raise InputError for a file that is damaged."""
    import soundfile

    try:
        opened = soundfile.SoundFile(_name(path))
    except (RuntimeError, ValueError) as error:  # LibsndfileError is one of the first
        # soundfile puts the name of the file before the reason, as Python writes bytes
        reason = str(getattr(error, "error_string", error)) if path.stat().st_size else "the file is empty"
        raise InputError(f"{path} is not a sound file that can be read: {reason}", CONVERT) from error
    with opened as file:
        channels, samples, hertz = file.channels, file.frames, file.samplerate
        note, note_64, seekable = LENGTH.search(file.extra_info), LENGTH_64.search(file.extra_info), file.seekable()
        whole = "FLOAT" not in file.subtype and file.subtype != "DOUBLE"
    if not seekable or not 0 < samples <= LONGEST:
        raise InputError(f"the length of {path} is unknown", CONVERT)
    size = path.stat().st_size
    announced, there = (int(note[1]), int(note[2])) if note else (int(note_64[1]) if note_64 else 0, size)
    if announced > size and not any(announced in unknown for unknown in UNKNOWN):  # it may count the header
        problem = f"{path} is truncated: its header announces {announced} bytes of sound, {there} are there"
        raise InputError(problem, "copy it again")
    if note:
        log.warning("%s: the length in its header is not that of the file, which is read to its end", path)

    def block(start: int, stop: int, chosen: np.ndarray) -> np.ndarray:
        dtype = "float32" if whole else "float64"
        values = np.empty((len(chosen), stop - start), dtype=dtype)
        try:
            with soundfile.SoundFile(_name(path)) as file:
                file.seek(start)
                for first, last in ranges(stop - start, RANGE_SAMPLES // channels):
                    part = file.read(last - first, dtype=dtype, always_2d=True)
                    values[:, first:last] = part.T[chosen]  # raises where the file ends too soon
        except (RuntimeError, ValueError, IndexError) as error:
            raise InputError(f"{path} is truncated near sample {start}: {error}", "copy the file again") from error
        return values

    return Recording(str(path), None, float(hertz), channels, samples, block, full_scale=1.0 if whole else None)


SUFFIXES = (".wav", ".w64", ".rf64", ".aiff", ".caf", ".au")  # of files that can hold 32-bit floats


def require_whole_rate(rate: float) -> None:
    """Raise InputError for a sampling rate, Hz, that a sound file cannot have."""
    if rate != round(rate):
        raise InputError(f"a sound file has no sampling rate of {rate} Hz", "resample the recording")


def open_for_writing(path: Path, rate: float, channels: int, subtype: str = "FLOAT"):
    """Open a sound file of 32-bit floats, or of another subtype of libsndfile; a rate is a whole number."""
    import soundfile

    require_whole_rate(rate)
    return soundfile.SoundFile(_name(path), "w", round(rate), channels, subtype)


READ = (
    ".wav .wave .bwf .rf64 .w64 .flac .aiff .aif .aifc .caf .au .snd .ogg .oga .opus .mp3 .sph .nist .voc .paf"
    " .pvf .avr .htk .iff .8svx .svx .sds .sf .ircam .mpc .xi .wve"
)
FORMATS = (Format(tuple(READ.split()), read=_read_sound),)
