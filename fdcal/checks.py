"""The two errors a user can meet, and the checks that raise them.

Every message names the key, its value and the remedy, on one line.
"""

from __future__ import annotations

import math

import numpy as np


class InputError(ValueError):
    """What the user gave cannot be used; the command line exits with 2."""


class StorageError(OSError):
    """A file cannot be read or written; the command line exits with 3."""


def frozen_array(values, dtype) -> np.ndarray:
    """Copy of `values` as a C-contiguous array of `dtype` that cannot be written to."""
    array = np.array(values, dtype=dtype, order="C", copy=True)
    array.setflags(write=False)
    return array


def require_positive(key: str, value: float, unit: str = "") -> None:
    """Raise InputError unless `value` is finite and above zero."""
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"{key} = {value:g}{unit and ' ' + unit} must be finite and above zero")


def require_choice(key: str, value: str, choices) -> None:
    """Raise InputError unless `value` is one of `choices`."""
    if value not in choices:
        raise InputError(f'{key} = "{value}" is unknown; use one of {", ".join(map(str, choices))}')


def require_finite(key: str, values) -> None:
    """Raise InputError if any entry of `values` is NaN or infinite."""
    bad = np.argwhere(~np.isfinite(np.asarray(values)))
    if len(bad):
        index = tuple(int(i) for i in bad[0])
        raise InputError(f"{key}{list(index)} is not a finite number; mend or leave out that entry")
