"""The folder of a study: its definition, and a table of Parquet files, each written completely or not at all."""

from __future__ import annotations

import json
import secrets
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...model.storage import write_atomically
from ...model.validation import InputError, StorageError
from .definition import Study

if TYPE_CHECKING:
    import pandas

HEAD = "study.json"  # what study this folder is of
PARTS = "part-*.parquet"


class Results:
    """The rows of a study in a folder.

    Parameters
    ----------
    folder : str or Path
    study : Study
    resume : bool
        Whether rows may be there already, of the same study.

    Raises
    ------
    InputError
        The folder holds rows and `resume` is not set, or those of another study; pandas or pyarrow is missing.
    StorageError
        The folder cannot be made.
    """

    def __init__(self, folder: str | Path, study: Study, resume: bool):
        require_tables()
        self.folder, self.study = Path(folder), study
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError(f"cannot make the folder {folder}: {error.strerror}") from error
        head = self.folder / HEAD
        own = {"digest": study.digest(), "title": study.title, "count": study.count, "axes": study.axes}
        if head.exists():
            if _head(head).get("digest") != own["digest"]:
                remedy = "choose another folder, or the study that it was begun with"
                raise InputError(f"{folder} holds another study", remedy, key="output", value=str(folder))
            if not resume and any(self.folder.glob(PARTS)):
                remedy = "add <resume> to go on, or choose another folder"
                raise InputError(f"{folder} holds results of this study", remedy, key="output", value=str(folder))
            return
        if any(self.folder.iterdir()):
            raise InputError(f"{folder} is not empty", "choose another folder", key="output", value=str(folder))
        write_atomically(head, lambda file: file.write_text(json.dumps(own, indent=1) + "\n", encoding="utf-8"))

    def done(self) -> set[int]:
        """Return the numbers of the tasks whose rows are there."""
        from pyarrow import parquet

        found: set[int] = set()
        for path in self.folder.glob(PARTS):
            found.update(parquet.read_table(path, columns=["task"])["task"].to_pylist())
        return found

    def append(self, rows: list[dict[str, Any]]) -> None:
        """Write rows as one more file of the table. Raises StorageError where the disk is full."""
        from pyarrow import Table, parquet

        if not rows:
            return
        keys = list(dict.fromkeys(key for row in rows for key in row))
        table = Table.from_pylist([{key: row.get(key) for key in keys} for row in rows])
        path = self.folder / f"part-{min(row['task'] for row in rows):09d}-{secrets.token_hex(3)}.parquet"
        write_atomically(path, lambda file: parquet.write_table(table, file))


def read_results(folder: str | Path) -> tuple[dict, pandas.DataFrame]:
    """Return the head of a study's folder, and its rows in the order of their tasks.

    Raises
    ------
    InputError
        The folder holds no results.
    """
    require_tables()
    import pandas

    folder = Path(folder)
    parts = sorted(folder.glob(PARTS))
    if not (folder / HEAD).exists() or not parts:
        remedy = "run `fdcal study STUDY.toml -o FOLDER` first"
        raise InputError(f"{folder} holds no results of a study", remedy, key="report", value=str(folder))
    rows = pandas.concat([pandas.read_parquet(path) for path in parts], ignore_index=True)
    return _head(folder / HEAD), rows.drop_duplicates("task").sort_values("task", ignore_index=True)


def require_tables() -> None:
    """Raise InputError unless pandas and pyarrow, which read and write Parquet, are installed."""
    try:
        import pandas
        import pyarrow.parquet
    except ImportError as error:
        remedy = "install them: pip install 'fdcal[study]'"
        raise InputError("a study needs dask, pandas and pyarrow", remedy, key="study") from error
    del pandas, pyarrow


def _head(path: Path) -> dict:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read", "choose another folder", key="output", value=str(path)) from error
