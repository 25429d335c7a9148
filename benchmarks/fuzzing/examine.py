"""How a reader handles broken files: one case, and many. `python -m benchmarks.fuzzing.examine NAME FIRST COUNT`."""

import contextlib
import json
import resource
import signal
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fdcal.model.validation import InputError, StorageError

from .readers import READERS, Reader

SECONDS = 10  # of processor time for one file
WAIT = 120  # s for one file on any clock, for a reader that waits for something
KILOBYTES = 1_000_000  # by which memory may grow
LONGEST = 2000  # characters of a message


class Hang(Exception):
    """A file took too long."""


@contextlib.contextmanager
def _alarm() -> Iterator[None]:
    def ring(*_):
        raise Hang(f"more than {SECONDS} s of processor time, or {WAIT} s in all")

    before = {number: signal.signal(number, ring) for number in (signal.SIGALRM, signal.SIGPROF)}
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    signal.setitimer(signal.ITIMER_REAL, WAIT)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)


def fault_of(reader: Reader, path: Path) -> str:
    """Return what is wrong with how `reader` handles the file; "" if it reads it, or refuses it in one line."""
    before, memory = sorted(path.parent.iterdir()), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        with _alarm():
            reader.read(path)
    except (InputError, StorageError) as error:
        if len(str(error)) > LONGEST + 10 * len(str(path)) or "\n" in str(error):
            return f"no one line: {str(error)[:200]!r}"
    except Exception:
        return traceback.format_exc(limit=-3)
    if resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory > KILOBYTES:
        return "more than 1 GB"
    return "" if sorted(path.parent.iterdir()) == before else "files are left behind"


def faults(name: str, first: int, count: int) -> list[str]:
    """Return the faults of a reader in the cases `first` to `first + count - 1`; each is its seed."""
    reader, found = READERS[name], []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"file{reader.suffix}"
        reader.make(path)
        good = path.read_bytes()
        if fault := fault_of(reader, path):
            return [f"{name}: the file that is not broken: {fault}"]
        for case in range(first, first + count):
            path.write_bytes(reader.mutate(good, np.random.default_rng([case, *name.encode()])))
            if fault := fault_of(reader, path):
                found.append(f"{name}, case {case}: {fault}")
    return found


def faults_apart(name: str, first: int, count: int) -> list[str]:
    """Return `faults`, computed in a separate process, because a C library may crash."""
    command = [sys.executable, "-m", "benchmarks.fuzzing.examine", name, str(first), str(count)]
    run = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[2])
    if run.returncode:
        return [f"{name}, cases {first} to {first + count - 1}: the process ended with {run.returncode}: {run.stderr}"]
    return json.loads(run.stdout.splitlines()[-1])


if __name__ == "__main__":
    print(json.dumps(faults(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))))
