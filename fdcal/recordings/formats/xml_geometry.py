"""Acoular's microphone geometry: `<MicArray><pos Name= x= y= z= /></MicArray>`, metres."""

from __future__ import annotations

import math
import xml.etree.ElementTree as tree
from pathlib import Path

import numpy as np

from ...model.given_positions import MicrophonePositions
from ...model.reading import read_bytes
from ...model.validation import InputError, shown
from .table import MOST_BYTES, NUMBER

SUFFIXES = (".xml",)


def write(path: Path, placed: MicrophonePositions, original: str | None = None) -> None:
    """Write `placed`; raise InputError for a name that XML cannot hold."""
    root = tree.Element("MicArray", name="fdcal")
    for name, place in zip(placed.names, placed.positions.tolist(), strict=True):
        if any(
            ord(letter) < 32 or 0xD800 <= ord(letter) < 0xE000 or ord(letter) in (0xFFFE, 0xFFFF) for letter in name
        ):
            raise InputError(f"the name {name!r} cannot be written in XML", "rename that microphone")
        coordinates = {axis: repr(value) for axis, value in zip("xyz", place, strict=True)}
        tree.SubElement(root, "pos", {"Name": name} | coordinates)
    tree.indent(root)
    tree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def read_positions(path: str | Path) -> tuple[list[str], np.ndarray]:
    """Return the microphones of a geometry.

    Returns (N, 3) float64, names, or numbers from 0 where not all have different names; positions, metres. Raises
    InputError: the file is no geometry; StorageError: the file cannot be read.
    """
    try:
        elements = tree.fromstring(read_bytes(path, MOST_BYTES)).findall("pos")
    except (tree.ParseError, ValueError, LookupError) as error:  # broken, or of an encoding that does not exist
        raise InputError(f"{path} is not valid XML: {shown(str(error))}", key="positions", value=str(path)) from error
    if not elements:
        raise InputError(f"{path} holds no <pos> inside its first element", "give a geometry of Acoular")
    places = [[_metres(path, element, axis, row) for axis in "xyz"] for row, element in enumerate(elements)]
    names = [element.get("Name", "") for element in elements]
    if "" in names or len(set(names)) < len(names):
        names = [str(row) for row in range(len(elements))]
    return names, np.array(places)


def _metres(path: str | Path, element: tree.Element, axis: str, row: int) -> float:
    text = element.get(axis, "0" if axis == "z" else "")
    value = float(text) if NUMBER.fullmatch(text.strip()) else math.nan
    if not math.isfinite(value):
        raise InputError(
            f'{path}: {axis} = "{shown(text)}" of microphone {row} is no number',
            "give metres",
            key="positions",
            value=text,
        )
    return value
