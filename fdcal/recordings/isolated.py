"""Readers whose C library a damaged file may crash: a process of its own runs them, with limits of time and memory.

The process starts, reads one file and ends (0.15 to 0.3 s). A recording of up to `MAX_HELD` samples comes back at once;
of a longer one each block of samples is read by another process.
"""

import contextlib
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..model.validation import InputError, StorageError, shown
from .recording import Recording

PROCESSOR_SECONDS = 60  # for one call
SECONDS = 600.0  # likewise on any clock: a disk on a network may be slow
BYTES = 4_000_000_000  # of address space of the process
MAX_HELD = 4_000_000  # samples of all channels, 32 MB as float64


def call(path: str | Path, function: Callable[..., Any], *arguments: Any) -> Any:
    """Return what a function of a module returns for these arguments in a process of its own, or raise its error.

    InputError, which names the file at `path`, where the process ends or does not end in time.
    """
    package = str(Path(__file__).resolve().parents[2])
    paths = os.pathsep.join(filter(None, [package, os.environ.get("PYTHONPATH")]))
    try:
        child = subprocess.run(
            [sys.executable, "-m", __name__],
            input=pickle.dumps((function, arguments)),
            capture_output=True,
            timeout=SECONDS,
            env={**os.environ, "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"},
        )
    except subprocess.TimeoutExpired:
        raise InputError(f"{path} cannot be read in {SECONDS:g} s", "write it again") from None
    except OSError as error:
        raise StorageError(f"{path} cannot be read, no process can be started: {error}") from error
    if child.returncode:
        raise InputError(f"{path} cannot be read: {_reason(child)}", "it is damaged: copy or write it again")
    result, error = pickle.loads(child.stdout)
    if error is not None:
        raise error
    return result


def _reason(child: subprocess.CompletedProcess) -> str:
    """Return why the process ended, in one line."""
    if child.returncode == -signal.SIGXCPU:
        return f"the library that reads it takes more than {PROCESSOR_SECONDS} s"
    if child.returncode < 0:
        return f"the library that reads it crashed ({signal.Signals(-child.returncode).name})"
    lines = child.stderr.decode(errors="replace").strip().splitlines() or [f"exit status {child.returncode}"]
    return shown(lines[-1], 200)


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


def main() -> None:
    """Call the function that standard input holds, and write its result or its error to standard output."""
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no result
    with contextlib.suppress(ImportError, OSError, ValueError):  # of systems that have no such limit
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR_SECONDS, PROCESSOR_SECONDS + 5))
        resource.setrlimit(resource.RLIMIT_AS, (BYTES, BYTES))
    function, arguments = pickle.load(sys.stdin.buffer)
    try:
        answer = function(*arguments), None
    except (InputError, OSError) as error:
        answer = None, error
    with output:
        pickle.dump(answer, output, protocol=pickle.HIGHEST_PROTOCOL)
    os._exit(0)  # a damaged file may crash a library that closes


if __name__ == "__main__":
    main()
