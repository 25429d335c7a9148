"""Checks of external input: the two kinds of error that a user can meet, limits, declared types, values as text.

Every message names the key, its value and the remedy, in one line. A value beyond the limits counts as a mistake.
A declaration is a type (`fdcal.model.quantities`): `Annotated[float, within(0, 1, "m")]` has a range and a unit.

    convert(value, kind, key)   returns a value, converted by msgspec to the declared type `kind`
    build(Record, table)        makes a frozen dataclass from a table, in which every key must be known and of its type
    check(record)               makes the same checks of a record that was made in Python

`refused` returns the error for a value that does not fit.
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import functools
import itertools
import math
import re
import reprlib
import types
import typing
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from numbers import Integral, Real
from types import MappingProxyType
from typing import Annotated, Any, Literal, TypeAlias

import msgspec
import numpy as np
from numpy.typing import ArrayLike, DTypeLike


@dataclass(frozen=True)
class Limits:
    """Limits of the values in a scene, a measurement or an option."""

    # smallest, largest: bounds of any length, time, frequency or other number that must be positive, in its own unit
    smallest: float = 1e-12
    largest: float = 1e12
    cells: int = 20_000_000  # cells of a simulation; each of its fields takes 8 bytes a cell
    microphones: int = 10_000  # microphones of an array
    microphones_3d: int = 2_000  # the same in a room of three dimensions, whose field is summed at each microphone
    field_values: int = 5_000_000  # microphones times frequencies of the spectrum of such a room
    pairs: float = 1e8  # pairs of microphones times modes of a calibration; each takes 16 bytes or less
    # largest wavenumber times half the extent of the array in a calibration, radians: the order of its field
    phase: float = 100.0
    phase_per_microphone: float = 2.0  # radians; the limit is this times the number of microphones, if larger
    dispersion: float = 10.0  # largest ratio of a wavenumber to 2 pi f / c; the smallest ratio is its inverse
    seconds: float = 90.0  # largest processor time of a calibration; proportional to its pairs above `usual_pairs`
    usual_pairs: float = 64.0**3  # pairs of microphones times modes, 64 microphones at 64 frequencies
    candidates: int = 500_000  # candidate positions of a search; the tables of the solvers take 1 to 2 GB for so many
    coordinate: float = 1e9  # largest coordinate, metres
    takes: int = 100  # positions of the source in a scene
    decibels: float = 300.0  # dB, largest signal-to-noise ratio; the smallest one is its negative
    sound_speed_error: float = 0.5  # largest relative error of the sound speed, dimensionless
    # weakest, strongest: pressures whose squares can be summed without leaving the range of float64, any unit
    weakest: float = 1e-100
    strongest: float = 1e100
    digits: int = 10**30  # messages do not show integers of this size or larger
    text: int = 1_000_000  # bytes of a text file such as a scene
    result: int = 50_000_000  # bytes of a result file
    unfolded: int = 400_000_000  # bytes of a compressed file after decompression


LIMITS = Limits()


class InputError(ValueError):
    """Input that cannot be used; the command line exits with 2.

    Parameters
    ----------
    problem : str
        What is wrong, with the key and its value: "modes = 200 is more than the 57 that were measured".
    remedy : str, optional
        What to do. The name of an argument stands in angle brackets: "leave out <distance>". The Python API
        shows the name itself; the command line and the page put the name of their own option or control in its place.
    key : str, optional
        The argument, or the key of a file, that is wrong.

    Examples
    --------
    >>> error = InputError("microphones 0 and 1 coincide", "name others: <distance>", key="distance")
    >>> str(error)
    'microphones 0 and 1 coincide; name others: distance'
    >>> error.worded({"distance": "--distance I,J,METRES"})
    'microphones 0 and 1 coincide; name others: --distance I,J,METRES'
    >>> str(error.within("room.npz"))
    'room.npz: microphones 0 and 1 coincide; name others: distance'
    """

    def __init__(self, problem: str, remedy: str = "", *, key: str = ""):
        self.problem, self.remedy, self.key = problem, remedy, key
        super().__init__(self.worded({}))

    def worded(self, names: Mapping[str, str]) -> str:
        """Return the message, in which the arguments in the remedy have their names in `names`, or their own."""
        remedy = word_arguments(self.remedy, names)
        return f"{self.problem}; {remedy}" if remedy else self.problem

    def within(self, where: object) -> InputError:
        """Return the same error, whose problem begins with the file or table in which it occurred."""
        if self.problem.startswith(str(where)):
            return self
        return InputError(f"{where}: {self.problem}", self.remedy, key=self.key)


@contextlib.contextmanager
def naming(where: object) -> Iterator[None]:
    """Let the message of an InputError in the block begin with the file or table `where`."""
    try:
        yield
    except InputError as error:
        raise error.within(where) from error


def word_arguments(text: str, names: Mapping[str, str]) -> str:
    """Return a text in which the arguments in angle brackets have their names in `names`, or their own names.

    "modes (<modes>)" becomes "modes" if `names` does not have the argument.
    """
    text = re.sub(r"\b(\w+) \(<(\1)>\)", lambda match: match[0] if match[2] in names else match[1], text)
    return re.sub(r"<([a-z_]+)>", lambda match: names.get(match[1], match[1]), text)


class StorageError(OSError):
    """A file cannot be read or written; the command line exits with 3.

    Examples
    --------
    >>> import fdcal
    >>> try:
    ...     fdcal.load("nowhere.wav")
    ... except fdcal.StorageError as error:
    ...     print(error)
    cannot read nowhere.wav: No such file or directory
    """


def require_arguments(function: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Raise TypeError for the first argument that a function does not have; the message suggests a similar name."""
    known = set(known)
    for name in sorted(set(given) - known):
        near = difflib.get_close_matches(name, known, 1)
        meant = f"; did you mean {near[0]!r}?" if near else ""
        raise TypeError(f"{function}() got an unexpected keyword argument {name!r}{meant}")


