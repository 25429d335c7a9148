"""Positions of microphones in the files of other programs.

.csv     name,x,y,z,uncertainty, metres, one line per microphone; known positions can be read from one as well
.xml     Acoular's microphone geometry: `<MicArray><pos Name= x= y= z= /></MicArray>`, metres
.npy     as pyroomacoustics reads it: an array (3, N), metres, one column per microphone
.json    one object with the frame and a list of microphones
"""

import csv
import io
import itertools
import json
import math
import re
import xml.etree.ElementTree as tree
from os import PathLike
from pathlib import Path

import numpy as np

from ...model.measurement import MicrophonePositions
from ...model.storage import read_bytes
from ...model.validation import InputError, require_point, shown
from . import Format

MAX_BYTES = 10_000_000  # of a file of positions
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)  # Python also takes 1_0 for a number
HEADER = ["name", "x", "y", "z", "uncertainty"]
HEIGHTS = ("z", "z_m", "z (m)", "z [m]", "height", "height_m", "height (m)", "height [m]")  # of the third coordinate


def read_positions(path: str | PathLike[str]) -> MicrophonePositions:
    """Return the positions in a file of Acoular (.xml) or a table with the columns name,x,y[,z] (.csv)."""
    path = Path(path)
    if path.suffix.lower() not in READERS:
        problem = f'"{path}" ends in no suffix of a file of positions'
        raise InputError(problem, f"give <positions> as {', '.join(sorted(READERS))}", key="positions", value=str(path))
    names, positions = READERS[path.suffix.lower()](path)
    return MicrophonePositions(tuple(names), positions, frame=path.name)


def _write_table(path: Path, placed: MicrophonePositions, original: str | None = None) -> None:
    """Write `placed`, metres with all digits; an unknown uncertainty is left empty."""
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEADER)
        for n, (name, place) in enumerate(zip(placed.names, placed.positions.tolist(), strict=True)):
            writer.writerow([name, *place, "" if placed.uncertainty is None else float(placed.uncertainty[n])])


def read_table(path: str | Path) -> tuple[list[str], np.ndarray]:
    """Return names and positions (A, 2 or 3), metres, of a table with the columns name,x,y and optionally z."""
    try:
        text = read_bytes(path, MAX_BYTES).decode("utf-8-sig")
        # a spreadsheet writes semicolons where a comma is the decimal sign, and copies tabs
        delimiter = next((one for one in ";\t" if one in text.partition("\n")[0]), ",")
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
        rows = [row for row in reader if any(cell.strip() for cell in row)]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path} is not a table in text form: {error}") from error
    head = [cell.strip().lower() for cell in rows[0]] if rows else []
    if head[:3] != ["name", "x", "y"] or len(rows) < 2:
        wanted = "the line name,x,y or name,x,y,z and hold one line per microphone"
        found = shown(",".join(rows[0])) if rows else ""
        raise InputError(f'{path} must begin with {wanted}, not with "{found}"')
    z = next((column for column, cell in enumerate(head[3:], 3) if cell in HEIGHTS), None)
    for column, cell in enumerate(head[3:], 3):
        numeric = any(NUMBER.fullmatch(row[column].strip().replace(",", ".")) for row in rows[1:] if len(row) > column)
        if column != z and cell != HEADER[-1] and numeric:
            problem = f'{path}: the column "{shown(cell)}" of numbers is not understood'
            raise InputError(
                problem, "call a third coordinate z, metres, or remove the column", key="positions", value=cell
            )
    columns = (1, 2) if z is None else (1, 2, z)
    axes, names, places = len(columns), [], []
    for number, row in enumerate(rows[1:], 2):
        cells = [row[column].strip() for column in columns if column < len(row)]
        if delimiter != ",":
            cells = [cell.replace(",", ".") for cell in cells]
        if len(cells) != axes or not all(map(NUMBER.fullmatch, cells)):
            line = shown(",".join(row))
            raise InputError(f"{path}, line {number}: {line!r} must be a name and {axes} numbers, metres")
        places.append([float(cell) for cell in cells])
        require_point(f"{path}, line {number}", places[-1], (axes,))
        names.append(row[0].strip())
    if len(set(names)) < len(names):
        raise InputError(f"{path} names a microphone twice", "keep one line of each")
    return names, np.array(places)


def _write_xml(path: Path, placed: MicrophonePositions, original: str | None = None) -> None:
    """Write `placed`; raise InputError for a name that XML cannot hold."""
    root = tree.Element("MicArray", name="fdcal")
    for name, place in zip(placed.names, placed.positions.tolist(), strict=True):
        if re.search("[\x00-\x1f\ud800-\udfff\ufffe\uffff]", name):
            raise InputError(f"the name {name!r} cannot be written in XML", "rename that microphone")
        coordinates = {axis: repr(value) for axis, value in zip("xyz", place, strict=True)}
        tree.SubElement(root, "pos", {"Name": name} | coordinates)
    tree.indent(root)
    tree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def read_xml(path: str | Path) -> tuple[list[str], np.ndarray]:
    """Return names, or numbers from 0 where not all have different ones, and positions (N, 3), metres."""
    try:
        elements = tree.fromstring(read_bytes(path, MAX_BYTES)).findall("pos")
    except (tree.ParseError, ValueError, LookupError) as error:  # broken, or of an encoding that does not exist
        raise InputError(f"{path} is not valid XML: {shown(str(error))}", key="positions", value=str(path)) from error
    if not elements:
        raise InputError(f"{path} holds no <pos> inside its first element", "give a geometry of Acoular")
    places = np.zeros((len(elements), 3))
    for (row, element), (column, axis) in itertools.product(enumerate(elements), enumerate("xyz")):
        text = element.get(axis, "0" if axis == "z" else "")
        places[row, column] = float(text) if NUMBER.fullmatch(text.strip()) else math.nan
        if not math.isfinite(places[row, column]):
            problem = f'{path}: {axis} = "{shown(text)}" of microphone {row} is no number'
            raise InputError(problem, "give metres", key="positions", value=text)
    names = [element.get("Name", "") for element in elements]
    if "" in names or len(set(names)) < len(names):
        names = [str(row) for row in range(len(elements))]
    return names, places


def _write_columns(path: Path, placed: MicrophonePositions, original: str | None = None) -> None:
    with open(path, "wb") as file:
        np.save(file, np.ascontiguousarray(placed.positions.T))


def _write_object(path: Path, placed: MicrophonePositions, original: str | None = None) -> None:
    """Write `placed`, metres; an unknown uncertainty is null."""
    sigma = [None] * len(placed.names) if placed.uncertainty is None else placed.uncertainty.tolist()
    rows = zip(placed.names, placed.positions.tolist(), sigma, strict=True)
    microphones = [{"name": n, "x": p[0], "y": p[1], "z": p[2], "uncertainty": s} for n, p, s in rows]
    table = {"unit": "metre", "frame": placed.frame, "microphones": microphones}
    path.write_text(json.dumps(table, indent=1, allow_nan=False, ensure_ascii=False) + "\n", encoding="utf-8")


READERS = {".csv": read_table, ".xml": read_xml}
FORMATS = (
    Format((".csv",), write=_write_table),
    Format((".xml",), write=_write_xml),
    Format((".npy",), write=_write_columns),
    Format((".json",), write=_write_object),
)
