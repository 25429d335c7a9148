"""Run a study on Dask, with its own processes or a given scheduler, and keep its rows in a folder.

The folder holds the study's definition and a table of Parquet files, each written completely or not at all. Tasks are
submitted in batches, a few for each worker at a time, so that a study of any length takes little memory. A batch whose
worker dies is computed again by another (Dask does that).
"""

from __future__ import annotations

import json
import logging
import secrets
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, NoReturn

import locket
import msgspec
import pandas
import pyarrow
from dask import config as dask_config
from distributed import Client, LocalCluster, as_completed
from distributed.security import Security
from msgspec import Meta
from pyarrow import parquet

from fdcal.model.storage import write_atomically
from fdcal.model.validation import InputError, StorageError, shown
from fdcal.session.process import one_blas_thread

from .code import CodeVersion
from .statistics import SCORES
from .study import Study, describe
from .tasks import own_code, run_task

log = logging.getLogger(__name__)

HEAD = "study.json"  # describes the study of this folder
ROWS = "rows"  # folder of the table, which `pandas.read_parquet` reads as a whole
PARTS = f"{ROWS}/part-*.parquet"
LOCK = "study.lock"  # held by the run that writes
COLUMNS = {  # columns of the table in addition to the axes; missing values are null
    "task": "int64",
    "draw": "int64",
    "seed": "int64",
    "version": "string",  # for these three see `CodeVersion`
    "source": "string",
    "commit": "string",
    "verdict": "string",
    "reason": "string",
    "rms_error_m": "float64",
    "max_error_m": "float64",
    "claimed_sigma_m": "float64",
    "bound_m": "float64",
    "microphones": "int64",
    "modes_used": "int64",
    "seconds": "float64",
    **SCORES,
}
LOOPBACK = "127.0.0.1"


@dataclass(frozen=True)
class Head:
    """The content of `study.json`, which describes the rows beside it."""

    digest: str  # of the study
    title: str
    count: int  # calibrations that are planned
    axes: Annotated[dict[str, Annotated[list, Meta(min_length=1)]], Meta(min_length=1)]
    code: CodeVersion  # code that computes the rows
    about: list[str]  # lines on what is the same at all points


def read_head(folder: Path) -> Head:
    """Return the head of a folder. Raises InputError, which names the file, where it is damaged."""
    path = folder / HEAD
    try:
        return msgspec.json.decode(path.read_bytes(), type=Head)
    except (OSError, ValueError) as error:  # msgspec's errors are ValueErrors
        problem = f"{path} is damaged ({shown(str(error), 80)})"
        raise InputError(problem, "choose another folder", key="output") from error


def read_part(path: Path, axes: dict[str, list]) -> pyarrow.Table:
    """Return the rows of one file of the table. Raises ValueError where it is damaged, as after a crash."""
    wanted = schema_of(axes)
    try:
        return parquet.read_table(path).select(wanted.names).cast(wanted)
    except (OSError, KeyError, pyarrow.ArrowException) as error:
        raise ValueError(str(error)) from error


def schema_of(axes: dict[str, list]) -> pyarrow.Schema:
    """Return the columns of the table, the same in every file; an axis of lists is kept as JSON."""

    def kind_of(values: list) -> str:
        if all(isinstance(value, bool) for value in values):
            return "bool"
        if all(isinstance(value, int) for value in values):
            return "int64"
        return "float64" if all(isinstance(value, (int, float)) for value in values) else "string"

    return pyarrow.schema(list(({key: kind_of(values) for key, values in axes.items()} | COLUMNS).items()))