def shown(value: object, max_length: int = 60, quoted: bool = False) -> str:
    """Return a value for a message, on one line of at most `max_length` characters.

    A text is shown as it is, or in quotes if `quoted` is set; any other value is shown as its repr.
    """
    try:
        if isinstance(value, (dict, list, tuple)):
            value = reprlib.repr(value)
        if isinstance(value, int) and abs(value) >= LIMITS.digits:
            raise ValueError
    except ValueError:  # Python does not print integers of more than 4300 digits
        return "a number of very many digits"
    text = " ".join((value if isinstance(value, str) and not quoted else repr(value)).split())
    return text if len(text) <= max_length else f"{text[: max_length - 3]}..."


def frozen_array(values: ArrayLike, dtype: DTypeLike) -> np.ndarray:
    """Return a copy of `values` as a C-contiguous array of `dtype` that cannot be written to."""
    array = np.array(values, dtype=dtype, order="C", copy=True)
    array.setflags(write=False)
    return array


def evenly_spaced(count: int, max_count: int) -> np.ndarray:
    """Return at most `max_count` indices below `count`, evenly spaced, including the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, max_count)).round().astype(np.int64))


# Kinds of array: dtype kinds that are converted without loss, name in messages, and resulting dtype.
KINDS = {
    "real": ("fiu", "real numbers", np.float64),
    "complex": ("c", "complex numbers", np.complex128),
    "number": ("fiuc", "numbers", np.complex128),
    "index": ("iu", "whole numbers", np.int64),
    "text": ("U", "texts", np.str_),
}


def require_array(
    key: str, values: Any, kind: str, shape: tuple[int | None, ...], unit: str = "", missing: bool = False
) -> np.ndarray:
    """Return `values` as a read-only array of a kind of KINDS and of a shape; raise InputError if they do not fit.

    No value is rounded to fit; an empty array is of every kind. `shape` is the length along each axis, or None for any
    length; () stands for a single value. `unit` is the unit or the meaning of the numbers, for the message. NaN is
    refused unless `missing` is set.
    """
    letters, words, dtype = KINDS[kind]
    wanted = f"({', '.join('any' if n is None else str(n) for n in shape)}{',' if len(shape) == 1 else ''})"
    remedy = f"give {words}{unit and ', ' + unit}, of shape {wanted}" if shape else f"give one of {words}"
    try:
        array = np.asarray(values)
        if array.dtype.kind == "U":
            array.tolist()  # raises for invalid characters
    except ValueError as error:
        raise InputError(f"{key} has rows of different lengths", remedy, key=key) from error
    except SystemError as error:
        raise InputError(f"{key} is damaged: it holds invalid characters", remedy, key=key) from error
    if array.size and array.dtype.kind not in letters:
        found = {"f": "real", "c": "complex", "b": "true or false", "U": "text"}.get(array.dtype.kind, array.dtype.name)
        raise InputError(f"{key} is {found} ({array.dtype})", remedy, key=key)
    if array.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True)):
        raise InputError(f"{key} has shape {array.shape}", remedy, key=key)
    if kind != "text":
        require_finite(key, np.where(np.isnan(array), 0.0, array) if missing else array)
    return frozen_array(array, dtype)


def refusal(key: str, value: object, why: str, remedy: str = "", unit: str = "") -> InputError:
    """Return the error for an impossible value: "room.cell = 0.04 m has no meaning"; the unit is optional."""
    text = f"{value:g}" if isinstance(value, float) else f'"{value}"' if isinstance(value, str) else shown(value)
    return InputError(f"{key} = {text}{unit and ' ' + unit} {why}", remedy, key=key)


def require_choice(key: str, value: object, choices: Iterable[object]) -> None:
    """Raise InputError unless `value` is one of `choices`."""
    choices = tuple(choices)
    if isinstance(value, np.ndarray) or value not in choices:
        raise InputError(f'{key} = "{shown(value)}" is unknown', f"use one of {', '.join(map(str, choices))}", key=key)


def require_finite(key: str, values: Any) -> None:
    """Raise InputError if any entry of `values` is NaN or infinite."""
    bad = np.argwhere(~np.isfinite(np.asarray(values)))
    if len(bad):
        index = bad[0].tolist() or ""  # "" for a single number
        raise InputError(f"{key}{index} is not a finite number", "correct or remove that entry", key=key)


def require_point(key: str, values: Any, lengths: tuple[int, ...]) -> None:
    """Raise InputError unless `values` are finite coordinates, as many as one of `lengths`, which are 2 or 3."""
    if len(values) not in lengths:
        words = " or ".join({2: "two, along x and y", 3: "three, along x, y and z"}[n] for n in lengths)
        raise InputError(f"{key} = {list(values)} has {len(values)} numbers", f"give {words}", key=key)
    require_finite(key, values)
    if max(map(abs, values)) > LIMITS.coordinate:
        raise InputError(f"{key} = {list(values)} is too far away", f"use up to {LIMITS.coordinate:g} m", key=key)


def point_text(point: Any) -> str:
    """Return the coordinates of a point for a message: "(1.25, 0.5) m"."""
    return f"({', '.join(f'{coordinate:.4g}' for coordinate in point)}) m"


LONGEST_KEY = 100  # only so many characters of a key are compared with the known keys
LARGEST_INTEGER = 2**63  # integers of this size or larger are refused
WORDS = {float: "a number", int: "a whole number", str: "a text", bool: "true or false", dict: "a table"}


def within(low: float | None = None, high: float | None = None, unit: str = "", **option: Any) -> msgspec.Meta:
    """Return the range and the unit of a number, for `Annotated`; `fdcal.commands.options` reads `option`."""
    return msgspec.Meta(ge=low, le=high, extra={"unit": unit, **option})


def convert(value: object, kind: Any, key: str) -> Any:
    """Return `value` as the type `kind`, or raise InputError with `key`; numbers of NumPy are accepted."""
    value = _plain(value, key)
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        for index in re.findall(r"\[(\d+)\]", str(error).rpartition(" - at ")[2]):  # path to an entry of a list
            value, kind = typing.cast(Any, value)[int(index)], typing.get_args(_bare(kind)[0])[0]
        raise refused(key, value, kind) from error


def _plain(value: Any, key: str) -> Any:
    """Return a value with Python's own types; raise InputError for NaN and for integers of very many digits."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(entry, key) for entry in value]
    if isinstance(value, bool) or not isinstance(value, Real):
        return value
    if isinstance(value, Integral):
        if abs(int(value)) >= LARGEST_INTEGER:
            raise InputError(f"{key} is too large", "use a smaller number", key=key)
        return int(value)
    if math.isnan(value):
        raise InputError(f"{key} = nan must be a number", key=key)
    return float(value)


