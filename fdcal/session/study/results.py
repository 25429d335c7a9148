"""The folder of a study: its definition, and a table of Parquet files, each written completely or not at all."""

from __future__ import annotations

import json
import logging
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from ...assessment.study_statistics import SCORES
from ...model.libraries import needs
from ...model.storage import write_atomically
from ...model.validation import InputError, StorageError, shown
from .definition import Study, code_version, describe, version_text

if TYPE_CHECKING:
    import pandas

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
        if not any(self.folder.glob(PARTS)):  # whoever writes the first row has begun the folder
            text = json.dumps(own, indent=1) + "\n"
            write_atomically(head, lambda file: file.write_text(text, encoding="utf-8"), force=True)

    def _require_own(self, head: dict, own: dict, resume: bool) -> None:
        """Raise InputError unless the folder was begun by this study and this code, and may be gone on with."""

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
                path.replace(path.with_suffix(".damaged"))
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
