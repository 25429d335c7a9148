"""Readers whose C library a damaged file may crash, in a process of their own.

A recording of up to `MAX_HELD` samples comes back at once; of a longer one each block of samples is read by another
process.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..model import libraries as process
from ..model.validation import InputError
from .recording import Recording

PROCESSOR_SECONDS = 60  # for one call
SECONDS = 600.0  # likewise on any clock: a disk on a network may be slow
BYTES = 4_000_000_000  # of address space of the process
MAX_HELD = 4_000_000  # samples of all channels, 32 MB as float64


def call(path: str | Path, function: Callable[..., Any], *arguments: Any) -> Any:
    """Return what a function returns in a process of its own; InputError, which names `path`, where that fails."""
    try:
        return process.call(function, *arguments, seconds=SECONDS, processor_seconds=PROCESSOR_SECONDS, memory=BYTES)
    except process.LimitError as error:
        remedy = "it is too large, or damaged: divide it into shorter files, or write it as .wav or .npz"
        raise InputError(f"{path} cannot be read: {error}", remedy) from error
    except process.ProcessError as error:
        raise InputError(f"{path} cannot be read: {error}", "it is damaged: copy or write it again") from error


Read = Callable[[Path, int | None], Recording]


def isolated(read: Read) -> Read:
    """Return a reader that does what `read` does, a function of a module, in a process of its own."""

    def read_apart(path: Path, source: int | None = None) -> Recording:
        fields, values = call(path, _content, read, path, source, MAX_HELD)

        def block(start: int, stop: int, chosen: np.ndarray) -> np.ndarray:
            if values is not None:
                return values[chosen, start:stop]
            return call(path, _block, read, path, source, start, stop, chosen)

        return Recording(**fields, block=block)

    return read_apart


def _content(read: Read, path: Path, source: int | None, most: int) -> tuple[dict[str, Any], np.ndarray | None]:
    """Return the fields of a recording, except for its block, and its samples (N, T) if at `most` so many."""
    found = read(path, source)
    held = found.count * found.samples <= most
    values = found.block(0, found.samples, np.arange(found.count)) if held else None
    return {key: value for key, value in vars(found).items() if key != "block"}, values


def _block(read: Read, path: Path, source: int | None, start: int, stop: int, chosen: np.ndarray) -> np.ndarray:
    return read(path, source).block(start, stop, chosen)