def refused(key: str, value: object, kind: Any) -> InputError:
    """Return the error for a value that is not of the type `kind`."""
    bare, meta = _bare(kind)
    if typing.get_origin(bare) is Literal:
        choices = ", ".join(map(str, typing.get_args(bare)))
        return InputError(f'{key} = "{shown(value)}" is unknown', f"use one of {choices}", key=key)
    number = isinstance(value, Real) and not isinstance(value, (bool, np.bool_))
    if meta is None or not number or bare is str or (bare is int and not isinstance(value, Integral)):
        entries = typing.get_origin(bare) is tuple
        words = "a list" if entries else WORDS.get(bare, "another value")
        remedy = "write it as [1, 2]" if entries else f"give {words}"
        return InputError(f"{key} = {shown(value, quoted=True)} must be {words}", remedy, key=key)
    low, high, unit = meta.ge, meta.le, (meta.extra or {}).get("unit", "")
    why = "must be finite and above zero" if low == LIMITS.smallest else "is out of range"
    return refusal(key, value, why, f"use {low:g} or more" if high is None else f"use {low:g} to {high:g}", unit)


def _bare(kind: Any) -> tuple[Any, msgspec.Meta | None]:
    """Return a type without `| None` and `Annotated`, and its range."""
    meta = None
    while True:
        if typing.get_origin(kind) is Annotated:
            meta = next((one for one in kind.__metadata__ if isinstance(one, msgspec.Meta)), meta)
            kind = kind.__origin__
        elif typing.get_origin(kind) in (typing.Union, types.UnionType):
            kind = next(one for one in typing.get_args(kind) if one is not type(None))
        else:
            return kind, meta


