"""Files of microphone positions: what their columns mean, and the formats that are read and written.

Read: text tables, Excel sheets, geometry files of Acoular, HARK, TASCAR and ODAS, JSON, NumPy arrays and SOFA. An
ambiguous file, or a table with numbers of unknown meaning, raises an InputError that says how to write it.

Written:
.csv     name,x,y,z,uncertainty, metres to 0.1 µm, one line per microphone
.xml     Acoular's microphone geometry: `<MicArray><pos Name= x= y= z= /></MicArray>`, metres to 0.1 µm
.npy     as pyroomacoustics reads it: an array (3, N), metres, one column per microphone
.json    one object with the frame and a list of microphones
"""

import csv
import io
import json
import logging
import re
import xml.etree.ElementTree as tree
import zipfile
from collections.abc import Iterator
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ...model.libraries import isolated_call
from ...model.measurement import MicrophonePositions
from ...model.storage import damaged, read_bytes, require_regular
from ...model.validation import InputError, StorageError, naming, require_point, shown
from . import Format
from .sofa import from_spherical, placed_receivers

MAX_BYTES = 10_000_000  # largest size of a file of positions
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)  # `float` would also accept 1_0
LARGEST_M = 50.0  # metres; numbers whose median distance from their middle is larger are taken as millimetres
STILL_M = 1e-3  # metres; an array whose positions change by no more than this counts as not moving
ANGLES = ("azimuth", "elevation", "polar")
# The contents of a column, and the words in a header that denote them; the first match counts.
MEANINGS = {
    "uncertainty": "uncertainty sigma std sd err error tolerance",
    "x": "x",
    "y": "y",
    "z": "z height höhe hoehe hauteur altura altezza",
    "azimuth": "azimuth azimut az",
    "elevation": "elevation el",
    "polar": "polar inclination colatitude zenith",
    "radius": "radius r distance",
    "unit": "unit units einheit",
    "name": "name names label labels id mic mics microphone microphones mikrofon channel channels ch kanal canal sensor"
    " point nr no number nummer index",
}
# Number of each unit in a metre.
UNITS = {"m": 1.0, "dm": 10.0, "cm": 100.0, "mm": 1000.0, "\u00b5m": 1e6, "in": 1 / 0.0254, "ft": 1 / 0.3048}
KNOWN_UNITS = f"write one of {', '.join(UNITS)}"
METRIC = {"": 1.0, "deci": 10.0, "centi": 100.0, "milli": 1000.0, "micro": 1e6}
UNITS |= {"\u03bcm": 1e6, "um": 1e6, "inch": 1 / 0.0254, "inches": 1 / 0.0254, "foot": 1 / 0.3048, "feet": 1 / 0.3048}
UNITS |= {prefix + word: n for prefix, n in METRIC.items() for word in ("metre", "metres", "meter", "meters")}
IN_BRACKETS = re.compile(r"[\[(]\s*([^\])]*[^\W\d_][^\])]*?)\s*[\])]")  # text that has a letter
# finds the unit that a comment in a file states; the word "in" before another word is not the unit
IN_WORDS = re.compile(rf"(?:\bin|\bunits?\b\W*|[\[(])\s*(?!in\s+\w)({'|'.join(UNITS)})\b", re.IGNORECASE)

log = logging.getLogger(__name__)

Rows = dict[int, list[str]]  # cells by the number of the line or microphone
Placed = tuple[list[str], np.ndarray, str]  # names, positions (N, 2 or 3), metres, and a remark or ""


def read_positions(path: str | PathLike[str]) -> MicrophonePositions:
    """Return the positions in a file of any kind that `read_places` reads."""
    names, positions = read_places(path)
    return MicrophonePositions(tuple(names), positions, frame=Path(path).name)


