"""A folder of files that is written completely or not at all."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

from .storage import TEMPORARY
from .validation import InputError, StorageError


@contextlib.contextmanager
def folder_in_progress(path: str | Path, force: bool = False) -> Iterator[Path]:
    """Give a new folder beside `path`, whose files are moved to `path` at the end, or deleted if anything fails.

    It is made at once, so that a place that cannot be written is known before the work begins.

    `force`: whether `path` may hold files. Those of the same names are replaced, the others stay. Raises InputError:
    `path` is a file, or a folder that is not empty and `force` is not set; StorageError: the folder around it is
    missing, or the system refuses.
    """
    path = Path(path)
    _require_free(path, force)
    temporary = path.resolve().parent / f"{TEMPORARY}{secrets.token_hex(8)}"
    try:
        _probe(path)
        temporary.mkdir()
        yield temporary
        path.mkdir(exist_ok=True)
        for file in sorted(temporary.iterdir()):
            os.replace(file, path / file.name)
    except OSError as error:
        raise StorageError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _require_free(path: Path, force: bool) -> None:
    if path.exists() and not path.is_dir():
        raise InputError(f"{path} is a file", "name a folder", key="output", value=str(path))
    if not path.parent.is_dir():
        raise StorageError(f"{path} lies in a folder that does not exist; make it first: mkdir -p {path.parent}")
    if path.is_dir() and not force and any(path.iterdir()):
        remedy = "add <force> to replace what it has of the same names, or choose another folder"
        raise InputError(f"{path} is not empty", remedy, key="output", value=str(path))


def _probe(path: Path) -> None:
    """Raise OSError where a file cannot be written into an existing folder."""
    if path.is_dir():
        file = path / f"{TEMPORARY}{secrets.token_hex(8)}"
        file.touch()
        file.unlink()
