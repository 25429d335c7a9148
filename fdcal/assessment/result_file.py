"""The JSON file of a calibration: `save_result` writes it, `load_result` reads and checks it."""

from __future__ import annotations

import json
from pathlib import Path

from ..model.limits import LIMITS
from ..model.reading import read_bytes
from ..model.storage import write_atomically
from ..model.validation import InputError
from .calibration import Calibration
from .position_check import PositionCheck


def save_result(result: Calibration, path: str | Path, force: bool = False, check: PositionCheck | None = None) -> None:
    """Write a calibration as JSON.

    Parameters
    ----------
    result : Calibration
    path : str or Path
    force : bool
        Whether an existing file is overwritten.
    check : PositionCheck, optional
        A comparison with a list of positions, written as the key "check", which `load_result` leaves out.

    Raises
    ------
    InputError
        A value is not finite, or the file exists and `force` is not set.
    StorageError
        The file cannot be written.
    """
    text = result.to_json()
    if check is not None:
        text = json.dumps(json.loads(text) | {"check": check.table(result.names)}, indent=1, allow_nan=False) + "\n"
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"), force)


def load_result(path: str | Path) -> Calibration:
    """Return the calibration of a JSON file.

    Raises
    ------
    InputError
        The file is no result: a key is missing or malformed.
    StorageError
        The file cannot be read.
    """
    content = read_bytes(path, LIMITS.result)
    if not content.lstrip()[:1] == b"{":
        remedy = "give the .json file that `fdcal calibrate -o` writes"
        raise InputError(f"{path} is not a result", remedy, key="result", value=str(path))
    return Calibration.from_json(content, str(path))