def read_places(path: str | PathLike[str]) -> tuple[list[str], np.ndarray]:
    """Return names and positions (N, 2 or 3), metres, in a file whose suffix is in READERS."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in READERS:
        raise _question(f'the suffix of "{path}" is unknown', f"give a file {', '.join(sorted(READERS))}")
    if suffix == ".sofa":
        if not path.exists():
            raise StorageError(f"cannot read {path}: No such file or directory")
        require_regular(path)
        positions = isolated_call(path, placed_receivers, path)
        return [str(n) for n in range(len(positions))], positions
    content, (read, what) = read_bytes(path, MAX_BYTES), READERS[suffix]
    with naming(path), damaged(f"{path} is {what}", "write it again, or save the table as .csv"):
        names, positions, remark = read(content)
    if remark:
        log.warning("%s: %s", path, remark)
    return names, positions


def _question(problem: str, remedy: str) -> InputError:
    """Return the error for positions that are damaged or ambiguous."""
    return InputError(problem, remedy, key="positions")


def is_number(cell: str) -> bool:
    return NUMBER.fullmatch(cell.replace(",", ".", 1)) is not None


def meaning(cell: str) -> tuple[str, float | None]:
    """Return the meaning of a cell of a header, a key of MEANINGS or "", and its unit as in UNITS, or None."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", cell)  # posX, XPos
    words = re.findall(r"[^\W\d_]+", re.sub(r"\b([xyz])(mm|cm|m|in|ft)\b", r"\1 \2", spaced.lower()))
    found = [kind for kind, known in MEANINGS.items() if set(words) & set(known.split())]
    if len(set(words) & set("xyz")) > 1:  # a cell that names several axes is a sentence
        return "", None
    inside = IN_BRACKETS.search(cell.lower())
    unit = UNITS.get(inside[1] if inside else "", UNITS.get(words[-1])) if len(words) > 1 else None
    return (found[0] if found else "name" if cell in ("", "#") else ""), unit


def is_header(row: list[str]) -> bool:
    kinds = {meaning(cell)[0] for cell in row}
    return kinds >= {"x", "y"} or kinds >= {"azimuth", "radius"}


def _counts(cells: list[str]) -> bool:
    """Return whether the cells are 0, 1, 2, ... or 1, 2, 3, ..."""
    return any(cells == [str(n) for n in range(first, first + len(cells))] for first in (0, 1))


def _text(content: bytes) -> str:
    """Return the text of a file in one of the encodings that editors and spreadsheets use."""
    try:
        return content.decode("utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", "replace")


def _read_table(content: bytes) -> Placed:
    """Return the positions in a table; a delimiter that yields a header comes first, then that of most numbers."""
    text = _text(content)
    separator = re.match(r'"?sep=(.)"?\r?\n', text)  # Excel may write such a first line
    found = list[tuple[bool, int, Rows]]()
    for delimiter in separator[1] if separator else ",;\t| ":
        lines = re.sub(r"[ \t]+", " ", text) if delimiter == " " else text
        reader = csv.reader(io.StringIO(lines, newline=""), delimiter=delimiter, skipinitialspace=True)
        numbered = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
        rows = {n: row for n, row in numbered if any(row)}
        numeric = [[is_number(cell) for cell in row if cell] for row in rows.values()]
        score = sum(2 * sum(row) - len(row) for row in numeric if any(row))
        found.append((any(map(is_header, rows.values())), score, rows))
    rows = max(found, key=lambda one: one[:2])[2]
    if separator:
        rows.pop(1)
    return _of_sheet(rows)


def _read_sheet(content: bytes) -> Placed:
    """Return the positions in an Excel file, of which only one sheet may have cells."""
    main, sheets = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}", list[Rows]()
    with zipfile.ZipFile(io.BytesIO(content)) as file:
        names = [one for one in file.namelist() if re.fullmatch(r"xl/(worksheets/[^/]+|sharedStrings)\.xml", one)]
        if sum(file.getinfo(name).file_size for name in names) > 10 * MAX_BYTES:
            raise _question("it is too large", "save the table as .csv")
        parts = {name: tree.fromstring(file.read(name)) for name in names}
    shared = ["".join(one.itertext()) for one in parts.pop("xl/sharedStrings.xml", [])]
    for part in parts.values():
        rows: Rows = {}
        for cell in part.iter(f"{main}c"):
            letters, line = re.fullmatch(r"([A-Z]+)(\d+)", cell.get("r", "")).groups()  # type: ignore
            text = "".join(cell.itertext()) if cell.get("t") == "inlineStr" else cell.findtext(f"{main}v", "")
            text = shared[int(text)] if cell.get("t") == "s" else text
            if len(letters) == 1 and text.strip():  # columns up to Z
                row = rows.setdefault(int(line), [])
                row += [""] * (ord(letters) - ord("A") - len(row)) + [text.strip()]
        sheets += [rows] if rows else []
    if len(sheets) != 1:
        raise _question(f"it has {len(sheets)} sheets with cells", "keep the one with the positions")
    return _of_sheet(sheets[0])


