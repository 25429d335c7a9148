"""A calibration in a file of another program: what `fdcal export` and `Calibration.export` write."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from ..assessment.calibration import Calibration, placed_in_frame
from ..assessment.result_file import channel_table
from ..model.given_positions import MicrophonePositions
from ..model.storage import write_atomically
from ..model.validation import InputError, require_choice
from . import formats


def export(
    self: Calibration,
    path: str | PathLike[str],
    *,
    frame: str | None = None,
    original: str | PathLike[str] | None = None,
    table: str = "positions",
    force: bool = False,
) -> None:
    """Write the positions, or the gains of the channels, for another program; the suffix selects the format.

    Parameters
    ----------
    path : str or path
        Ends in .csv (a table), .json, .xml (Acoular), .sofa or .npy (pyroomacoustics).
    frame : str, optional
        "known", the axes of the known microphones, as by default; "minimal" or "axes", as by default without any.
    original : str or path, optional
        A SOFA file into a copy of which the positions are written.
    table : str
        "positions", or "gains": a .csv table of gain, phase and noise of every channel, of solver "robust".
    force : bool
        Whether an existing file is overwritten.

    Raises
    ------
    InputError
        No format has this suffix, the frame does not exist, or the file exists and `force` is not set.
    StorageError
        The file cannot be written.

    Examples
    --------
    >>> import tempfile, fdcal
    >>> from pathlib import Path
    >>> found = fdcal.calibrate(fdcal.load("tiny"), modes=12)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     found.export(f"{folder}/tiny.csv")
    ...     Path(f"{folder}/tiny.csv").read_text().splitlines()[0]
    'name,x,y,z,uncertainty'
    """
    require_choice("table", table, ("positions", "gains"))
    if table == "gains":
        export_gains(self, path, force)
    else:
        export_positions(self, path, frame, original, force)


def export_positions(
    result: Calibration,
    path: str | PathLike[str],
    frame: str | None = None,
    original: str | PathLike[str] | None = None,
    force: bool = False,
) -> MicrophonePositions:
    """Write the positions of a result, and return them as written; see `Calibration.export`."""
    path, given = Path(path), None if original is None else str(original)
    if path.suffix.lower() not in formats.suffixes("write"):
        raise InputError(
            f'"{path}" ends in no suffix of a format for positions',
            f"use one of {', '.join(formats.suffixes('write'))}",
            key="output",
            value=str(path),
        )
    if given is not None and path.suffix.lower() != ".sofa":
        problem = f"original = {given} is for files of SOFA"
        raise InputError(problem, f"leave out <original> for {path.suffix}", key="original", value=given)
    placed = placed_in_frame(result, frame)
    write_atomically(path, lambda file: formats.write(file, path, placed, given), force)
    return placed


def export_gains(result: Calibration, path: str | PathLike[str], force: bool = False) -> None:
    """Write the gains of the channels as a table; see `fdcal.assessment.result_file.channel_table`.

    Raises InputError: the result holds no gains, the suffix is not .csv, or the file exists and `force` is not set;
    StorageError: the file cannot be written.
    """
    path, text = Path(path), channel_table(result)
    if path.suffix.lower() != ".csv":
        problem = f'"{path}" does not end in .csv, as the table of gains does'
        raise InputError(problem, f"write {path.stem or 'gains'}.csv", key="output", value=str(path))
    write_atomically(path, lambda file: file.write_text(text, encoding="utf-8"), force)
