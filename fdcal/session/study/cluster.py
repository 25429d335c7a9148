"""Run a study on Dask: a local cluster of processes, or a scheduler by its address.

Tasks are submitted in batches, a few for each worker at a time, so that a study of any length takes little memory. A
batch whose worker dies is computed again by another (Dask does that).
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any

from ...model.libraries import missing_library
from ...model.validation import InputError
from .definition import Study
from .results import Results

if TYPE_CHECKING:
    from distributed import Client


@dataclass(frozen=True)
class Pace:
    """How tasks are submitted and results written."""

    batch_seconds: float = 1.0  # duration of a batch that is aimed at, s
    max_batch: int = 200  # tasks of a batch at most
    ahead: int = 3  # batches for each worker that are submitted and not finished
    write_seconds: float = 3.0  # results are written so often, s
    write_rows: int = 2000  # or when so many have come
    connect_seconds: float = 10.0  # a scheduler must answer within this time, s


PACE = Pace()


@contextmanager
def connected(workers: int, scheduler: str | None) -> Iterator[Client]:
    """Give a client of Dask: of a scheduler by its address, or of a local cluster of processes of one thread each."""
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise missing_library(error) or error from error
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=PACE.connect_seconds)
        except (OSError, ValueError, TimeoutError) as error:
            remedy = "start one with `dask scheduler`, and give its address as tcp://HOST:8786"
            raise InputError(f"no scheduler answers at {scheduler}", remedy, key="scheduler") from error
        with client:
            yield client
        return
    cluster = LocalCluster(
        n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0", silence_logs=logging.ERROR
    )
    with cluster, Client(cluster) as client:
        yield client


def run_study(
    study: Study,
    results: Results,
    client: Client,
    progress: Callable[[float, str], None] | None = None,
) -> int:
    """Compute the calibrations of a study that its folder lacks, write each row once, and return how many they were."""
    with results.held():
        return _run(study, results, client, progress)


def _run(study: Study, results: Results, client: Client, progress) -> int:
    from distributed import as_completed

    done = results.done()
    before, tasks = len(done), study.tasks(done)
    rows: list[dict[str, Any]] = []
    finished, written, size = 0, time.monotonic(), 1
    threads: Any = client.nthreads()
    width = max(1, sum(threads.values()))
    completed = as_completed(with_results=True)
    for batch in _batches(tasks, size, PACE.ahead * width):
        completed.add(client.submit(run_batch, study, batch, pure=False))
    try:
        for future, (batch_rows, seconds) in completed:
            future.release()
            rows += batch_rows
            finished += len(batch_rows)
            wanted = PACE.batch_seconds * len(batch_rows) / max(seconds, 1e-6)
            size = int(min(max(1, wanted), 2 * len(batch_rows), PACE.max_batch))
            for batch in _batches(tasks, size, 1):
                completed.add(client.submit(run_batch, study, batch, pure=False))
            if len(rows) >= PACE.write_rows or time.monotonic() - written > PACE.write_seconds:
                results.append(rows)
                rows, written = [], time.monotonic()
            if progress is not None:
                progress((before + finished) / study.count, f"{before + finished} of {study.count}")
    finally:
        results.append(rows)
    return finished


def _batches(tasks: Iterator[int], size: int, count: int) -> Iterator[list[int]]:
    for _ in range(count):
        batch = list(islice(tasks, size))
        if not batch:
            return
        yield batch


def run_batch(study: Study, numbers: list[int]) -> tuple[list[dict[str, Any]], float]:
    """Return the rows of some tasks, and the seconds that they took; it runs in a worker."""
    from ..blas_threads import one_blas_thread
    from .task import run_task

    began = time.monotonic()
    with one_blas_thread():
        rows = [run_task(study, number) for number in numbers]
    return rows, time.monotonic() - began


def expected_seconds(study: Study, workers: int, samples: int = 3) -> float:
    """Return how long a study is expected to take, s, from a few calibrations spread over its points.

    A first calibration is not counted: it simulates the room and loads compiled code, which the others share.
    """
    from .task import run_task

    run_task(study, 0)
    numbers = [round(i * (study.count - 1) / max(samples - 1, 1)) for i in range(samples)]
    began = time.monotonic()
    for number in numbers:
        run_task(study, number)
    return (time.monotonic() - began) / len(numbers) * study.count / workers
