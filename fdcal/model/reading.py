"""Reading of files that anyone may have written: text within a length, TOML, JSON and NumPy archives."""

import json
import os
import stat
import tomllib
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .validation import LIMITS, InputError, StorageError, shown

MAX_DOTS = 500  # before the "=" of a line: the parser's time grows with the square of the parts of a key


def read_bytes(path: str | Path, most: int = LIMITS.text, what: str = "") -> bytes:
    """Return the content, as "scene", of a file of at `most` so many bytes: a device without an end is no hang."""
    if "\0" in str(path):
        raise InputError(f"{shown(str(path))} is no name of a file, it holds a NUL character", "correct it")
    try:
        with open(path, "rb") as file:
            content = file.read(most + 1)
    except OSError as error:
        raise StorageError(f"cannot read {what}{what and ' '}{path}: {error.strerror or error}") from error
    if len(content) > most:
        raise InputError(f"{path} has more than {most:,} bytes", "give a smaller file")
    return content


def parse_toml(content: bytes, where: object) -> dict[str, Any]:
    """Return the table of a TOML file, which an error calls `where`; InputError for what is none."""
    try:
        text = content.decode("utf-8-sig")
        for number, line in enumerate(text.splitlines(), 1):
            if line.partition("=")[0].count(".") > MAX_DOTS:
                raise ValueError(f"a key of more than {MAX_DOTS} parts in line {number}")
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where} is not valid TOML: {_reason(error)}") from error


def parse_json(content: bytes | str, where: object) -> Any:
    """Return the value of a JSON file, which an error calls `where`; InputError for what is none."""
    try:
        return json.loads(content.decode("utf-8") if isinstance(content, bytes) else content)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where} is not valid JSON: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    """Return what a parser says, in one line."""
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    return " ".join(str(error).split(";")[0].split())


def read_archive(file: Any, wanted: Callable[[str], bool]) -> dict[str, np.ndarray]:
    """Return the arrays of an open .npz file whose names are wanted, none pickled, `LIMITS.unfolded` bytes at most.

    A damaged archive raises any Exception.
    """
    with zipfile.ZipFile(file) as archive:
        entries = [entry for entry in archive.infolist() if wanted(entry.filename.removesuffix(".npy"))]
    # No member gives more bytes than the directory says; those that are not compressed may be as large as the file.
    stored = sum(entry.file_size for entry in entries if entry.compress_type == zipfile.ZIP_STORED)
    packed = sum(entry.file_size for entry in entries if entry.compress_type != zipfile.ZIP_STORED)
    if packed > LIMITS.unfolded or stored > file.seek(0, os.SEEK_END):
        problem = f"it unfolds to {packed + stored:.3g} bytes, and a compressed file may to {LIMITS.unfolded:.3g}"
        raise InputError(problem, "write it with numpy.savez, which does not compress")
    file.seek(0)
    table, key = dict[str, Any](), ""
    with np.load(file, allow_pickle=False) as archive:
        for key in filter(wanted, archive.files):
            try:
                table[key] = archive[key]
                if not isinstance(table[key], np.ndarray):
                    raise ValueError("it does not begin as an array of NumPy does")
            except MemoryError:
                raise
            except Exception as error:  # a damaged member raises anything from zipfile, zlib or NumPy
                problem = f'"{key}" is damaged or not a plain array of numbers ({shown(str(error), 120)})'
                raise InputError(problem, "write it again", key=key) from error
    return table


def require_regular(path: str | Path) -> None:
    """Raise InputError for what is neither file nor folder, as a device without an end; OSError if it is missing."""
    kind = os.stat(path).st_mode
    if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):
        raise InputError(f"{path} is no regular file", "give a file")