def _read_xml(content: bytes) -> Placed:
    """Return the positions in the children of an element that have attributes x, y and z, or position="x y z"."""
    found = list[tuple[str, list[dict[str, str]]]]()
    for parent in tree.fromstring(content).iter():
        records = list[dict[str, str]]()
        for element in parent:
            record = {key.lower(): text.strip() for key, text in element.attrib.items()}
            values = record.pop("position", "").split()
            records.append(record | dict(zip("xyz", values, strict=False)))
        records = [one for one in records if {"x", "y"} & set(one)]
        if records:
            found.append((" ".join([parent.tag, *parent.attrib.values()]), records))
    found = [one for one in found if "mic" in one[0].lower()] if len(found) > 1 else found
    if len(found) != 1:
        raise _question("it needs exactly one list of positions", "write as Acoular: <MicArray><pos Name= x= y= z=>")
    return _of_records(found[0][1], unique=False)


def _read_odas(content: bytes) -> Placed:
    """Return the positions `mu` of the microphones in a configuration of ODAS."""
    found = re.findall(r"\bmu\s*=\s*[(\[]([^)\]]*)[)\]]", re.sub(r"(//|#).*", "", _text(content)))
    if not found:
        raise _question("it holds no microphone: mu = ( x, y, z )", "give an ODAS configuration")
    return _of_records([dict(zip("xyz", map(str.strip, one.split(",")), strict=False)) for one in found])


def _read_object(content: bytes) -> Placed:
    """Return the positions in JSON: a list of microphones, an object with one key for each, or an object of columns."""
    found = list(_lists_of_places("", json.loads(_text(content)), {}))
    of_microphones = [one for one in found if re.search("mic|receiver|^positions$", one[0].lower())]
    found = of_microphones if len(of_microphones) == 1 else found
    if len(found) != 1:
        which = f"{len(found)} lists that may be the positions" if found else "no list of positions"
        names = ", ".join(shown(one[0]) for one in found[:5])
        remedy = 'write [{"name": "0", "x": 0.1, "y": 0, "z": 0}, ...], metres'
        raise _question(f"it holds {which}{names and ': ' + names}", remedy)
    _, entries, parent = found[0]
    stated = str(parent.get("unit") or parent.get("units") or "").lower()
    if (unit := UNITS.get(stated)) is None and stated:
        raise _question(f'the unit "{shown(stated)}" is not known', KNOWN_UNITS)
    names = parent.get("names", parent.get("labels"))
    if isinstance(entries, dict):
        names, entries = list(entries), list(entries.values())
    names = names if isinstance(names, list) and len(names) == len(entries) else []
    if not names and isinstance(entries[0], list) and len(entries) <= 3:  # may be x, y, z
        return _of_array(entries, unit)
    records = list[dict[str, str]]()
    for n, entry in enumerate(entries):
        record = {"name": names[n]} if names else {}
        record |= entry if isinstance(entry, dict) else {"place": entry}
        place = next((one for one in record.values() if isinstance(one, (list, dict)) and _is_place(one)), {})
        record |= dict(zip("xyz", place, strict=False)) if isinstance(place, list) else place
        records.append({key: str(one) for key, one in record.items() if not isinstance(one, (list, dict))})
    return _of_records(records, unit)


def _lists_of_places(key: str, value: Any, parent: dict[str, Any]) -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """Yield the lists in a JSON value that may be the positions: key, value, and the object that contains it."""
    inner = list(value.values()) if isinstance(value, dict) else value if isinstance(value, list) else []
    columns = [list(one.values()) if isinstance(one, dict) else one for one in inner]  # pandas: columns are objects
    of_columns = all(isinstance(one, list) and one for one in columns) and len(set(map(len, columns))) == 1
    if isinstance(value, dict) and of_columns and is_header(list(value)):
        yield key, [dict(zip(value, row, strict=True)) for row in zip(*columns, strict=True)], parent
    elif inner and (all(map(_is_place, inner)) or (isinstance(value, list) and len(inner) in (2, 3) and of_columns)):
        yield key, value, parent
    elif isinstance(value, dict):
        for name, one in value.items():
            yield from _lists_of_places(name, one, value)
    else:
        for one in filter(lambda one: isinstance(one, dict), inner):
            yield from _lists_of_places(key, one, parent)


def _is_place(value: Any, inside: bool = True) -> bool:
    """Return whether a JSON value describes a microphone: two or three numbers, or an object that contains them."""
    if isinstance(value, list):
        return len(value) in (2, 3) and all(type(one) in (int, float) for one in value)
    return isinstance(value, dict) and (
        is_header(list(value)) or (inside and any(_is_place(one, False) for one in value.values()))
    )


