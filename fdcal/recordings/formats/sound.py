"""Files of samples with interleaved channels, one per microphone, that libsndfile reads: .wav, .flac, ..."""

import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from ...model.validation import InputError
from ..recording import RANGE_SAMPLES, Recording, ranges
from . import Format

# What libsndfile logs about a chunk longer than the file: of WAV, AIFF, AU, W64 and RF64.
LENGTH = re.compile(
    r"^\s*(?:data|SSND|data\s*chunk|Data Size|riff|Riff size)\s*:\s*(\d+)\s*\(should be (\d+)\)", re.MULTILINE
)
UNKNOWN_LENGTH = 0xFFFFFFFF  # of an .au file written to a pipe


def _name(path: Path) -> Any:
    """The name as bytes, which libsndfile opens whatever their encoding; its type stubs know texts only."""
    return os.fsencode(path)


def _read_sound(path: Path, source: int | None = None) -> Recording:
    """Return the recording of a sound file, read in pieces; raise InputError for a file that is damaged."""
    import soundfile

    try:
        with soundfile.SoundFile(_name(path)) as file:
            channels, samples, rate = file.channels, file.frames, file.samplerate
            log, seekable = file.extra_info, file.seekable()
            whole = "FLOAT" not in file.subtype and file.subtype != "DOUBLE"
    except (RuntimeError, ValueError) as error:  # LibsndfileError is one of the first
        # soundfile puts the name of the file before the reason, as Python writes bytes
        reason = str(getattr(error, "error_string", error)) if path.stat().st_size else "the file is empty"
        raise InputError(f"{path} is not a sound file that can be read: {reason}") from error
    if not seekable or samples >= 2**62:
        raise InputError(f"the length of {path} is unknown", "convert it to WAV or FLAC")
    note = LENGTH.search(log)
    if note and int(note[2]) < int(note[1]) != UNKNOWN_LENGTH:
        problem = f"{path} is truncated: its header announces {note[1]} bytes of sound, {note[2]} are there"
        raise InputError(problem, "copy it again")

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

    return Recording(str(path), None, float(rate), channels, samples, block, full_scale=1.0 if whole else None)


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


FORMATS = (Format((".wav", ".flac", ".w64", ".rf64", ".aiff", ".aif", ".caf", ".au"), read=_read_sound),)
