"""Throughput of a study beside a bare loop, and the memory of its driver.

FDCAL_BENCH_TASKS : calibrations of the throughput, 600 unless given; 10,000 take about an hour
"""

import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from fdcal.session.process import one_blas_thread
from fdcal_bench.run import Results, connected, run_study
from fdcal_bench.study import Study, load_study
from fdcal_bench.tasks import run_task

from .report import Figure

ALONE = True
WORKERS = 2
PLANNED = 100_000  # draws of the study that measures the memory of the driver; only some are computed
SECONDS = 20.0  # duration of that study
TEXT = """
scene = "tiny"
draws = {draws}
[axes]
snr_db = [20, 30, 40]
"solver.modes" = [12, 20]
"""


class Enough(Exception):
    """Ends a run after some seconds."""


def study_of(folder: Path, draws: int) -> Study:
    path = folder / f"study-{draws}.toml"
    path.write_text(TEXT.format(draws=draws))
    return load_study(path)


def megabytes() -> float:
    """Return the resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def bare_rate(study: Study, count: int) -> float:
    """Return the calibrations per second of one process that runs them one after the other."""
    with one_blas_thread():
        run_task(study, 0)
        began = time.perf_counter()
        for number in range(count):
            run_task(study, number)
    return count / (time.perf_counter() - began)


def run() -> Iterator[Figure]:
    count = int(os.environ.get("FDCAL_BENCH_TASKS", "600"))
    with tempfile.TemporaryDirectory() as name, connected(WORKERS, None) as client:
        folder = Path(name)
        study = study_of(folder, count // 6)
        warm = study_of(folder, 4)
        run_study(warm, Results(folder / "warm", warm, False), client)
        bare = bare_rate(study, max(50, count // 6))
        began = time.perf_counter()
        run_study(study, Results(folder / "out", study, False), client)
        rate = study.count / (time.perf_counter() - began) / WORKERS
        ratio = rate / bare
        yield Figure(f"{study.count} calibrations: a worker over a bare loop", ratio, "", ">= 0.8", ratio >= 0.8)
        yield Figure("a bare loop", bare, "1/s")
        yield from driver_memory(study_of(folder, PLANNED // 6), folder, client)


def driver_memory(study: Study, folder: Path, client) -> Iterator[Figure]:
    before, began = megabytes(), time.perf_counter()

    def progress(done: float, note: str) -> None:
        if time.perf_counter() - began > SECONDS:
            raise Enough

    try:
        run_study(study, Results(folder / "planned", study, False), client, progress)
    except Enough:
        pass
    grown = megabytes() - before
    yield Figure(f"growth of the driver, {study.count} draws planned", grown, "MB", "<= 200 MB", grown <= 200)
