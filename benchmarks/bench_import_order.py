"""Whether a calibration is as fast after `import numpy` as after `import fdcal`, alone and with two at once.

Each child process calibrates array 1 several times after one that warms it; the orders take turns, so that another load
on the machine disturbs them alike. Processor time counts, because BLAS threads that spin cost it and waiting does not.
"""

import json
import os
import subprocess
import sys
from statistics import median

from .report import Figure

ORDERS = {"NumPy first": "import numpy, fdcal", "fdcal first": "import fdcal, numpy"}
ROUNDS = 5
VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
CODE = """
import json, time
from threadpoolctl import threadpool_info
measurement = fdcal.load("array1_circle")
fdcal.calibrate(measurement)
runs = []
for _ in range(5):
    wall, used = time.perf_counter(), time.process_time()
    fdcal.calibrate(measurement)
    runs.append((time.process_time() - used, time.perf_counter() - wall))
print(json.dumps([*map(min, zip(*runs)), max(one["num_threads"] for one in threadpool_info())]))
"""


def started(order: str) -> subprocess.Popen:
    """Start a child process whose environment limits nothing."""
    environment = {key: value for key, value in os.environ.items() if key not in VARIABLES}
    command = [sys.executable, "-c", ORDERS[order] + CODE]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)


def result(child: subprocess.Popen) -> list[float]:
    """Return processor time, wall time, s, and the BLAS threads that were left after the calibrations."""
    text, _ = child.communicate()
    if child.returncode:
        raise RuntimeError("a calibration failed in a child process")
    return json.loads(text)


def measured(at_once: int) -> dict[str, list[list[float]]]:
    """Return the results of each order, with `at_once` processes of it at a time."""
    runs: dict[str, list[list[float]]] = {order: [] for order in ORDERS}
    for _ in range(ROUNDS):
        for order in ORDERS:
            children = [started(order) for _ in range(at_once)]
            runs[order] += [result(child) for child in children]
    return runs


def compared(at_once: int, note: str) -> list[Figure]:
    figures, used = [], {}
    for order, runs in measured(at_once).items():
        used[order] = median(run[0] for run in runs)
        figures.append(Figure(f"array 1, {order}, {note}: processor time", used[order], "s"))
        figures.append(Figure(f"array 1, {order}, {note}: wall time", median(run[1] for run in runs), "s"))
    ratio = used["NumPy first"] / used["fdcal first"]
    figures.append(
        Figure(f"{note}: processor time, NumPy first over fdcal first", ratio, "", "0.9 to 1.1", 0.9 <= ratio <= 1.1)
    )
    return figures


def run() -> list[Figure]:
    result(started("NumPy first"))  # simulates and compiles
    return [*compared(1, "alone"), *compared(2, "two at once")]