def _of_records(records: list[dict[str, str]], unit: float | None = None, unique: bool = True) -> Placed:
    """Return the positions in records, one for each microphone, from the keys with a meaning and the first name."""
    keys = list(dict.fromkeys(key for one in records for key in one if meaning(key)[0]))
    names = [key for key in keys if meaning(key)[0] == "name"]
    keys = [key for key in keys if key not in names[1:]]
    rows = {n: [one.get(key, "") for key in keys] for n, one in enumerate(records)}
    return _of_rows(keys, rows, "microphone", unit, unique)


def _of_array(values: Any, unit: float | None = None) -> Placed:
    """Return positions in an array (N, 2 or 3) or (2 or 3, N)."""
    array = np.asarray(values)
    axes = [axis for axis, length in enumerate(array.shape) if length in (2, 3)]
    if array.ndim != 2 or array.dtype.kind not in "fiu" or len(axes) != 1:
        problem = f"it is not clear which axis of shape {array.shape} ({array.dtype}) has the coordinates"
        raise _question(problem, "write a table: name,x,y,z")
    rows = (array if axes == [1] else array.T).tolist()
    return _of_records([dict(zip("xyz", map(repr, row), strict=False)) for row in rows], unit)


def _of_sheet(rows: Rows) -> Placed:
    """Return the positions in a sheet: lines of comments and titles, perhaps a header, then a line per microphone."""
    comments = {n: row for n, row in rows.items() if re.match("#|%|//", row[0]) and not (row[0] == "#" and row[1:])}
    body = {n: row for n, row in rows.items() if n not in comments} or dict(rows)
    width = max(map(len, body.values()), default=0)
    unit, head, said = None, None, ""
    for n, row in comments.items() if len(body) < len(rows) else ():
        cells = [row[0].lstrip("#%/ "), *row[1:]]
        if len(row) == width and sum(map(is_number, cells)) > 1:
            raise _question(f"line {n}: {shown(','.join(row))!r} may be a comment", "remove it, or its first character")
        if len(row) == width and is_header(cells):
            head = cells
        if word := IN_WORDS.search(" ".join(cells)):
            unit, said = UNITS[word[1].lower()], f'the unit is that of the comment "{shown(" ".join(cells))}"'
    first = list(body.items())
    titles = next((n for n, (_, row) in enumerate(first) if any(map(is_number, row))), len(first))
    header = next((n for n, (_, row) in enumerate(first[:titles]) if is_header(row)), titles - 1)
    if header >= 0 and (head is None or is_header(first[header][1])):
        head = first[header][1]
    data = dict(first[header + 1 :])
    if head is None and data:
        head = _assumed_header(list(data.values()), width)
    if not data or not head:
        found = shown(",".join(first[0][1])) if first else ""
        wanted = "the line name,x,y or name,x,y,z"
        raise _question(f'it must begin with {wanted}, not with "{found}"', "write one line per microphone below it")
    if head[0] == "#" and len(head) == 1 + len(first[-1][1]):  # a header in a comment: "#" is a cell of its own
        head = head[1:]
    number = min(data)
    units_row = [cell.strip("[]() -").lower() for cell in data[number]]
    if any(units_row) and set(units_row) <= {"", *UNITS} and len(data) > 1 and len(units_row) == len(head):
        head = [f"{cell} {unit}".strip() for cell, unit in zip(head, units_row, strict=True)]
        del data[number]
    if {len(row) for row in data.values()} == {len(head) + 1} and "name" not in [meaning(one)[0] for one in head]:
        head = ["", *head]  # R writes no header over its index
    names, places, remark = _of_rows(head, data, unit=unit)
    own = any(meaning(cell)[1] or meaning(cell)[0] == "unit" for cell in head)
    return names, places, remark or ("" if own else said)


def _assumed_header(rows: list[list[str]], width: int) -> list[str]:
    """Return a header for a table without one, from the number and the contents of its columns."""
    columns = [[row[c] if c < len(row) else "" for row in rows] for c in range(width)]
    counting = width == 3 and _counts(columns[0])
    if counting and all(cell.lstrip("+-").isdigit() for column in columns[1:] for cell in column):
        raise _question("its first column may be the numbers of the microphones or x", "begin with name,x,y or x,y,z")
    head = ["name"] if counting or not any(map(is_number, columns[0])) or width == 4 else []
    if width - len(head) not in (2, 3):
        raise _question(f"it has {width} columns and no line that names them", "begin with name,x,y or name,x,y,z")
    return [*head, *"xyz"[: width - len(head)]]


