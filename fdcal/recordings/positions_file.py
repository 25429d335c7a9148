"""Files of positions of all microphones: Acoular's XML, or a table."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from ..model.given_positions import MicrophonePositions
from ..model.validation import InputError
from .formats import table, xml_geometry

READERS = {suffix: module.read_positions for module in (table, xml_geometry) for suffix in module.SUFFIXES}


def read_positions(path: str | PathLike[str]) -> MicrophonePositions:
    """Return the positions in a file of Acoular (.xml) or a table with the columns name,x,y[,z] (.csv).

    Raises InputError: the file holds no positions; StorageError: the file cannot be read.
    """
    path = Path(path)
    if path.suffix.lower() not in READERS:
        raise InputError(
            f'"{path}" ends in no suffix of a file of positions',
            f"give <positions> as {', '.join(sorted(READERS))}",
            key="positions",
            value=str(path),
        )
    names, positions = READERS[path.suffix.lower()](path)
    return MicrophonePositions(tuple(names), positions, frame=path.name)
