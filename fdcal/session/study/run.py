"""Run a study on Dask, a local cluster of processes or a scheduler by its address, and keep its rows in a folder.

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
from typing import TYPE_CHECKING, Any, NoReturn

from ...assessment.study_statistics import SCORES
from ...model.libraries import missing_library, needs
from ...model.storage import write_atomically
from ...model.validation import InputError, StorageError, shown
from . import Study, code_version, describe, version_text

if TYPE_CHECKING:
    import pandas
    from distributed import Client


log = logging.getLogger(__name__)

HEAD = "study.json"  # what study this folder is of
ROWS = "rows"  # folder of the table, which `pandas.read_parquet` reads as a whole
PARTS = f"{ROWS}/part-*.parquet"
LOCK = "study.lock"  # held by the run that writes
COLUMNS = {  # those of every row, beside the axes; missing values are null
    "task": "int64",
    "draw": "int64",
    "seed": "int64",
    "version": "string",
    "source": "string",  # these two as of `definition.CodeVersion`; null in rows of fdcal before it wrote them
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


class Results:
    """The rows of a study in a folder; `resume`: whether rows of the same study and code may be there already."""

    def __init__(self, folder: str | Path, study: Study, resume: bool):
        require_tables()
        self.folder, self.study = Path(folder), study
        try:
            (self.folder / ROWS).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError(f"cannot make the folder {folder}: {error.strerror}") from error
        head = self.folder / HEAD
        own = {"digest": study.digest(), "title": study.title, "count": study.count, "axes": study.axes}
        own["code"] = asdict(code_version())
        own["about"] = describe(study)
        if head.exists():
            self._require_own(_head(head), own, resume)
        elif any(path.name != ROWS for path in self.folder.iterdir()):
            raise InputError(f"{folder} is not empty", "choose another folder", key="output", value=str(folder))
        if not any(self.folder.glob(PARTS)):  # the first row makes the folder that of its study
            text = json.dumps(own, indent=1) + "\n"
            write_atomically(head, lambda file: file.write_text(text, encoding="utf-8"), force=True)

    def _require_own(self, head: dict, own: dict, resume: bool) -> None:
        """Raise InputError unless the folder holds this study, computed by this code, and may be continued."""

        def refuse(problem: str, remedy: str) -> NoReturn:
            raise InputError(f"{self.folder} {problem}", remedy, key="output", value=str(self.folder))

        if head.get("digest") != own["digest"]:
            refuse("holds another study", "choose another folder, or the study that it was begun with")
        if not any(self.folder.glob(PARTS)):
            return
        if not resume:
            refuse("holds results of this study", "add <resume> to go on, or choose another folder")
        began = head.get("code")  # older folders do not say
        if began is not None and began["source"] != own["code"]["source"]:
            text, other = version_text(**own["code"]), version_text(**began)
            refuse(
                f"holds results of other code ({other}; this is {text})", "choose another folder, or go on with that"
            )

    def done(self) -> set[int]:
        """Return the numbers of the tasks whose rows are there."""
        from pyarrow import parquet

        found: set[int] = set()
        for path in sorted(self.folder.glob(PARTS)):
            try:
                found.update(parquet.read_table(path)["task"].to_pylist())
            except (OSError, ValueError, KeyError):  # as after a crash of the machine
                log.warning("%s is damaged: it is set aside, and its tasks are done again", path)
                path.replace(
                    self.folder / f"{path.stem}.damaged"
                )  # outside the folder `rows`, which readers open as one table
        return found

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep other runs from writing to the folder. Raises InputError if one does."""
        import locket

        try:
            lock = locket.lock_file(str(self.folder / LOCK), timeout=0)
            lock.acquire()
        except locket.LockError as error:
            problem = f"another run writes to {self.folder}"
            raise InputError(problem, "wait for its end", key="output", value=str(self.folder)) from error
        try:
            yield
        finally:
            lock.release()

    def append(self, rows: list[dict[str, Any]]) -> None:
        """Write rows as one more file of the table. Raises StorageError where the disk is full."""
        import pyarrow
        from pyarrow import parquet

        if not rows:
            return
        kinds = {key: _kind_of(values) for key, values in self.study.axes.items()} | COLUMNS
        columns = {key: pyarrow.array([row.get(key) for row in rows], kind) for key, kind in kinds.items()}
        path = self.folder / ROWS / f"part-{min(row['task'] for row in rows):09d}-{secrets.token_hex(3)}.parquet"
        write_atomically(path, lambda file: parquet.write_table(pyarrow.table(columns), file))