def _of_rows(
    head: list[str], rows: Rows, where: str = "line", unit: float | None = None, unique: bool = True
) -> Placed:
    """Return names and positions of the rows of a table below its header.

    `where` is the word for a row in messages; `unit`, as in UNITS, is used if the header has none. If a name occurs
    twice, the table is refused if `unique` is set; otherwise the microphones get numbers as names.
    """
    if [meaning(cell)[0] for cell in head].count("x") > 1:
        head, rows = _one_row_each(head, rows)
    kinds, units = zip(*map(meaning, head), strict=True)
    axes = ["x", "y", "z"] if "z" in kinds else ["x", "y"]
    if "x" not in kinds and "azimuth" in kinds:
        axes = ["azimuth", "polar" if "polar" in kinds else "elevation", "radius"]
    for axis in axes:
        if kinds.count(axis) != 1:
            problem = f'{"no" if axis not in kinds else "more than one"} column of "{shown(",".join(head))}" is {axis}'
            raise _question(problem, "call the columns name,x,y,z or name,azimuth (deg),elevation (deg),radius")
    columns = [kinds.index(axis) for axis in axes]
    for number, row in rows.items():
        if any(row[len(head) :]):
            problem = f"{where} {number}: {shown(','.join(row))!r} has more cells than the header"
            raise _question(problem, "separate cells by semicolons where the comma is the decimal sign")
        row += [""] * (len(head) - len(row))
        for axis, cell in ((head[c], row[c]) for c in columns):
            if not is_number(cell):
                raise _question(f'{where} {number}: {axis} = "{shown(cell)}" is not a number', "give a number")
    cells = list(zip(*(row[: len(head)] for row in rows.values()), strict=True))  # of each column
    written = "".join(cell for c in columns for cell in cells[c])
    if "," in written and "." in written:
        raise _question("its numbers have both commas and points", "use one decimal sign and no separator")
    names = _names(head, cells, columns, unique)
    places = np.array([[float(row[c].replace(",", ".")) for c in columns] for row in rows.values()])
    for number, place in zip(rows, places.tolist(), strict=True):
        require_point(f"{where} {number}", place, (len(axes),))
    for c in columns if unit is None and "unit" not in kinds else ():
        inside = None if units[c] or kinds[c] in ANGLES else IN_BRACKETS.search(head[c])
        if inside and not meaning(inside[1])[0]:
            raise _question(f'the unit "{shown(inside[1])}" of "{shown(head[c])}" is not known', KNOWN_UNITS)
    lengths = {units[c] for c in columns if kinds[c] not in ANGLES}
    if len(lengths) > 1 and lengths != {None, 1.0}:
        raise _question(f'the units in "{shown(",".join(head))}" differ', "give all coordinates in one unit")
    if "unit" in kinds:
        said = set(cells[kinds.index("unit")])
        lengths = {UNITS.get(said.pop().lower()) if len(said) == 1 else None}
        if None in lengths:
            raise _question("its column of units must hold a single known unit", KNOWN_UNITS)
    if axes[-1] == "radius":
        places = _cartesian(places, [head[c] for c in columns], axes[1] == "polar")
    unit, remark = next(filter(None, lengths), unit), ""
    if unit is None:
        # A single wrong row hardly changes the median.
        size = np.median(np.linalg.norm(places - np.median(places, axis=0), axis=1))
        if size > LARGEST_M:
            unit, remark = 1000.0, 'such large numbers are taken as millimetres; write "x (m)" if they are metres'
    return names, places / (unit or 1.0), remark


def _names(head: list[str], cells: list[tuple[str, ...]], used: list[int], unique: bool) -> list[str]:
    """Return the names of the rows, or their numbers; raise InputError for numbers in a column of unknown meaning."""
    kinds = [meaning(cell)[0] for cell in head]
    left = [c for c in range(len(head)) if c not in used and kinds[c] not in ("uncertainty", "unit")]
    naming = sorted((c for c in left if kinds[c] == "name"), key=lambda c: head[c] in ("", "#"))[:1]
    if not naming and left[:1] == [0] and not any("." in cell for cell in cells[0]):  # a name in another language
        naming = [0]
    for column in left:
        if column not in naming and any(map(is_number, cells[column])) and not _counts(list(cells[column])):
            problem = f'the column "{shown(head[column])}" of numbers is not understood'
            raise _question(problem, "call it z or name if it holds a coordinate or names, or remove it")
    names = list(cells[naming[0]]) if naming else []
    if len(set(names)) == len(names) > 0 and (unique or "" not in names):
        return names
    if names and unique:
        raise _question("it names a microphone twice", "keep one line for each microphone")
    return [str(n) for n in range(len(cells[used[0]]))]