class Results:
    """The rows of a study in a folder; `resume`: whether rows of the same study and code may be there already."""

    def __init__(self, folder: str | Path, study: Study, resume: bool):
        self.folder, self.study = Path(folder), study
        try:
            (self.folder / ROWS).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError(f"cannot make the folder {folder}: {error.strerror}") from error
        own = Head(study.digest(), study.title, study.count, study.axes, own_code(), describe(study))
        begun = any(self.folder.glob(PARTS))
        if (self.folder / HEAD).exists():
            self._require_own(read_head(self.folder), own, begun, resume)
        elif any(path.name != ROWS for path in self.folder.iterdir()):
            raise InputError(f"{folder} is not empty", "choose another folder", key="output")
        if not begun:  # without rows the folder may be used for another study
            text = json.dumps(asdict(own), indent=1) + "\n"
            write_atomically(self.folder / HEAD, lambda file: file.write_text(text, encoding="utf-8"), force=True)

    def _require_own(self, head: Head, own: Head, begun: bool, resume: bool) -> None:
        """Raise InputError unless the folder holds this study, computed by this code, and may be continued."""

        def refuse(problem: str, remedy: str) -> NoReturn:
            raise InputError(f"{self.folder} {problem}", remedy, key="output")

        if head.digest != own.digest:
            refuse("has results of another study", "choose another folder, or give that study")
        if begun and not resume:
            refuse("has results of this study", "add --resume to continue, or choose another folder")
        if begun and head.code.source != own.code.source:
            problem = f"has results of other code ({head.code}; this is {own.code})"
            refuse(problem, "choose another folder, or continue with that code")

    def done(self) -> set[int]:
        """Return the numbers of the tasks whose rows are there."""
        found: set[int] = set()
        for path in sorted(self.folder.glob(PARTS)):
            try:
                found.update(read_part(path, self.study.axes)["task"].to_pylist())
            except ValueError:
                log.warning("%s is damaged: it is set aside, and its tasks are done again", path)
                path.replace(self.folder / f"{path.stem}.damaged")  # not in `rows`, which readers open as one table
        return found

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep other runs from writing to the folder. Raises InputError if one does."""
        try:
            lock = locket.lock_file(str(self.folder / LOCK), timeout=0)
            lock.acquire()
        except locket.LockError as error:
            problem = f"another run writes to {self.folder}"
            raise InputError(problem, "wait for its end", key="output") from error
        try:
            yield
        finally:
            lock.release()

    def append(self, rows: list[dict[str, Any]]) -> None:
        """Write rows as one more file of the table. Raises StorageError where the disk is full."""
        if not rows:
            return
        table = pyarrow.Table.from_pylist(rows, schema_of(self.study.axes))
        path = self.folder / ROWS / f"part-{min(row['task'] for row in rows):09d}-{secrets.token_hex(3)}.parquet"
        write_atomically(path, lambda file: parquet.write_table(table, file))


def read_results(folder: str | Path) -> tuple[Head, pandas.DataFrame]:
    """Return the head of a study's folder, and its rows in the order of their tasks."""
    folder = Path(folder)
    parts = sorted(folder.glob(PARTS))
    if not (folder / HEAD).exists() or not parts:
        remedy = "run `fdcal study STUDY.toml -o FOLDER` first"
        raise InputError(f"{folder} holds no results of a study", remedy, key="report")
    head, read = read_head(folder), []
    for path in parts:
        try:
            read.append(read_part(path, head.axes).to_pandas())
        except ValueError as error:
            remedy = "run the study again with --resume, which does its tasks again"
            raise InputError(f"{path} is damaged ({shown(str(error), 80)})", remedy, key="report") from error
    rows = pandas.concat(read, ignore_index=True)
    return head, rows.drop_duplicates("task").sort_values("task", ignore_index=True)


@dataclass(frozen=True)
class Batching:
    """How tasks are submitted and results written."""

    batch_seconds: float = 1.0  # intended duration of a batch, s
    max_batch: int = 200  # largest number of tasks in a batch
    ahead: int = 3  # batches for each worker that are submitted and not finished
    write_seconds: float = 3.0  # s, interval at which results are written
    write_rows: int = 2000  # number of waiting results that are written before the end of the interval
    connect_seconds: float = 10.0  # a scheduler must answer within this time, s


