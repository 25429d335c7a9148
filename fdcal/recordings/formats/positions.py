"""Positions of microphones in the files of other programs.

Written:
.csv     name,x,y,z,uncertainty, metres, one line per microphone
.xml     Acoular's microphone geometry: `<MicArray><pos Name= x= y= z= /></MicArray>`, metres
.npy     as pyroomacoustics reads it: an array (3, N), metres, one column per microphone
.json    one object with the frame and a list of microphones

Read: these, tables in text form and of Excel, geometries of HARK, TASCAR and ODAS, other JSON, and SOFA.
"""

import csv
import io
import json
import re
import xml.etree.ElementTree as tree
import zipfile
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ...model.measurement import MicrophonePositions
from ...model.storage import read_bytes, require_regular
from ...model.validation import InputError, StorageError, shown
from ..position_table import (
    UNITS,
    Places,
    Rows,
    is_header,
    is_number,
    meaning,
    places_of_rows,
    places_of_sheet,
    question,
)
from . import Format, damaged, isolated_call
from .sofa import placed_receivers

MAX_BYTES = 10_000_000  # of a file of positions
HEADER = ["name", "x", "y", "z", "uncertainty"]


def read_positions(path: str | PathLike[str]) -> MicrophonePositions:
    """Return the positions in a file of any kind that `read_places` reads."""
    names, positions = read_places(path)
    return MicrophonePositions(tuple(names), positions, frame=Path(path).name)


def read_places(path: str | PathLike[str]) -> Places:
    """Return names and positions (N, 2 or 3), metres, in a file of any kind of READERS."""
    path = Path(path)
    if path.suffix.lower() not in READERS:
        problem = f'"{path}" ends in no suffix of a file of positions'
        raise InputError(problem, f"give <positions> as {', '.join(sorted(READERS))}", key="positions", value=str(path))
    return READERS[path.suffix.lower()](path)


def _text(path: Path) -> str:
    """Return the text of a file as editors and spreadsheets write it."""
    content = read_bytes(path, MAX_BYTES)
    try:
        return content.decode("utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", "replace")


def _read_table(path: Path) -> Places:
    """Return the positions in a table of any delimiter: that by which its cells are numbers."""
    text = _text(path)
    separator = re.match(r'"?sep=(.)"?\r?\n', text)  # a first line of Excel
    found = list[tuple[bool, int, Rows]]()
    for delimiter in separator[1] if separator else ",;\t| ":
        lines = re.sub(r"[ \t]+", " ", text) if delimiter == " " else text
        try:
            reader = csv.reader(io.StringIO(lines, newline=""), delimiter=delimiter, skipinitialspace=True)
            numbered = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
        except csv.Error as error:
            raise question(path, f" is not a table in text form: {error}", "save it as .csv") from error
        rows = {n: row for n, row in numbered if any(row)}
        numeric = [[is_number(cell) for cell in row if cell] for row in rows.values()]
        score = sum(2 * sum(row) - len(row) for row in numeric if any(row))
        found.append((any(map(is_header, rows.values())), score, rows))
    rows = max(found, key=lambda one: one[:2])[2]
    if separator:
        rows.pop(1)
    return places_of_sheet(path, rows)


def _parsed_xml(path: Path, content: bytes) -> tree.Element:
    try:
        return tree.fromstring(content)
    except (tree.ParseError, ValueError, LookupError) as error:  # broken, or of an encoding that does not exist
        raise question(path, f" is not valid XML: {shown(str(error))}", "write it again") from error


def _read_sheet(path: Path) -> Places:
    """Return the positions in the only sheet with cells of an Excel file."""
    main, sheets = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}", list[Rows]()
    try:
        with zipfile.ZipFile(io.BytesIO(read_bytes(path, MAX_BYTES))) as file:
            names = [one for one in file.namelist() if re.fullmatch(r"xl/(worksheets/[^/]+|sharedStrings)\.xml", one)]
            if sum(file.getinfo(name).file_size for name in names) > 10 * MAX_BYTES:
                raise question(path, " unfolds to too many bytes", "save the table as .csv")
            parts = {name: _parsed_xml(path, file.read(name)) for name in names}
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
    except (zipfile.BadZipFile, KeyError, ValueError, IndexError, AttributeError) as error:
        raise question(path, f" is no sheet of Excel that can be read: {error}", "save it as .csv") from error
    if len(sheets) != 1:
        raise question(path, f" has {len(sheets)} sheets with cells", "keep the one with the positions")
    return places_of_sheet(path, sheets[0])


