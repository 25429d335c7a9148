"""Acoular's microphone geometry: `<MicArray><pos Name= x= y= z= /></MicArray>`, metres."""

from __future__ import annotations

import xml.etree.ElementTree as tree
from pathlib import Path

from ...model.microphones import MicrophonePositions
from ...model.validation import InputError

NAME = "Acoular microphone geometry"
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
