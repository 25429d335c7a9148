"""The keys of a result file and what each must hold: `require_result` checks a table read from JSON."""

from __future__ import annotations

import contextlib
import math

import numpy as np

from ..model.validation import InputError
from .corrected_positions import require_given
from .result_parts import CHANNEL_KEYS, UNITS

# Of each key: the type of a value, and the number of dimensions of an array (0: a single value).
REQUIRED = {
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
OPTIONAL = {  # files written by older versions lack some of these; "room" and what follows are those of solver "room"
    "rms_error_m": (float, 0),
    "cost_db": (float, 0),
    "errors_m": (float, 1),
    "aligned": (bool, 0),
    "uncertainty_m": (float, 1),
    "covariance_m2": (float, 3),
    "residual_to_noise": (float, 0),
    "noise_to_given": (float, 0),
    "verdict": (str, 0),
    "verdict_text": (str, 0),
    "sound_speed": (float, 0),
    "sound_speed_sigma": (float, 0),
    "left_out_db": (float, 0),
    "left_out_microphones_db": (float, 1),
    "left_out_frequencies_db": (float, 1),
    "room": (float, 1),
    "source": (float, 1),
    "admittance": (float, 1),
    **dict.fromkeys(CHANNEL_KEYS, (float, 1)),
}
NULLABLE = ("mean_error_m", "rms_error_m", "max_error_m", "errors_m")  # null where the true positions are unknown
OF_EACH_MICROPHONE = ("names", "uncertainty_m", "covariance_m2", "errors_m", "left_out_microphones_db", *CHANNEL_KEYS)


def require_result(table: dict, where: str) -> dict:
    """Return the table of a result with its lists of numbers as arrays.

    Parameters
    ----------
    table : dict
        The keys of REQUIRED and any of OPTIONAL, "names", "excluded", "known", "symmetries", "odd_channels",
        "odd_channel_details" and "given_positions"; others are ignored.
    where : str
        What an error calls the table, as the path of its file.

    Returns
    -------
    dict
        A copy of `table`; arrays are float64.

    Raises
    ------
    InputError
        A key is missing, of another type, not finite or of the wrong length.
    """
    checked = dict(table)
    for key, (kind, dimensions) in (REQUIRED | OPTIONAL).items():
        if key not in table:
            if key in REQUIRED:
                raise InputError(f'{where} has no "{key}"', "write it with `fdcal calibrate -o`", key=key)
            continue
        value = table[key]
        if value is None and key in NULLABLE:
            continue
        if not _is_of(value, kind, dimensions):
            words = f"{dimensions}-dimensional list of numbers" if dimensions else f"value of type {kind.__name__}"
            raise InputError(f'{where}: "{key}" must be a {words} without NaN or infinity', key=key, value=value)
        checked[key] = np.array(value, dtype=float) if dimensions else value
    for key in ("names", "excluded", "known", "odd_channels"):
        if not all(isinstance(name, str) for name in _list_of(checked.get(key, []))):
            raise InputError(f'{where}: "{key}" must be a list of texts', key=key, value=checked[key])
    _require_shapes(checked, where)
    _require_channels(checked, where)
    require_given(checked, where)
    if "symmetries" in checked:
        checked["symmetries"] = _symmetries(checked, where)
    return checked


def _require_shapes(table: dict, where: str) -> None:
    rows, axes = table["positions"].shape
    if axes not in (2, 3):
        raise InputError(
            f'{where}: "positions" of shape {table["positions"].shape} must be (N, 2) or (N, 3), metres',
            key="positions",
        )
    for key in OF_EACH_MICROPHONE:
        if table.get(key) is not None and len(table[key]) != rows:
            raise InputError(f'{where}: "{key}" must hold {rows} entries, one for each row of "positions"', key=key)
    for key, length in (("room", axes), ("source", axes), ("admittance", 2)):
        if key in table and len(table[key]) != length:
            raise InputError(f'{where}: "{key}" must hold {length} numbers', key=key, value=table[key])
    if "covariance_m2" in table and table["covariance_m2"].shape != (rows, axes, axes):
        raise InputError(f'{where}: "covariance_m2" must be of shape {(rows, axes, axes)}', key="covariance_m2")


def _symmetries(table: dict, where: str) -> list[tuple[str, np.ndarray]]:
    """Return the name and the positions (N, D) of every symmetry of the room."""
    problem = InputError(
        f'{where}: "symmetries" must be a list of {{"map": text, "positions": list like "positions"}}, beside "room",'
        ' "source" and "admittance"',
        key="symmetries",
    )
    if not {"room", "source", "admittance"} <= set(table):
        raise problem
    found = []
    for entry in _list_of(table["symmetries"]):
        positions = entry.get("positions") if isinstance(entry, dict) else None
        if not isinstance(entry, dict) or not isinstance(entry.get("map"), str) or not _is_of(positions, float, 2):
            raise problem
        found.append((entry["map"], np.array(positions, dtype=float)))
        if found[-1][1].shape != table["positions"].shape:
            raise problem
    return found


def _require_channels(table: dict, where: str) -> None:
    """Raise InputError for some keys of the channels without the others, or a malformed fault."""
    missing = [key for key in CHANNEL_KEYS if key not in table]
    if missing and len(missing) < len(CHANNEL_KEYS):
        raise InputError(f'{where} has some gains of the channels but no "{missing[0]}"', key=missing[0])
    key, names = "odd_channel_details", table.get("names")
    for fault in _list_of(table.get(key, [])):
        right = isinstance(fault, dict) and set(fault) == {"name", "kind", "value", "unit", "partner"}
        right = right and all(isinstance(fault[part], str) for part in ("name", "kind")) and fault["unit"] in UNITS
        right = right and (fault["value"] is None or _is_of(fault["value"], float, 0))
        right = right and (fault["partner"] is None or isinstance(fault["partner"], str))
        if not right or (names is not None and fault["name"] not in names):
            problem = f'{where}: "{key}" must be a list of {{"name", "kind", "value", "unit", "partner"}}'
            raise InputError(problem, key=key, value=fault)


def _list_of(value) -> list:
    return value if isinstance(value, list) else [None]


def _is_of(value, kind: type, dimensions: int) -> bool:
    """Return whether a value read from JSON is a `kind`, or a list of that many dimensions of finite numbers."""
    if not dimensions:
        accepted = (int, float) if kind is float else kind
        right = isinstance(value, accepted) and (kind is bool or not isinstance(value, bool))
        with contextlib.suppress(OverflowError):  # an integer beyond the range of floats
            return right and (kind is not float or math.isfinite(value))
        return False
    try:
        array = np.array(value)
    except ValueError:
        return False
    return array.ndim == dimensions and array.size > 0 and array.dtype.kind in "if" and bool(np.isfinite(array).all())