@functools.cache
def _hints(record: type) -> dict[str, Any]:
    return typing.get_type_hints(record, include_extras=True)


def declaration(record: type, name: str) -> tuple[Any, dict[str, Any]]:
    """Return the type of a field, without `| None`, and the extra information of its `within`."""
    kind, meta = _bare(_hints(record)[name])
    return kind, (meta.extra or {}) if meta else {}


def _is_plain(kind: Any) -> bool:
    """Return whether msgspec reads a type: texts, numbers, choices, and tuples of these."""
    bare = _bare(kind)[0]
    if typing.get_origin(bare) is tuple:
        return _is_plain(typing.get_args(bare)[0])
    return bare in (str, int, float, bool) or typing.get_origin(bare) is Literal


def check(record: Any, prefix: str = "", names: Mapping[str, str] = MappingProxyType({})) -> None:
    """Raise InputError unless every field of a dataclass that holds texts or numbers has its declared type and range.

    In messages `prefix`, such as "solver.", stands before a key, and `names` maps fields to other names.
    """
    for field in dataclasses.fields(record):
        kind = _hints(type(record))[field.name]
        if _is_plain(kind):
            convert(getattr(record, field.name), kind, prefix + names.get(field.name, field.name))


def build(cls: Any, table: dict[str, Any], prefix: str = "", whole: str = "scene") -> Any:
    """Return a dataclass with the values of a table; the class itself calls `check`.

    A table must have every field except those in the class's OPTIONAL, or in `optional(table)` if that depends on other
    keys, so that no constant of a run is hidden in a default. `prefix`, such as "room.", and `whole`, the kind of file,
    appear in messages.
    """
    fields = [field.name for field in dataclasses.fields(cls)]
    for given in table:
        if given not in fields:  # the message suggests a similar key
            near = difflib.get_close_matches(given[:LONGEST_KEY], fields, 1)
            remedy = f'did you mean "{prefix}{near[0]}"?' if near else f"known keys: {', '.join(fields)}"
            raise InputError(f"{prefix}{shown(given)} is not a key of a {whole}", remedy, key=f"{prefix}{given}")
    optional = cls.optional(table) if hasattr(cls, "optional") else getattr(cls, "OPTIONAL", ())
    for key in fields:
        if key not in table and key not in optional:
            raise InputError(f"{prefix}{key} is missing", f"add it to the {whole}", key=f"{prefix}{key}")
    return cls(**{key: _built(_hints(cls)[key], value, prefix + key, whole) for key, value in table.items()})


