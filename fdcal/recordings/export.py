"""Write a calibration to files of other programs."""

import xml.etree.ElementTree as tree
from os import PathLike
from pathlib import Path

import numpy as np

from ..assessment.calibration import Calibration, placed_in_frame
from ..assessment.result_file import channel_table
from ..model.storage import write_atomically
from ..model.validation import InputError, require_choice
from . import formats


def export(
    self: Calibration,
    path: str | PathLike[str],
    *,
    frame: str | None = None,
    table: str = "positions",
    force: bool = False,
) -> None:
    """Write the positions, or the gains of the channels, for another program; the suffix selects the format.

    Parameters
    ----------
    path : str or path
        Ends in .csv (a table), .json, .xml (Acoular), .sofa or .npy (pyroomacoustics).
    frame : str, optional
        Other coordinate axes than those of `Calibration.positions`: "known", "minimal" or "axes" (`Calibration.frame`).
    table : str
        What to write: "positions"; or "gains", those that solver "robust" found for the channels, as a .csv table or as
        factors for Acoular (.xml).
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
    path, allowed = Path(path), GAIN_TEXTS if table == "gains" else formats.suffixes("write")
    require_choice("table", table, ("positions", "gains"))
    suffix = path.suffix.lower()
    if suffix not in allowed:
        raise InputError(f'"{path}" is not a file of {table}', f"use one of {', '.join(allowed)}", key="output")
    if table == "positions":
        placed = placed_in_frame(self, frame)
        write_atomically(path, lambda file: formats.write(file, placed), force)
        return
    if frame is not None:
        raise InputError("a table of gains has no frame", "leave out <frame>", key="frame")
    text = GAIN_TEXTS[suffix](self)
    write_atomically(path, lambda file: file.write_text(text, encoding="utf-8"), force)


def acoular_factors(result: Calibration) -> str:
    """Return the XML of Acoular's `Calib`: a factor for each channel, negative if it is inverted, 0 if it is dead.

    Acoular interprets a factor as pascals per unit; these factors are relative to the median channel.
    """
    channel_table(result)  # refuses a result without gains
    channels = result.channels
    assert channels is not None
    factors = np.copysign(10 ** (-channels.gain_db / 20), np.cos(np.radians(channels.phase_deg)))
    dead = {fault.name for fault in channels.faults if fault.kind == "dead"}
    root = tree.Element("Calib", name="relative to the median channel")
    for name, factor in zip(result.names, factors, strict=True):
        tree.SubElement(root, "pos", Name=name, factor=repr(0.0 if name in dead else float(factor)))
    tree.indent(root)
    return tree.tostring(root, "unicode", xml_declaration=True) + "\n"


GAIN_TEXTS = {".csv": channel_table, ".xml": acoular_factors}