def _cartesian(places: np.ndarray, head: list[str], polar: bool) -> np.ndarray:
    """Return x, y, z (N, 3) of azimuth, elevation (or, if `polar`, the angle from the z axis) and radius."""
    angles, radius = places[:, :2], places[:, 2]
    rad, deg = (np.array([re.search(unit, cell.lower()) is not None for cell in head[:2]]) for unit in ("rad", "deg|°"))
    if not (rad | deg).any() and np.abs(angles).max() <= 2 * np.pi:
        problem = f'the angles "{head[0]}" and "{head[1]}" may be degrees or radians'
        raise _question(problem, f'write "{head[0]} (deg)" or "{head[0]} (rad)"')
    angles = np.where(rad | (rad.any() & ~deg), angles, np.radians(angles))  # one unit may stand for both angles
    return from_spherical(angles[:, 0], np.pi / 2 - angles[:, 1] if polar else angles[:, 1], radius)


def _one_row_each(head: list[str], rows: Rows) -> tuple[list[str], Rows]:
    """Return one row for each microphone of a table of LOCATA with columns mic1_x, mic1_y, ... and rows of times."""
    groups: dict[str, dict[str, int]] = {}
    for column, cell in enumerate(head):
        if match := re.fullmatch(r"(.*\d)[\W_]*([xyz])", cell, re.IGNORECASE):
            groups.setdefault(match[1], {})[match[2].lower()] = column
    groups = {name: axes for name, axes in groups.items() if len(axes) > 1}
    try:
        table = np.array([[[float(row[c]) for c in one.values()] for one in groups.values()] for row in rows.values()])
    except (ValueError, IndexError):
        groups = {}
    if not groups:
        raise _question("several columns are called x", "give one line per microphone below name,x,y,z")
    if np.ptp(table, axis=0).max() > STILL_M:
        raise _question("its positions change from line to line", "keep one line, or write one per microphone")
    found = [[name, *(next(iter(rows.values()))[c] for c in axes.values())] for name, axes in groups.items()]
    return ["name", *next(iter(groups.values()))], dict(enumerate(found))


# For each suffix: the reader, and the message for a file that it cannot parse.
READERS = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat"), (_read_table, "not a text table")),
    ".xlsx": (_read_sheet, "not a readable Excel file"),
    ".xml": (_read_xml, "not valid XML"),
    ".json": (_read_object, "not valid JSON"),
    ".npy": (lambda content: _of_array(np.load(io.BytesIO(content), allow_pickle=False)), "not a readable array"),
    ".cfg": (_read_odas, "not an ODAS configuration"),
    ".sofa": (placed_receivers, "not a SOFA file"),
}


def _write(path: Path, placed: MicrophonePositions) -> None:
    """Write positions, metres, in CSV and XML to 0.1 µm; an unknown uncertainty is left empty, or null in JSON."""
    sigma = [None] * len(placed.names) if placed.uncertainty is None else placed.uncertainty.tolist()
    rows = [[name, *p, s] for name, p, s in zip(placed.names, placed.positions.tolist(), sigma, strict=True)]
    texts = [[f"{x:z.7f}" if isinstance(x, float) else x for x in row] for row in rows]
    keys = ["name", "x", "y", "z", "uncertainty"]
    if path.suffix.lower() == ".npy":
        np.save(path, np.ascontiguousarray(placed.positions.T))
    elif path.suffix.lower() == ".csv":
        with open(path, "w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([keys, *texts])
    elif path.suffix.lower() == ".json":
        table: dict[str, Any] = {"unit": "metre", "frame": placed.frame}
        table["microphones"] = [dict(zip(keys, row, strict=True)) for row in rows]
        path.write_text(json.dumps(table, indent=1, allow_nan=False, ensure_ascii=False) + "\n", encoding="utf-8")
    else:
        root = tree.Element("MicArray", name="fdcal")
        for name, *place, _ in texts:
            if re.search("[\x00-\x1f\ud800-\udfff\ufffe\uffff]", name):
                raise InputError(f"the name {name!r} cannot be written in XML", "rename that microphone")
            tree.SubElement(root, "pos", {"Name": name} | dict(zip("xyz", place, strict=True)))
        tree.indent(root)
        tree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


FORMATS = (Format((".csv", ".xml", ".npy", ".json"), write=_write),)
