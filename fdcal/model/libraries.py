"""Libraries that may be missing, and libraries that may crash, hang, use up the memory or leave files open.

If a library is missing, `needs` names the extra of fdcal that installs it. `call` runs a function in a process of its
own, which ends after the call; starting it takes 0.15 s and the time of the function's imports.
"""

import contextlib
import importlib
import os
import pickle
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

from .validation import InputError, shown

LIBRARY = {"PIL": "pillow", "mpl_toolkits": "matplotlib", "vtkmodules": "vtk"}  # distributions of these packages
REQUIREMENT = re.compile(r"""([\w.-]+).*; extra == ['"](\w+)['"]""")


def missing_library(error: ImportError) -> InputError | None:
    """Return the error for a library of an extra that is not installed; None for any other ImportError."""
    package = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    library, brought = LIBRARY.get(package, package), dict[str, set[str]]()  # libraries by extra
    for line in metadata.requires("fdcal") or ():
        if found := REQUIREMENT.match(line):
            brought.setdefault(found[2], set()).add(found[1].lower())
    extras = [extra for extra in brought if library.lower() in brought[extra]]
    if not extras:
        return None
    extra = min(extras, key=lambda one: len(brought[one]))  # the smallest extra that installs it
    return InputError(
        f'this needs the library "{library}" of the extra "{extra}"',
        f"install it: pip install -e '.[{extra}]' in a checkout of fdcal, pip install 'fdcal[{extra}]' elsewhere",
    )


def needs(name: str) -> ModuleType:
    """Import a library; if it is missing, raise InputError that says how to install it."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise missing_library(error) or error from error


class ProcessError(OSError):
    """A process ended without a result, or reached a limit; the text gives the reason in one line."""


def call(
    function: Callable[..., Any],
    *arguments: Any,
    seconds: float = 120.0,
    processor_seconds: int | None = None,
    memory: int | None = None,
) -> Any:
    """Call a function in a process of its own; return its result, or raise the InputError or OSError that it raises.

    The function is pickled and must therefore be defined at the top level of a module. Raises ProcessError if the
    process crashes or exceeds a limit: `seconds` of wall-clock time, `processor_seconds`, or `memory`, bytes of address
    space.
    """
    package = str(Path(__file__).resolve().parents[2])
    paths = os.pathsep.join(filter(None, [package, os.environ.get("PYTHONPATH")]))
    try:
        child = subprocess.run(
            [sys.executable, "-P", "-m", __name__],  # -P: no module is taken from the working directory
            input=pickle.dumps((processor_seconds, memory)) + pickle.dumps((function, arguments)),
            capture_output=True,
            timeout=seconds,
            env={**os.environ, "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"},
        )
    except subprocess.TimeoutExpired:
        raise ProcessError(f"it takes more than {seconds:g} s") from None
    except OSError as error:
        raise ProcessError(f"no process can be started: {error}") from error
    if child.returncode == -signal.SIGXCPU:
        raise ProcessError(f"it takes more than {processor_seconds} s of processor time")
    if child.returncode < 0:
        raise ProcessError(f"the library that it needs crashed, {signal.Signals(-child.returncode).name}")
    if child.returncode:  # the last line has the reason
        lines = child.stderr.decode(errors="replace").strip().splitlines() or [f"exit status {child.returncode}"]
        if memory is not None and "MemoryError" in lines[-1].split(":")[0]:
            raise ProcessError(f"it takes more than {memory / 1e9:g} GB of memory")
        raise ProcessError(shown(lines[-1], 200))
    result, error = pickle.loads(child.stdout)
    if error is not None:
        raise error
    return result


PROCESSOR_SECONDS = 60  # largest processor time of one call
SECONDS = 600.0  # largest wall-clock time of one call, long because a disk on a network may be slow
BYTES = 4_000_000_000  # largest address space of the process


def isolated_call(path: str | Path, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function in a process of its own and return its result; if it fails, raise InputError with `path`."""
    try:
        return call(function, *arguments, seconds=SECONDS, processor_seconds=PROCESSOR_SECONDS, memory=BYTES)
    except ProcessError as error:
        raise InputError(f"{path} cannot be read: {error}", "copy it again, or write shorter files") from error


def main() -> None:
    """Call the function that is read from standard input, and write its result or its error to standard output."""
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # a library must not print into the result
    processor_seconds, memory = pickle.load(sys.stdin.buffer)
    with contextlib.suppress(ImportError, OSError, ValueError):  # some systems do not have these limits
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if processor_seconds is not None:
            resource.setrlimit(resource.RLIMIT_CPU, (processor_seconds, processor_seconds + 5))
        if memory is not None:
            resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    function, arguments = pickle.load(sys.stdin.buffer)
    try:
        answer = function(*arguments), None
    except (InputError, OSError) as error:
        causes = error.__cause__, getattr(error.__cause__, "__cause__", None)
        if any(isinstance(cause, MemoryError) for cause in causes):
            raise MemoryError from error
        answer = None, error
    with output:
        pickle.dump(answer, output, protocol=pickle.HIGHEST_PROTOCOL)
    os._exit(0)  # skips the usual clean-up, in which a library may crash if its file is damaged


if __name__ == "__main__":
    main()
