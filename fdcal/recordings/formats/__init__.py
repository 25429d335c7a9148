"""File formats: each module has a tuple `FORMATS` of those that it reads or writes. To add a format, add a module.

Some readers use a C library that may crash on a damaged file. They run in a separate process (`read_apart`). It returns
a recording of up to `MAX_HELD` samples as a whole; each block of a longer recording is read by a new process.
"""

import importlib
import pkgutil
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from ...model.libraries import isolated_call, needs
from ...model.measurement import MicrophonePositions
from ...model.storage import damaged, require_regular
from ...model.validation import InputError, StorageError, shown
from ..recording import Recording, block_of

NUMBERS = re.compile(r"([0-9]+)")  # the numbers in the name of a file
MAX_SAMPLES_PER_BYTE = 2000  # no compression of sound reaches this; a header that states more is damaged


Read = Callable[[Path, int | None, float | None], Recording]


@dataclass(frozen=True)
class Format:
    """A file format: its suffixes, and the functions that read or write it; None where fdcal has no such function."""

    suffixes: tuple[str, ...]
    # reads a file: path, number of the source (from 0; None is the first), sampling rate, Hz, of a file without one
    read: Read | None = None
    write: Callable[[Path, MicrophonePositions], None] | None = None  # writes positions to a file
    source_count: Callable[[Path], int] | None = None  # number of sources in a file of a format that may hold several
    recognises: Callable[[Path], bool] = lambda path: False  # where the suffix does not identify the format


@cache
def all_formats() -> tuple[Format, ...]:
    """Return the formats of every module of this folder."""
    found = (importlib.import_module(f"{__name__}.{module.name}") for module in pkgutil.iter_modules(__path__))
    return tuple(one for module in found for one in module.FORMATS)


def suffixes(what: str) -> list[str]:
    """Return the suffixes of the formats that fdcal can read or write; `what`: "read" or "write"."""
    return sorted(suffix for one in all_formats() if getattr(one, what) for suffix in one.suffixes)


def reader_of(path: str | Path) -> Format | None:
    """Return the format that can read `path`, by its suffix or the files in a folder; None if there is none."""
    path = Path(path)
    for one in all_formats():
        if (one.read and path.suffix.lower() in one.suffixes and not path.is_dir()) or one.recognises(path):
            return one
    return None


def sound_files(path: str | Path) -> list[Path]:
    """Return the sound files of a folder in natural order of their names; [] for a folder that is itself a format."""
    path = Path(path)
    if not path.is_dir() or reader_of(path) is not None:
        return []
    sound = next(one.suffixes for one in all_formats() if ".wav" in one.suffixes)
    # Hidden files are ignored: a Mac adds a file "._NAME" to each file on a disk of another system.
    files = (one for one in path.iterdir() if not one.name.startswith(".") and one.is_file())
    found = [one for one in files if one.suffix.lower() in sound]
    # Sort by the stem, so that Audacity's "Audio Track" precedes "Audio Track-2".
    return sorted(found, key=lambda one: [int(x) if n % 2 else x for n, x in enumerate(NUMBERS.split(one.stem))])


def read(path: str | Path, source: int | None = None, rate: float | None = None) -> Recording:
    """Return the recording in a file or folder.

    `source`: which of several sources, from 0; `rate`: sampling rate, Hz, of a file that has none.
    """
    path = Path(path)
    try:
        require_regular(path)
        found = reader_of(path)
        if found is None or found.read is None:
            known = f"give {', '.join(suffixes('read'))} or a folder"
            raise InputError("fdcal cannot read the format of this file", known)
        if source and found.source_count is None:
            raise InputError(f"source = {source} does not exist", "the file has one source only, 0", key="source")
        if path.is_file():
            with open(path, "rb"):  # reports a missing permission, for which libraries raise various exceptions
                pass
        recording = found.read(path, source, rate)
        if rate is not None and recording.sample_rate != rate:
            own = f"the file states a sampling rate of {recording.sample_rate:g} Hz"
            raise InputError(own, "leave out <rate>", key="rate")
        if path.is_file() and recording.count * recording.samples > MAX_SAMPLES_PER_BYTE * path.stat().st_size:
            problem = f"its header states {recording.count} channels of {recording.samples} samples"
            raise InputError(f"{problem}, but it has {path.stat().st_size} bytes", "it is damaged: copy it again")
        return recording
    except InputError as error:
        raise error.within(path) from error
    except StorageError:
        raise
    except OSError as error:
        raise StorageError(f"cannot read {path}: {error.strerror or error}") from error


def wanted_source(source: int | None, count: int) -> int:
    """Return the number of the wanted source, 0 for None; raise InputError if the file does not have this source."""
    source = source or 0
    if not 0 <= source < count:
        raise InputError(f"source = {source} does not exist", f"the file has sources 0 to {count - 1}", key="source")
    return source


def source_count(path: str | Path) -> int:
    """Return the number of sources in a file or folder; 1 for a file without a reader, which `read` reports."""
    path = Path(path)
    found = reader_of(path) if path.exists() else None
    return found.source_count(path) if found and found.source_count else 1


def write(path: Path, placed: MicrophonePositions) -> None:
    """Write positions in the format that the suffix of the file selects."""
    next(one.write for one in all_formats() if one.write and path.suffix.lower() in one.suffixes)(path, placed)


MAX_HELD = 4_000_000  # samples of all channels, 32 MB as float64


def read_apart(read: Read, path: Path, source: int | None = None, rate: float | None = None) -> Recording:
    """Return the result of `read`, called in a separate process; it must be defined at the top level of a module."""
    by_call = partial(isolated_call, path, _content, partial(read, path, source, rate), MAX_HELD)
    found, values = by_call()
    return Recording(**found, block=by_call if values is None else block_of(values))


def _content(read: Callable[[], Recording], max_held: int, *part: Any) -> Any:
    """Return the fields of a recording and, if there are at most `max_held`, its samples; with `part`, only a block."""
    found = read()
    if part:
        return found.block(*part)
    held = found.count * found.samples <= max_held
    values = found.block(0, found.samples, np.arange(found.count)) if held else None
    return {key: value for key, value in vars(found).items() if key != "block"}, values


def require_whole_file(path: Path) -> None:
    """Raise InputError for a damaged HDF5 file, or for one whose links or data are in another file."""
    h5py = needs("h5py")

    links: list[tuple[bytes, int]] = []
    with damaged(f"{path} is not a readable HDF5 file"), h5py.File(path, "r") as file:
        file.id.links.visit(lambda name, link: links.append((name, link.type)), info=True)
        reason = ""
        for link, kind in links:
            name = shown(link.decode(errors="replace"), 80)
            data: Any = file[link] if kind == h5py.h5l.TYPE_HARD else None
            if kind == h5py.h5l.TYPE_EXTERNAL:
                target = file.id.links.get_val(link)[0].decode(errors="replace")
                reason = f'"{name}" is a link to {shown(target, 80)}'
            elif isinstance(data, h5py.Dataset) and data.external:
                reason = f'"{name}" has its values in {shown(data.external[0][0], 80)}'
            elif isinstance(data, h5py.Dataset) and data.is_virtual:
                reason = f'"{name}" is a virtual dataset, with its values in other datasets'
    if reason:
        raise InputError(f"{path}: {reason}, and fdcal reads no other file", "write the values into the file itself")
