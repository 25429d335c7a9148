"""`python -m fdcal ...` and the command `fdcal`.

Loading the libraries takes a moment; an interrupt during that time ends the process with one line, like any other
interrupt.
"""

import io
import os
import signal
import sys
from types import FrameType

# bytes of address space. A small calibration needs half of it, the compiler the rest. With 150 MB the libraries hang
# while they load: a calibration of `tiny` had not ended after 120 s.
MIN_ADDRESS_SPACE = 1500 * 2**20


def main() -> None:
    """Load the command line and run it."""
    _require_streams()
    before = signal.signal(signal.SIGINT, _end_at_once)  # before anything is imported, which takes its time
    _require_address_space()
    from .commands.cli import main as run

    signal.signal(signal.SIGINT, _interrupted if before is signal.default_int_handler else before)
    run()


def _require_address_space() -> None:
    """End the process with one line where `ulimit -v` leaves too little."""
    try:
        import resource
    except ImportError:  # not on Windows, which has no such limit
        return
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and limit < MIN_ADDRESS_SPACE:
        sys.exit(f"error: fdcal needs {MIN_ADDRESS_SPACE >> 20} MB of address space; ulimit -v leaves {limit >> 20} MB")


def _interrupted(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, but end the process where a command loads a library and has no unfinished file."""
    loads, writes, inner = False, False, frame
    while inner is not None:
        loads = loads or inner.f_code.co_filename.startswith("<frozen importlib")
        writes = writes or inner.f_code.co_name == "write_atomically"
        inner = inner.f_back
    if loads and not writes:
        _end_at_once()
    signal.default_int_handler(number, frame)


def _end_at_once(*_) -> None:
    """End the process, because a library that is interrupted while it loads may raise any exception or ignore it."""
    os.write(2, b"error: interrupted; no incomplete file is left\n")
    os._exit(130)


def _require_streams() -> None:
    """Open closed standard streams, so that no other file gets their numbers and `print` does not fail."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free file number, which is this one
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, "w" if number else "r", encoding="utf-8", closefd=False))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # names of files may not be valid text


if __name__ == "__main__":
    main()
