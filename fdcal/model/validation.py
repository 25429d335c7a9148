"""The two errors that a user can meet, and the checks that raise them.

Every message names the key, its value and the remedy, on one line.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

LEAST, MOST = 1e-12, 1e12  # of any length, time, frequency or number: what lies beyond is a slip of the pen


class InputError(ValueError):
    """Input that cannot be used; the command line exits with 2.

    Parameters
    ----------
    problem : str
        What is wrong, with the key and its value: "modes = 200 is more than the 57 that were measured".
    remedy : str, optional
        What to do. The name of an argument stands in angle brackets: "give <search> and <radius>". The Python API
        shows the name itself; the command line and the page put the name of their own option or control in its place.
    key : str, optional
        The argument, or the key of a file, that is wrong.
    value : object, optional
        Its value.

    Examples
    --------
    >>> error = InputError("the measurement has no search domain", "give <search> and <radius>", key="search")
    >>> str(error)
    'the measurement has no search domain; give search and radius'
    >>> error.worded({"search": "--search ORIGIN,SIZE,STEP", "radius": "--radius R"})
    'the measurement has no search domain; give --search ORIGIN,SIZE,STEP and --radius R'
    """

    def __init__(self, problem: str, remedy: str = "", *, key: str = "", value: object = None):
        self.problem, self.remedy, self.key, self.value = problem, remedy, key, value
        super().__init__(self.worded({}))

    def worded(self, names: Mapping[str, str]) -> str:
        """Return the message with the arguments that its remedy mentions called as in `names`."""
        remedy = re.sub(r"<([a-z_]+)>", lambda match: names.get(match[1], match[1]), self.remedy)
        return f"{self.problem}; {remedy}" if remedy else self.problem


class StorageError(OSError):
    """A file cannot be read or written; the command line exits with 3."""


def frozen_array(values, dtype) -> np.ndarray:
    """Copy of `values` as a C-contiguous array of `dtype` that cannot be written to."""
    array = np.array(values, dtype=dtype, order="C", copy=True)
    array.setflags(write=False)
    return array


# Kinds of array: the dtype kinds that hold one without loss, what it is called, and the dtype it gets.
KINDS = {
    "real": ("fiu", "real numbers", np.float64),
    "complex": ("c", "complex numbers", np.complex128),
    "number": ("fiuc", "numbers", np.complex128),
    "index": ("iu", "whole numbers", np.int64),
    "text": ("U", "texts", np.str_),
}


def require_array(key: str, values, kind: str, shape: tuple[int | None, ...], unit: str = "") -> np.ndarray:
    """`values` as a read-only array; InputError unless they are of the kind and shape, and finite.

    Parameters
    ----------
    key : what messages call it
    kind : a key of KINDS; nothing is rounded or cut off to make it fit, but an empty array is of every kind
    shape : lengths along each axis, None where any will do; () for a single value
    unit : what messages call one of the numbers
    """
    letters, words, dtype = KINDS[kind]
    wanted = f"({', '.join('any' if n is None else str(n) for n in shape)}{',' * (len(shape) == 1)})"
    remedy = f"give {words}{unit and ', ' + unit}, of shape {wanted}" if shape else f"give one of {words}"
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise InputError(f"{key} has rows of different lengths; {remedy}") from error
    if array.size and array.dtype.kind not in letters:
        sort = {"f": "real", "c": "complex", "b": "true or false", "U": "text"}.get(array.dtype.kind, array.dtype.name)
        raise InputError(f"{key} is {sort} ({array.dtype}); {remedy}")
    if array.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True)):
        raise InputError(f"{key} has shape {array.shape}; {remedy}")
    if kind != "text":
        require_finite(key, array)
    return frozen_array(array, dtype)


def require_positive(key: str, value: float, unit: str = "") -> None:
    """Raise InputError unless `value` is above zero and such that no product of a few overflows."""
    if not LEAST <= value <= MOST:
        text = f"{value:g}" if isinstance(value, float) else str(value)
        raise InputError(
            f"{key} = {text}{unit and ' ' + unit} must be finite and above zero;"
            f" use a number from {LEAST:g} to {MOST:g}"
        )


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
