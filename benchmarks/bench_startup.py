"""How long a user waits: for a calibration as a process, for `import fdcal`, and for the page of a simulated scene."""

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from fdcal.acoustics.measure import cached_measurement
from fdcal.model.measurement import save_measurement
from fdcal.model.scene import load_scene

from .report import Figure

IMPORT = "import time; start = time.perf_counter(); import fdcal; print(time.perf_counter() - start)"
EVERYTHING = IMPORT.replace(
    "import fdcal", "import fdcal, fdcal.model.scene, fdcal.model.measurement, fdcal.session.session"
)


def import_time(code: str = IMPORT, repeats: int = 5) -> float:
    """Return the shortest import of several fresh interpreters, seconds, including the import of NumPy if it occurs."""
    runs = [
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True) for _ in range(repeats)
    ]
    return min(float(run.stdout) for run in runs)


def serving_time(scene: str) -> float:
    """Return the time from the start of `fdcal view` to its printed address, seconds."""
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


def calibration_times(folder: Path) -> tuple[float, float]:
    """Return the processor times, s, of a process that calibrates array 1: without compiled code, and with it."""
    path = folder / "array1.npz"
    with open(path, "wb") as file:
        save_measurement(cached_measurement(load_scene("array1_circle")), file)
    command = [sys.executable, "-m", "fdcal", "calibrate", str(path)]

    def processor_time(cache: str) -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, check=True, capture_output=True, env={**os.environ, "NUMBA_CACHE_DIR": cache})
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    cold = processor_time(str(folder / "compiled"))
    return cold, min(processor_time(str(folder / "compiled")) for _ in range(5))


def run() -> list[Figure]:
    with tempfile.TemporaryDirectory() as folder:
        cold, warm = calibration_times(Path(folder))
    alone, with_rooms = import_time(), import_time(EVERYTHING)
    first = serving_time("array1_circle")
    second = min(serving_time("array1_circle") for _ in range(2))
    return [
        Figure("calibrate array 1's .npz, nothing compiled before, processor", cold, "s", "at most 6", cold <= 6),
        Figure("calibrate array 1's .npz, warm, processor", warm, "s", "at most 1.2", warm <= 1.2),
        Figure("import fdcal", alone, "s", "below 0.06", alone < 0.06),
        Figure("import fdcal with scene, measurement and session", with_rooms, "s"),
        Figure("first view of array1_circle in this run, until it serves", first, "s"),
        Figure("second view of array1_circle, until it serves", second, "s", "below 5", second < 5),
    ]