BATCHING = Batching()


@contextmanager
def connected(workers: int, scheduler: str | None = None, dashboard: bool = False) -> Iterator[Client]:
    """Yield a client of Dask: of the scheduler at an address, or of processes of one thread each on this machine.

    A scheduler of Dask executes what any of its clients sends. The processes started here listen on the loopback
    interface only, and accept only each other: their TLS certificate exists only in their memory. Each also has an
    HTTP server, because Dask cannot omit it; only that of the scheduler answers, and only with `dashboard`.
    """
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=BATCHING.connect_seconds)
        except (OSError, ValueError, TimeoutError) as error:
            remedy = "start one with `dask scheduler`, and give its address as tcp://HOST:8786"
            raise InputError(f"no scheduler answers at {scheduler}", remedy, key="scheduler") from error
        with client:
            yield client
        return
    silent: dict[str, Any] = {"distributed.worker.http.routes": []}
    if not dashboard:
        silent["distributed.scheduler.http.routes"] = []
    with dask_config.set(silent), _uninterrupted():
        cluster = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host=LOOPBACK,
            security=Security.temporary(),
            dashboard_address=f"{LOOPBACK}:0",
            scheduler_kwargs={"dashboard": dashboard},
            silence_logs=logging.ERROR,
        )
    with cluster, Client(cluster) as client:
        yield client


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Ignore Ctrl-C in the block, and permanently in the processes that are started in it, because they inherit this.

    A terminal sends Ctrl-C to all processes, and each worker would print a traceback, although the cluster ends it. A
    worker that Dask starts later, in place of one that died, is started outside of the block and does print one.
    """
    try:
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    except ValueError:  # only the main thread may
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def run_study(
    study: Study,
    results: Results,
    client: Client,
    progress: Callable[[float, str], None] | None = None,
) -> int:
    """Compute the calibrations that the folder of a study lacks, write each row once, and return their number."""
    with results.held():
        done = results.done()
        before, tasks = len(done), study.tasks(done)
        rows: list[dict[str, Any]] = []
        finished, written, size = 0, time.monotonic(), 1
        threads: Any = client.nthreads()
        completed = as_completed(with_results=True)

        def submit(count: int) -> None:
            for batch in filter(None, (list(islice(tasks, size)) for _ in range(count))):
                completed.add(client.submit(run_batch, study, batch, pure=False))

        submit(BATCHING.ahead * max(1, sum(threads.values())))
        try:
            for future, (batch_rows, seconds) in completed:
                future.release()
                rows += batch_rows
                finished += len(batch_rows)
                wanted = BATCHING.batch_seconds * len(batch_rows) / max(seconds, 1e-6)
                size = int(min(max(1, wanted), 2 * len(batch_rows), BATCHING.max_batch))
                submit(1)
                if len(rows) >= BATCHING.write_rows or time.monotonic() - written > BATCHING.write_seconds:
                    results.append(rows)
                    rows, written = [], time.monotonic()
                if progress is not None:
                    progress((before + finished) / study.count, f"{before + finished} of {study.count}")
        finally:
            results.append(rows)
    return finished


def run_batch(study: Study, numbers: list[int]) -> tuple[list[dict[str, Any]], float]:
    """Return the rows of some tasks, and the seconds that they took; called in a worker."""
    began = time.monotonic()
    with one_blas_thread():
        rows = [run_task(study, number) for number in numbers]
    return rows, time.monotonic() - began


def expected_seconds(study: Study, workers: int, samples: int = 3) -> float:
    """Return how long a study is expected to take, s, from a few calibrations spread over its points.

    A first calibration is not counted: it simulates the room and loads compiled code for the others.
    """
    run_task(study, 0)
    numbers = [round(i * (study.count - 1) / max(samples - 1, 1)) for i in range(samples)]
    began = time.monotonic()
    for number in numbers:
        run_task(study, number)
    return (time.monotonic() - began) / len(numbers) * study.count / workers
