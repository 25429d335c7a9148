"""Other people's files: every module here that can read recordings or write positions is a format.

A format has a `NAME` and `SUFFIXES`, `SEVERAL` if a file of it may hold several sources, and

    read(path, source) -> Recording         if it holds recordings; `source` is the one wanted of several, or None
    recognises(path) -> bool                 optional: where the suffix alone does not tell
    write(path, placed, original)            if it can hold positions; see `fdcal.model.microphones.Placed`

To add a format, add its module.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from pathlib import Path
from types import ModuleType

from ...model.microphones import MicrophonePositions
from ...model.validation import InputError, StorageError
from ..recording import Recording

MOST_IN_A_BYTE = 2000  # samples: what no compression of sound reaches; a header that says more would be read for ever


@cache
def modules() -> tuple[ModuleType, ...]:
    """Every format: what has SUFFIXES; any other module of the folder is a helper of formats."""
    found = (importlib.import_module(f"{__name__}.{module.name}") for module in pkgutil.iter_modules(__path__))
    return tuple(module for module in found if hasattr(module, "SUFFIXES"))


def suffixes(what: str) -> list[str]:
    """Suffixes of the formats that can `what`: "read" or "write"."""
    return sorted(suffix for module in modules() if hasattr(module, what) for suffix in module.SUFFIXES)


def reader_of(path: str | Path) -> ModuleType | None:
    """The format that `path` is in, by folder or suffix; None if there is none."""
    path = Path(path)
    for module in modules():
        if hasattr(module, "read") and path.suffix.lower() in module.SUFFIXES and not path.is_dir():
            return module
        if hasattr(module, "recognises") and module.recognises(path):
            return module
    return None


def read(path: str | Path, source: int | None = None) -> Recording:
    """The recording in a file or folder.

    Raises
    ------
    InputError
        No format reads it, or its reader finds it damaged.
    StorageError
        The system refuses.
    """
    path = Path(path)
    try:
        if not path.exists():
            raise StorageError(f"cannot read {path}: there is no such file or folder")
        module = reader_of(path)
        if module is None:
            raise InputError(f"{path} is in no format that can be read; give {', '.join(suffixes('read'))} or a folder")
        if source and not getattr(module, "SEVERAL", False):
            raise InputError(f"--source {source} is not there; {path} holds one source alone, number 0")
        if path.is_file():
            with open(path, "rb"):  # libraries report a refusal as anything
                pass
        recording = module.read(path, source)
        if path.is_file() and recording.count * recording.samples > MOST_IN_A_BYTE * path.stat().st_size:
            raise InputError(
                f"{path} announces {recording.count} channels of {recording.samples} samples and holds"
                f" {path.stat().st_size} bytes; it is damaged or empty: copy or write it again"
            )
        return recording
    except StorageError:
        raise
    except OSError as error:
        raise StorageError(f"cannot read {path}: {error.strerror or error}") from error


def write(path: str | Path, target: str | Path, placed: MicrophonePositions, original: str | None = None) -> None:
    """Write positions to `path` in the format that the suffix of `target` names, the file's name to be."""
    suffix = Path(target).suffix.lower()
    for module in modules():
        if hasattr(module, "write") and suffix in module.SUFFIXES:
            module.write(Path(path), placed, original)
            return
    raise InputError(f'-o "{target}" ends in no suffix of positions; use one of {", ".join(suffixes("write"))}')


def needs(name: str, extra: str = "formats") -> ModuleType:
    """A library that comes with an extra. Raises InputError that tells how to get it."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise InputError(f'this format needs the library "{name}"; install it: pip install "fdcal[{extra}]"') from None
