"""What the columns of a table of positions mean: coordinates, names, units, angles.

A table is a header and rows of cells as text, by the number of the line or of the microphone. What can mean only one
thing is read; what is ambiguous raises an InputError that says what to write. No column of numbers is dropped silently.
"""

import logging
import re
from pathlib import Path

import numpy as np

from ..model.validation import InputError, require_point, shown

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)  # Python also takes 1_0 for a number
LARGEST_M = 50.0  # median distance from the middle of an array; larger numbers without a unit are millimetres
STILL_M = 1e-3  # an array that moves less stands still
ANGLES = ("azimuth", "elevation", "polar")
# Words of a header, and what the column holds; the first meaning counts.
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
# How many make a metre.
UNITS = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("dm",), 10.0),
    **dict.fromkeys(("cm", "centimetre", "centimetres", "centimeter", "centimeters"), 100.0),
    **dict.fromkeys(("mm", "millimetre", "millimetres", "millimeter", "millimeters"), 1000.0),
    **dict.fromkeys(("in", "inch", "inches"), 1 / 0.0254),
    **dict.fromkeys(("ft", "foot", "feet"), 1 / 0.3048),
}
IN_WORDS = re.compile(rf"(?:\bin|\bunits?\b\W*|[\[(])\s*({'|'.join(UNITS)})\b", re.IGNORECASE)  # of a comment

log = logging.getLogger(__name__)

Rows = dict[int, list[str]]  # cells by the number of the line or microphone
Places = tuple[list[str], np.ndarray]  # names, and positions (N, 2 or 3), metres


def question(path: Path, problem: str, remedy: str, value: object = None) -> InputError:
    """Return the error for a file of positions that is damaged or ambiguous."""
    return InputError(f"{path}{problem}", remedy, key="positions", value=str(path) if value is None else value)


def is_number(cell: str) -> bool:
    return NUMBER.fullmatch(cell.replace(",", ".", 1)) is not None