def _read_xml(path: Path) -> Places:
    """Return the positions in elements with the attributes x, y and z, or position="x y z", of one element."""
    found = list[tuple[str, list[dict[str, str]]]]()
    for parent in _parsed_xml(path, read_bytes(path, MAX_BYTES)).iter():
        records = list[dict[str, str]]()
        for element in parent:
            record = {key.lower(): text.strip() for key, text in element.attrib.items()}
            values = record.pop("position", "").split()
            records.append(record | dict(zip("xyz", values, strict=False)))
        records = [one for one in records if {"x", "y"} & set(one)]
        if records:
            found.append((" ".join([parent.tag, *parent.attrib.values()]), records))
    if len(found) > 1:
        found = [one for one in found if "mic" in one[0].lower()]
    if len(found) != 1:
        problem = " holds no positions in one place: no <pos> with x, y and z"
        raise question(path, problem, "give a geometry of Acoular: <MicArray><pos Name= x= y= z=>")
    return _of_records(path, found[0][1], unique=False)


def _of_records(path: Path, records: list[dict[str, str]], unit: float | None = None, unique: bool = True) -> Places:
    """Return the positions in records of texts, one for each microphone, of which coordinates and one name count."""
    keys = list(dict.fromkeys(key for one in records for key in one if meaning(key)[0]))
    names = [key for key in keys if meaning(key)[0] == "name"]
    keys = [key for key in keys if key not in names[1:]]
    rows = {n: [one.get(key, "") for key in keys] for n, one in enumerate(records)}
    return places_of_rows(path, keys, rows, "microphone", unit, unique)


def _of_array(path: Path, values: Any, unit: float | None = None) -> Places:
    """Return positions in an array (N, 2 or 3) or (2 or 3, N)."""
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise question(path, " holds lists of different lengths", "give each microphone as many numbers") from error
    axes = [axis for axis, length in enumerate(array.shape) if length in (2, 3)]
    if array.ndim != 2 or array.dtype.kind not in "fiu" or len(axes) != 1:
        problem = f": it is not clear which axis of shape {array.shape} is that of the microphones"
        raise question(path, problem, "write a table: name,x,y,z")
    rows = (array if axes == [1] else array.T).tolist()
    return _of_records(path, [dict(zip("xyz", map(repr, row), strict=False)) for row in rows], unit)


def _read_array(path: Path) -> Places:
    with damaged(f"{path} is no array that can be read", "write it with numpy.save"):
        values = np.load(io.BytesIO(read_bytes(path, MAX_BYTES)), allow_pickle=False)
    return _of_array(path, values)


def _is_place(value: Any, inside: bool = True) -> bool:
    """Return whether a value of JSON is a microphone: two or three numbers, or an object that has them."""
    if isinstance(value, list):
        return len(value) in (2, 3) and all(type(one) in (int, float) for one in value)
    return isinstance(value, dict) and (
        is_header(list(value)) or (inside and any(_is_place(one, False) for one in value.values()))
    )


