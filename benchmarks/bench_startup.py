"""How long a user waits: for `import fdcal`, and for the page of a scene whose recordings are in the disk cache."""

from __future__ import annotations

import os
import subprocess
import sys
import time

from .report import Figure

IMPORT = "import time; start = time.perf_counter(); import fdcal; print(time.perf_counter() - start)"
EVERYTHING = IMPORT.replace(
    "import fdcal", "import fdcal, fdcal.model.scene, fdcal.model.measurement, fdcal.session.session"
)


def import_time(code: str = IMPORT, repeats: int = 5) -> float:
    """Shortest of several fresh interpreters, seconds; NumPy's own import is part of it where it happens."""
    runs = [
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True) for _ in range(repeats)
    ]
    return min(float(run.stdout) for run in runs)


def serving_time(scene: str) -> float:
    """From starting `fdcal view` to its printed address, seconds."""
    start = time.perf_counter()
    command = [sys.executable, "-m", "fdcal", "view", scene, "--port", "0", "--no-browser"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=os.environ
    ) as viewer:
        line = viewer.stdout.readline()
        elapsed = time.perf_counter() - start
        viewer.terminate()
    if not line.startswith("http"):
        raise RuntimeError(f"fdcal view {scene} printed {line!r} in place of its address")
    return elapsed


def run() -> list[Figure]:
    alone, with_rooms = import_time(), import_time(EVERYTHING)
    first = serving_time("array1_circle")
    second = min(serving_time("array1_circle") for _ in range(2))
    return [
        Figure("import fdcal", alone, "s", "below 0.06", alone < 0.06),
        Figure("import fdcal with scene, measurement and session", with_rooms, "s"),
        Figure("first view of array1_circle in this run, until it serves", first, "s"),
        Figure("second view of array1_circle, until it serves", second, "s", "below 5", second < 5),
    ]