def _built(kind: Any, value: Any, key: str, whole: str) -> Any:
    """Return a value of a table as the type of a field."""
    bare = _bare(kind)[0]
    if typing.get_origin(bare) is tuple and dataclasses.is_dataclass(typing.get_args(bare)[0]):
        if not isinstance(value, list):
            raise refused(key, value, kind)
        one = typing.get_args(bare)[0]  # messages number the entries from 1
        return tuple(_built(one, entry, f"{key}[{i}]", whole) for i, entry in enumerate(value, 1))
    if not dataclasses.is_dataclass(bare):
        return convert(value, kind, key)
    if not isinstance(value, dict):
        raise InputError(f"{key} = {shown(value, quoted=True)} must be a table", f"write it as [{key}]", key=key)
    return build(bare, value, f"{key}.", whole)


Reals: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.float64]]
Complexes: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.complex128]]
# real or complex, such as wavenumbers, which are complex for damped waves
Numbers: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.float64 | np.complex128]]
Integers: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.int64]]
Bools: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]


def length_text(length: float, digits: int = 3) -> str:
    """Return a length in metres as text, with `digits` digits below a decimetre: "4.13 mm", "535 mm", "1.16 m"."""
    return f"{mm_text(length, digits)} mm" if length < 0.9995 else f"{length:.{max(3, len(str(int(length))))}g} m"


def mm_text(length: float, digits: int = 3) -> str:
    """Return the number of millimetres of a length in metres, with `digits` digits below a decimetre."""
    if length < 1e-6:
        return "0"
    return f"{1e3 * length:.{digits}g}" if length < 0.0995 else f"{1e3 * length:.0f}"


MAX_RANGES = 1000  # largest number of modes and ranges in a text that `parse_modes` reads


def parse_modes(text: str, count: int) -> tuple[int, ...]:
    """Return the modes in a text such as "1-3, 5", ascending; raise InputError unless they are from 1 to `count`."""
    remedy = f"write numbers from 1 to {count}, as in 1-3, 5"
    found: set[int] = set()
    for part in filter(None, (part.strip() for part in str(text).split(",", MAX_RANGES))):
        match = re.fullmatch(r"(\d{1,6})(?:\s*-\s*(\d{1,6}))?", part)
        low, high = (int(match[1]), int(match[2] or match[1])) if match else (0, 0)
        if not 1 <= low <= high <= count:
            raise InputError(f'"{shown(part)}" is not a number or range of frequencies', remedy, key="modes")
        found |= set(range(low, high + 1))
    if not found:
        raise InputError("no frequency is given", remedy, key="modes")
    return tuple(sorted(found))


def modes_text(modes: Any) -> str:
    """Return the shortest text that `parse_modes` reads as `modes`, an iterable of int."""
    numbered = enumerate(sorted(set(modes)))  # the difference of mode and number is constant in a range
    ranges = [[mode for _, mode in one] for _, one in itertools.groupby(numbered, lambda pair: pair[1] - pair[0])]
    return ", ".join(f"{one[0]}-{one[-1]}" if len(one) > 2 else ", ".join(map(str, one)) for one in ranges)