def _read_object(path: Path) -> Places:
    """Return the positions in JSON: the only list, or object by names, of microphones, or object of columns."""
    try:
        waiting: list[tuple[str, Any, dict[str, Any]]] = [("", json.loads(_text(path)), {})]
    except (ValueError, RecursionError) as error:
        raise question(path, f" is not valid JSON: {shown(str(error))}", "write it again") from error
    found = list[tuple[str, Any, dict[str, Any]]]()
    while waiting:
        key, value, parent = waiting.pop()
        inner = list(value.values()) if isinstance(value, dict) else value if isinstance(value, list) else []
        if isinstance(value, dict) and is_header(list(value)):  # columns of pandas are objects by index
            value = {name: list(one.values()) if isinstance(one, dict) else one for name, one in value.items()}
            inner = list(value.values())
        columns = is_header(list(value)) if isinstance(value, dict) else len(inner) in (2, 3)  # or x, y, z as lists
        if inner and (all(map(_is_place, inner)) or (columns and all(isinstance(one, list) and one for one in inner))):
            found.append((key, value, parent))
        elif isinstance(value, dict):
            waiting += [(name, one, value) for name, one in value.items()]
        else:
            waiting += [(key, one, parent) for one in inner if isinstance(one, dict)]
    of_microphones = [one for one in found if re.search("mic|receiver|^positions$", one[0].lower())]
    found = of_microphones if len(of_microphones) == 1 else found
    if len(found) != 1:
        which = f"{len(found)} lists that may be the positions" if found else "no list of positions"
        names = ", ".join(shown(one[0]) for one in found[:5])
        raise question(
            path,
            f" holds {which}{names and ': ' + names}",
            'write [{"name": "0", "x": 0.1, "y": 0, "z": 0}, ...], metres',
        )
    _, value, parent = found[0]
    unit = UNITS.get(str(parent.get("unit", parent.get("units", ""))).lower())
    names, entries = parent.get("names", parent.get("labels")), value
    if isinstance(value, dict):
        if is_header(list(value)):
            entries = [dict(zip(value, one, strict=True)) for one in zip(*value.values(), strict=True)]
        else:
            names, entries = list(value), list(value.values())
    names = names if isinstance(names, list) and len(names) == len(entries) else []
    if not names and isinstance(entries[0], list) and len(entries) <= 3:  # may be x, y, z
        return _of_array(path, entries, unit)
    records = list[dict[str, str]]()
    for n, entry in enumerate(entries):
        record = {"name": names[n]} if names else {}
        record |= entry if isinstance(entry, dict) else {"place": entry}
        place = next((one for one in record.values() if isinstance(one, (list, dict)) and _is_place(one)), {})
        record |= dict(zip("xyz", place, strict=False)) if isinstance(place, list) else place
        records.append({key: str(one) for key, one in record.items() if not isinstance(one, (list, dict))})
    return _of_records(path, records, unit)


def _read_odas(path: Path) -> Places:
    """Return the positions `mu` of the microphones in a configuration of ODAS."""
    text = re.sub(r"(//|#).*", "", _text(path))
    found = re.findall(r"\bmu\s*=\s*[(\[]([^)\]]*)[)\]]", text)
    if not found:
        raise question(path, " holds no microphone: mu = ( x, y, z )", "give a configuration of ODAS")
    return _of_records(path, [dict(zip("xyz", map(str.strip, one.split(",")), strict=False)) for one in found])


def _read_sofa(path: Path) -> Places:
    if not path.exists():
        raise StorageError(f"cannot read {path}: No such file or directory")
    require_regular(path)
    positions = isolated_call(path, placed_receivers, path)
    return [str(n) for n in range(len(positions))], positions


def _write_table(path: Path, placed: MicrophonePositions, original: str | None = None) -> None:
    """Write `placed`, metres with all digits; an unknown uncertainty is left empty."""
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEADER)
        for n, (name, place) in enumerate(zip(placed.names, placed.positions.tolist(), strict=True)):
            writer.writerow([name, *place, "" if placed.uncertainty is None else float(placed.uncertainty[n])])


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


READERS = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat"), _read_table),
    ".xlsx": _read_sheet,
    ".xml": _read_xml,
    ".json": _read_object,
    ".npy": _read_array,
    ".cfg": _read_odas,
    ".sofa": _read_sofa,
}
FORMATS = (
    Format((".csv",), write=_write_table),
    Format((".xml",), write=_write_xml),
    Format((".npy",), write=_write_columns),
    Format((".json",), write=_write_object),
)