def _kind_of(values: list) -> str:
    """Return the type of the column of an axis, the same in every file of the table; lists are kept as JSON."""
    if all(isinstance(value, bool) for value in values):
        return "bool"
    if all(isinstance(value, int) for value in values):
        return "int64"
    return "float64" if all(isinstance(value, (int, float)) for value in values) else "string"


def read_results(folder: str | Path) -> tuple[dict, pandas.DataFrame]:
    """Return the head of a study's folder, and its rows in the order of their tasks."""
    require_tables()
    import pandas

    folder = Path(folder)
    parts = sorted(folder.glob(PARTS))
    if not (folder / HEAD).exists() or not parts:
        remedy = "run `fdcal study STUDY.toml -o FOLDER` first"
        raise InputError(f"{folder} holds no results of a study", remedy, key="report", value=str(folder))
    read = []
    for path in parts:
        try:
            read.append(pandas.read_parquet(path))
        except (OSError, ValueError, KeyError) as error:
            remedy = "run the study again with <resume>, which does its tasks again"
            raise InputError(f"{path} is damaged ({shown(str(error), 80)})", remedy, key="report") from error
    rows = pandas.concat(read, ignore_index=True)
    return _head(folder / HEAD), rows.drop_duplicates("task").sort_values("task", ignore_index=True)


def require_tables() -> None:
    """Raise InputError unless pandas and pyarrow, which read and write Parquet, are installed."""
    needs("pandas")
    needs("pyarrow.parquet")


def _head(path: Path) -> dict:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read", "choose another folder", key="output", value=str(path)) from error


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
    with _uninterrupted():
        cluster = LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0", silence_logs=logging.ERROR
        )
    with cluster, Client(cluster) as client:
        yield client


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Ignore Ctrl-C in the block, and for good in the processes that are started in it, which inherit that.

    A terminal sends it to all of them, and each worker would answer with a traceback; the cluster ends them. A worker
    that Dask starts later, in place of one that died, is started outside of the block and does answer with one.
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

    def submit(count: int) -> None:
        for batch in filter(None, (list(islice(tasks, size)) for _ in range(count))):
            completed.add(client.submit(run_batch, study, batch, pure=False))

    submit(PACE.ahead * width)
    try:
        for future, (batch_rows, seconds) in completed:
            future.release()
            rows += batch_rows
            finished += len(batch_rows)
            wanted = PACE.batch_seconds * len(batch_rows) / max(seconds, 1e-6)
            size = int(min(max(1, wanted), 2 * len(batch_rows), PACE.max_batch))
            submit(1)
            if len(rows) >= PACE.write_rows or time.monotonic() - written > PACE.write_seconds:
                results.append(rows)
                rows, written = [], time.monotonic()
            if progress is not None:
                progress((before + finished) / study.count, f"{before + finished} of {study.count}")
    finally:
        results.append(rows)
    return finished


def run_batch(study: Study, numbers: list[int]) -> tuple[list[dict[str, Any]], float]:
    """Return the rows of some tasks, and the seconds that they took; it runs in a worker."""
    from ..process import one_blas_thread
    from .rows import run_task

    began = time.monotonic()
    with one_blas_thread():
        rows = [run_task(study, number) for number in numbers]
    return rows, time.monotonic() - began


def expected_seconds(study: Study, workers: int, samples: int = 3) -> float:
    """Return how long a study is expected to take, s, from a few calibrations spread over its points.

    A first calibration is not counted: it simulates the room and loads compiled code, which the others share.
    """
    from .rows import run_task

    run_task(study, 0)
    numbers = [round(i * (study.count - 1) / max(samples - 1, 1)) for i in range(samples)]
    began = time.monotonic()
    for number in numbers:
        run_task(study, number)
    return (time.monotonic() - began) / len(numbers) * study.count / workers