def meaning(cell: str) -> tuple[str, float | None]:
    """Return what the column of a header holds, of MEANINGS or "" where it is not known, and its unit."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", cell)  # posX, XPos
    words = re.findall(r"[^\W\d_]+", re.sub(r"\b([xyz])(mm|cm|m|in|ft)\b", r"\1 \2", spaced.lower()))
    found = [kind for kind, known in MEANINGS.items() if set(words) & set(known.split())]
    if len(set(words) & set("xyz")) > 1:  # a sentence
        return "", None
    unit = UNITS.get(words[-1]) if len(words) > 1 else None
    return (found[0] if found else "name" if cell in ("", "#") else ""), unit


def is_header(row: list[str]) -> bool:
    kinds = {meaning(cell)[0] for cell in row}
    return kinds >= {"x", "y"} or kinds >= {"azimuth", "radius"}


def places_of_sheet(path: Path, rows: Rows) -> Places:
    """Return what the lines of a sheet hold: comments, titles, a header or none, microphones."""
    comments = {n: row for n, row in rows.items() if re.match("#|%|//", row[0]) and not (row[0] == "#" and row[1:])}
    body = {n: row for n, row in rows.items() if n not in comments} or dict(rows)
    width = max(map(len, body.values()), default=0)
    unit, head = None, None
    for n, row in comments.items() if len(body) < len(rows) else ():
        cells = [row[0].lstrip("#%/ "), *row[1:]]
        if len(row) == width and sum(map(is_number, cells)) > 1:
            raise question(path, f", line {n}: is {shown(','.join(row))!r} a comment?", "remove it, or its first sign")
        if len(row) == width and is_header(cells):
            head = cells
        if word := IN_WORDS.search(" ".join(cells)):
            unit = UNITS[word[1].lower()]
            log.warning('%s: the unit is that of the comment "%s"', path, shown(" ".join(cells)))
    first = list(body.items())
    titles = next((n for n, (_, row) in enumerate(first) if any(map(is_number, row))), len(first))
    header = next((n for n, (_, row) in enumerate(first[:titles]) if is_header(row)), titles - 1)
    if header >= 0 and (head is None or is_header(first[header][1])):
        head = first[header][1]
    data = dict(first[header + 1 :])
    if head is None and data:
        head = _assumed_header(path, list(data.values()), width)
    if not data or not head:
        found = shown(",".join(first[0][1])) if first else ""
        wanted = "the line name,x,y or name,x,y,z and hold one line per microphone"
        raise question(path, f' must begin with {wanted}, not with "{found}"', "add that line")
    if head[0] == "#" and len(head) == 1 + len(first[-1][1]):  # a comment with spaces between its cells
        head = head[1:]
    number = min(data)
    units_row = [cell.strip("[]() -").lower() for cell in data[number]]
    if any(units_row) and set(units_row) <= {"", *UNITS} and len(data) > 1 and len(units_row) == len(head):
        head = [f"{cell} {unit}".strip() for cell, unit in zip(head, units_row, strict=True)]
        del data[number]
    if {len(row) for row in data.values()} == {len(head) + 1} and "name" not in [meaning(one)[0] for one in head]:
        head = ["", *head]  # as R writes an index
    return places_of_rows(path, head, data, unit=unit)


def _assumed_header(path: Path, rows: list[list[str]], width: int) -> list[str]:
    """Return the header of a table that has none, by the kinds and the number of its columns."""
    columns = [[row[c] if c < len(row) else "" for row in rows] for c in range(width)]
    named = not any(map(is_number, columns[0]))
    counting = width == 3 and _counts(columns[0])
    if counting and all(cell.lstrip("+-").isdigit() for column in columns[1:] for cell in column):
        problem = ": its first column may be numbers of microphones or x"
        raise question(path, problem, "begin with the line name,x,y or x,y,z")
    head = ["name"] if named or counting or width == 4 else []
    if width - len(head) not in (2, 3):
        problem = f" has {width} columns and no line that names them"
        raise question(path, problem, "begin with the line name,x,y or name,x,y,z")
    return [*head, *"xyz"[: width - len(head)]]


def _counts(cells: list[str]) -> bool:
    """Return whether the cells are 0, 1, 2, ... or 1, 2, 3, ..."""
    return any(cells == [str(n) for n in range(first, first + len(cells))] for first in (0, 1))


def places_of_rows(
    path: Path, head: list[str], rows: Rows, where: str = "line", unit: float | None = None, unique: bool = True
) -> Places:
    """Return names and positions of the rows of a table below its header.

    `where`: what a row is; `unit`: how many make a metre where the header does not say it; `unique`: whether a name
    that occurs twice is refused; otherwise the microphones are numbered.
    """
    if [meaning(cell)[0] for cell in head].count("x") > 1:
        head, rows = _one_row_each(path, head, rows)
    kinds, units = zip(*map(meaning, head), strict=True)
    axes = ["x", "y", "z"] if "z" in kinds else ["x", "y"]
    if "x" not in kinds and "azimuth" in kinds:
        axes = ["azimuth", "polar" if "polar" in kinds else "elevation", "radius"]
    for axis in axes:
        if kinds.count(axis) != 1:
            problem = (
                f': {"no" if axis not in kinds else "more than one"} column of "{shown(",".join(head))}" is {axis}'
            )
            remedy = "call the columns name,x,y,z or name,azimuth (deg),elevation (deg),radius"
            raise question(path, problem, remedy)
    columns = [kinds.index(axis) for axis in axes]
    for number, row in rows.items():
        if any(row[len(head) :]):
            problem = f", {where} {number}: {shown(','.join(row))!r} has more cells than the header"
            raise question(path, problem, "separate cells by semicolons where the comma is the decimal sign")
        row += [""] * (len(head) - len(row))
        for axis, cell in ((head[c], row[c]) for c in columns):
            if not is_number(cell):
                problem = f', {where} {number}: {axis} = "{shown(cell)}" is no number'
                raise question(path, problem, "give a number", cell)
    cells = list(zip(*(row[: len(head)] for row in rows.values()), strict=True))  # of each column
    written = "".join(cell for c in columns for cell in cells[c])
    if "," in written and "." in written:
        raise question(path, " has numbers with a comma and with a point", "write one decimal sign and no thousands")
    names = _names(path, head, cells, columns, unique)
    places = np.array([[float(row[c].replace(",", ".")) for c in columns] for row in rows.values()])
    for number, place in zip(rows, places.tolist(), strict=True):
        require_point(f"{path}, {where} {number}", place, (len(axes),))
    lengths = {units[c] for c in columns if kinds[c] not in ANGLES}
    if len(lengths) > 1 and lengths != {None, 1.0}:
        raise question(path, f': the units in "{shown(",".join(head))}" differ', "give all coordinates the same")
    if "unit" in kinds:
        said = set(cells[kinds.index("unit")])
        lengths = {UNITS.get(said.pop().lower()) if len(said) == 1 else None}
        if None in lengths:
            raise question(path, ": its column of units does not hold one unit that is known", "write mm, cm or m")
    if axes[-1] == "radius":
        places = _cartesian(path, places, [head[c] for c in columns], axes[1] == "polar")
    unit = next(filter(None, lengths), unit)
    if unit is None:
        # The median, because one wrong row must not count.
        size = np.median(np.linalg.norm(places - np.median(places, axis=0), axis=1))
        unit = 1000.0 if size > LARGEST_M else 1.0
        if unit != 1:
            log.warning('%s: such large numbers are taken as millimetres; write "x (m)" where they are metres', path)
    return names, places / unit


def _names(path: Path, head: list[str], cells: list[tuple[str, ...]], used: list[int], unique: bool) -> list[str]:
    """Return the names of the rows, or their numbers; refuse a column of numbers that is neither used nor a count."""
    kinds = [meaning(cell)[0] for cell in head]
    left = [c for c in range(len(head)) if c not in used and kinds[c] not in ("uncertainty", "unit")]
    naming = sorted((c for c in left if kinds[c] == "name"), key=lambda c: head[c] in ("", "#"))[:1]
    if not naming and left[:1] == [0] and not any("." in cell for cell in cells[0]):  # in another language
        naming = [0]
    for column in left:
        if column not in naming and any(map(is_number, cells[column])) and not _counts(list(cells[column])):
            problem = f': the column "{shown(head[column])}" of numbers is not understood'
            remedy = "call a third coordinate z, the names name, or remove the column"
            raise question(path, problem, remedy, head[column])
    names = list(cells[naming[0]]) if naming else []
    if len(set(names)) == len(names) > 0 and (unique or "" not in names):
        return names
    if names and unique:
        raise question(path, " names a microphone twice", "keep one line of each")
    return [str(n) for n in range(len(cells[used[0]]))]


def _cartesian(path: Path, places: np.ndarray, head: list[str], polar: bool) -> np.ndarray:
    """Return x, y, z (N, 3) of azimuth, elevation, or the angle from the z axis where `polar`, and radius."""
    angles, radius = places[:, :2], places[:, 2]
    words = " ".join(head[:2]).lower()
    if "rad" not in words:
        if "deg" not in words and "°" not in words and np.abs(angles).max() <= 2 * np.pi:
            problem = f': the angles "{head[0]}" and "{head[1]}" may be degrees or radians'
            raise question(path, problem, f'write "{head[0]} (deg)" or "{head[0]} (rad)"')
        angles = np.radians(angles)
    azimuth, elevation = angles[:, 0], np.pi / 2 - angles[:, 1] if polar else angles[:, 1]
    across = radius * np.cos(elevation)
    return np.column_stack([across * np.cos(azimuth), across * np.sin(azimuth), radius * np.sin(elevation)])


def _one_row_each(path: Path, head: list[str], rows: Rows) -> tuple[list[str], Rows]:
    """Return a row for each microphone, of columns mic1_x, mic1_y, ... and a row for each time, as LOCATA has them."""
    groups: dict[str, dict[str, int]] = {}
    for column, cell in enumerate(head):
        if match := re.fullmatch(r"(.*\d)[\W_]*([xyz])", cell, re.IGNORECASE):
            groups.setdefault(match[1], {})[match[2].lower()] = column
    groups = {name: axes for name, axes in groups.items() if len(axes) > 1}
    try:
        table = np.array(
            [[[float(row[c]) for c in axes.values()] for axes in groups.values()] for row in rows.values()]
        )
    except (ValueError, IndexError):
        groups = {}
    if not groups:
        problem = ": more than one column is called x, and they are not those of microphones with numbers"
        raise question(path, problem, "give one line per microphone below name,x,y,z")
    if np.ptp(table, axis=0).max() > STILL_M:
        problem = " has microphones whose positions change from line to line"
        raise question(path, problem, "keep one line, or write one line per microphone below name,x,y,z")
    first = next(iter(rows.values()))
    found = [[name, *(first[c] for c in axes.values())] for name, axes in groups.items()]
    return ["name", *next(iter(groups.values()))], dict(enumerate(found))
