"""The JSON file of a calibration's result: `save_result` writes it, `load_result` reads and checks it."""

from __future__ import annotations

import contextlib
import json
import math
from pathlib import Path

import numpy as np

from ..model.storage import write_atomically
from ..model.validation import InputError, StorageError

# Of each key of a result: what it must be, and the number of dimensions of an array (0: a single value).
RESULT = {
    "positions": (float, 2),
    "solver": (str, 0),
    "seed": (int, 0),
    "frequencies": (float, 1),
    "cost": (float, 0),
    "sweeps": (int, 0),
    "elapsed_s": (float, 0),
    "converged": (bool, 0),
    "mean_error_m": (float, 0),
    "max_error_m": (float, 0),
}
NEWER = {  # a file of an older fdcal lacks these
    "uncertainty_m": (float, 1),
    "residual_to_noise": (float, 0),
    "verdict": (str, 0),
    "verdict_text": (str, 0),
    "sound_speed": (float, 0),
    "left_out_db": (float, 0),
    "left_out_microphones_db": (float, 1),
    "left_out_frequencies_db": (float, 1),
}
NULLABLE = ("mean_error_m", "max_error_m")  # null without truth


def save_result(result: dict, path: str | Path, force: bool = False) -> None:
    """Write the result of a calibration as JSON: the keys of RESULT and any others; arrays become lists.

    Raises InputError (a key is missing or of another kind; the file exists) and StorageError.
    """
    table = {
        key: value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value for key, value in result.items()
    }
    _checked(table, "the result")
    text = json.dumps(table, indent=1, allow_nan=False) + "\n"
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"), force)


def load_result(path: str | Path) -> dict:
    """Result of a calibration from its JSON file; `positions` (N, D) and `frequencies` (M,) are float64 arrays.

    Raises InputError naming the key that is missing or malformed, and StorageError.
    """
    try:
        table = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise StorageError(f"cannot read {path}: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{path} is not valid JSON: {error}".replace("\n", " ")) from error
    if not isinstance(table, dict):
        raise InputError(f"{path} must hold one JSON object with the keys {', '.join(RESULT)}")
    return _checked(table, str(path))


def _checked(table: dict, where: str) -> dict:
    """`table` with its arrays as arrays, or InputError naming the key."""
    checked = dict(table)
    for key, (kind, dimensions) in (RESULT | NEWER).items():
        if key in NEWER and key not in table:
            continue
        if key not in table:
            raise InputError(f'{where} has no "{key}"; write it with `fdcal calibrate -o`')
        value = table[key]
        if value is None and key in NULLABLE:
            continue
        words = f"{dimensions}-dimensional list of numbers" if dimensions else f"value of type {kind.__name__}"
        if not _is(value, kind, dimensions):
            raise InputError(f'{where}: "{key}" must be a {words}, finite throughout')
        checked[key] = np.array(value, dtype=float) if dimensions else value
    if checked["positions"].shape[1] not in (2, 3):
        raise InputError(f'{where}: "positions" of shape {checked["positions"].shape} must be (N, 2) or (N, 3), metres')
    rows = len(checked["positions"])
    if len(checked.get("uncertainty_m", range(rows))) != rows:
        raise InputError(f'{where}: "uncertainty_m" must hold {rows} numbers, one for each row of "positions"')
    for key in ("names", "excluded"):
        if not all(isinstance(name, str) for name in _list_of(checked.get(key, []))):
            raise InputError(f'{where}: "{key}" must be a list of texts')
    return checked


def _list_of(value) -> list:
    return value if isinstance(value, list) else [None]


def _is(value, kind: type, dimensions: int) -> bool:
    """Whether a value out of JSON is a `kind`, or a list of that many dimensions of finite numbers."""
    if not dimensions:
        accepted = (int, float) if kind is float else kind
        right = isinstance(value, accepted) and (kind is bool or not isinstance(value, bool))
        with contextlib.suppress(OverflowError):  # a whole number beyond all floats
            return right and (kind is not float or math.isfinite(value))
        return False
    try:
        array = np.array(value)
    except ValueError:
        return False
    return array.ndim == dimensions and array.size > 0 and array.dtype.kind in "if" and bool(np.isfinite(array).all())
