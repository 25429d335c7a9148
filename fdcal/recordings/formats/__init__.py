"""File formats: every module here that can read recordings or write positions is a format.

A format has `SUFFIXES`, and

    read(path, source) -> Recording         if it holds recordings; `source` selects one of several, or is None
    source_count(path) -> int               if a file may hold several sources
    recognises(path) -> bool                optional: where the suffix alone does not identify the format
    render(path, names, positions, speed)   -> Recording of an array in the field of a measured room
    write(path, placed, original)           if it can hold positions (`MicrophonePositions`)

To add a format, add its module.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np

from ...model.given_positions import MicrophonePositions
from ...model.reading import require_regular
from ...model.validation import InputError, StorageError, install_remedy
from ..recording import Recording

MAX_SAMPLES_PER_BYTE = 2000  # no compression of sound reaches this: a header that announces more is damaged


@cache
def modules() -> tuple[ModuleType, ...]:
    """Return every format: the modules that have SUFFIXES; any other module of the folder is a helper of formats."""
    found = (importlib.import_module(f"{__name__}.{module.name}") for module in pkgutil.iter_modules(__path__))
    return tuple(module for module in found if hasattr(module, "SUFFIXES"))


def suffixes(what: str) -> list[str]:
    """Return the suffixes of the formats that can `what`: "read" or "write"."""
    return sorted(suffix for module in modules() if hasattr(module, what) for suffix in module.SUFFIXES)


def reader_of(path: str | Path) -> ModuleType | None:
    """Return the format that can read `path`, by its suffix or the files in a folder; None if there is none."""
    path = Path(path)
    for module in modules():
        if hasattr(module, "read") and path.suffix.lower() in module.SUFFIXES and not path.is_dir():
            return module
        if hasattr(module, "recognises") and module.recognises(path):
            return module
    return None


def read(path: str | Path, source: int | None = None) -> Recording:
    """Return the recording in a file or folder.

    `source`: which of several sources, from 0. Raises InputError: no format can read it, or it is damaged;
    StorageError: the file cannot be opened.
    """
    path = Path(path)
    try:
        if not path.exists():
            raise StorageError(f"cannot read {path}: No such file or directory")
        require_regular(path)
        module = reader_of(path)
        if module is None:
            raise InputError(
                f"{path} has no format that can be read", f"give {', '.join(suffixes('read'))} or a folder"
            )
        if source and not hasattr(module, "source_count"):
            raise InputError(
                f"source = {source} does not exist",
                f"{path} holds one source only, number 0",
                key="source",
                value=source,
            )
        if path.is_file():
            with open(path, "rb"):  # a missing permission is reported here: libraries raise anything for it
                pass
        recording = module.read(path, source)
        if path.is_file() and recording.count * recording.samples > MAX_SAMPLES_PER_BYTE * path.stat().st_size:
            raise InputError(
                f"{path} announces {recording.count} channels of {recording.samples} samples and holds"
                f" {path.stat().st_size} bytes: it is damaged or empty",
                "copy or write it again",
            )
        return recording
    except StorageError:
        raise
    except OSError as error:
        raise StorageError(f"cannot read {path}: {error.strerror or error}") from error


def source_count(path: str | Path) -> int:
    """Return the number of sources in a file or folder; 1 where nothing can read it, which `read` then reports."""
    path = Path(path)
    module = reader_of(path) if path.exists() else None
    return module.source_count(path) if module is not None and hasattr(module, "source_count") else 1


def render(path: str | Path, names: tuple[str, ...], positions: np.ndarray, sound_speed: float) -> Recording:
    """Return what an array would record in the measured room of a file.

    `positions` (N, 3) float64, relative to the point of the measurement, metres; `sound_speed`: m/s. Raises InputError:
    the file is damaged, or holds no measured room; StorageError: the file cannot be opened.
    """
    path = Path(path)
    module = reader_of(path) if path.exists() else None
    if path.exists() and not hasattr(module, "render"):
        raise InputError(
            f"{path} holds channels that were recorded; none can be rendered", "leave out <array>", key="array"
        )
    if module is None:
        raise StorageError(f"cannot read {path}: No such file or directory")
    return module.render(path, names, positions, sound_speed)


def write(path: str | Path, target: str | Path, placed: MicrophonePositions, original: str | None = None) -> None:
    """Write positions in the format that a suffix selects.

    `path`: the file to write, possibly a temporary one; `target`: the final name of the file, whose suffix selects the
    format; `original`: a file into a copy of which the positions are written, where the format can do so. Raises
    InputError: no format has this suffix, or the format cannot hold these positions.
    """
    suffix = Path(target).suffix.lower()
    for module in modules():
        if hasattr(module, "write") and suffix in module.SUFFIXES:
            module.write(Path(path), placed, original)
            return
    raise InputError(
        f'"{target}" ends in no suffix of a format for positions',
        f"use one of {', '.join(suffixes('write'))}",
        key="output",
        value=str(target),
    )


def needs(name: str, extra: str = "formats") -> ModuleType:
    """Return a library that comes with an extra; raise InputError with the way to install it where it is missing."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise InputError(f'this format needs the library "{name}"', install_remedy(extra)) from None
