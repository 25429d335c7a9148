"""CSV: `name,x,y,z,uncertainty`, metres, one line per microphone. Known positions can be read from one as well."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import numpy as np

from ...model.given_positions import MicrophonePositions
from ...model.reading import read_bytes
from ...model.validation import InputError, require_point, shown

SUFFIXES = (".csv",)
MOST_BYTES = 10_000_000
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)  # Python also takes 1_0 for a number
DECIMALS = 7  # of a metre: a ten-thousandth of a millimetre
HEADER = ["name", "x", "y", "z", "uncertainty"]


def write(path: Path, placed: MicrophonePositions, original: str | None = None) -> None:
    """Write `placed`, metres with DECIMALS; an unknown uncertainty is left empty."""
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEADER)
        for n, (name, place) in enumerate(zip(placed.names, placed.positions.tolist(), strict=True)):
            uncertainty = "" if placed.uncertainty is None else _written(placed.uncertainty[n])
            writer.writerow([name, *map(_written, place), uncertainty])


def _written(metres: float) -> str:
    return f"{metres:.{DECIMALS}f}"


def read_positions(path: str | Path) -> tuple[list[str], np.ndarray]:
    """Return the microphones of a table with the columns name,x,y and optionally z.

    Returns (A, 2 or 3) float64, names; positions, metres. Raises InputError: the file is no such table; StorageError:
    the file cannot be read.
    """
    try:
        text = read_bytes(path, MOST_BYTES).decode("utf-8-sig")
        european = ";" in text.partition("\n")[0]  # as a spreadsheet writes CSV where a comma is the decimal sign
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=";" if european else ",")
        rows = [row for row in reader if any(cell.strip() for cell in row)]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path} is not a table in text form: {error}") from error
    head = [cell.strip().lower() for cell in rows[0]] if rows else []
    if head[:3] != ["name", "x", "y"] or len(rows) < 2:
        found = shown(",".join(rows[0])) if rows else ""
        raise InputError(
            f"{path} must begin with the line name,x,y or name,x,y,z and hold one line per microphone, not with"
            f' "{found}"'
        )
    axes = 3 if head[3:4] == ["z"] else 2
    names, places = [], []
    for number, row in enumerate(rows[1:], 2):
        cells = [cell.strip().replace(",", ".") if european else cell.strip() for cell in row[1 : 1 + axes]]
        if len(cells) != axes or not all(map(NUMBER.fullmatch, cells)):
            line = shown(",".join(row))
            raise InputError(f"{path}, line {number}: {line!r} must be a name and {axes} numbers, metres")
        places.append([float(cell) for cell in cells])
        require_point(f"{path}, line {number}", places[-1], (axes,))
        names.append(row[0].strip())
    if len(set(names)) < len(names):
        raise InputError(f"{path} names a microphone twice", "keep one line of each")
    return names, np.array(places)
