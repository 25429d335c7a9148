"""Values checked against what is declared: tables of files, fields of records, arguments of Python.

A declaration is a type. `Annotated[float, within(0, 1, "m")]` adds the range and the unit, `Literal` lists choices:

    convert(value, kind, key)   the value as a type, read by msgspec
    build(Record, table)        a frozen dataclass out of a table: every key known, present and of its type
    check(record)               likewise for a record that Python made

`refused` turns what does not fit into the one line that a user sees: key, value and remedy.
"""

import dataclasses
import difflib
import functools
import math
import re
import types
import typing
from collections.abc import Iterable, Mapping
from numbers import Integral, Real
from types import MappingProxyType
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from .validation import LIMITS, InputError, refusal, shown, shown_literal

LONGEST_KEY = 100  # letters that are compared
LARGEST_INTEGER = 2**63  # of those that a file may hold
WORDS = {float: "a number", int: "a whole number", str: "a text", bool: "true or false", dict: "a table"}


def within(low: float | None = None, high: float | None = None, unit: str = "", **option: Any) -> msgspec.Meta:
    """Return the range and the unit of a number, for `Annotated`; `option`: as of `fdcal.commands.options`."""
    return msgspec.Meta(ge=low, le=high, extra={"unit": unit, **option})


def positive(unit: str = "", **option: Any) -> msgspec.Meta:
    """Return the range of a number above zero, a product of a few of which cannot overflow."""
    return within(LIMITS.smallest, LIMITS.largest, unit, **option)


Positive = Annotated[float, positive()]
Metres = Annotated[float, positive("m")]
Hertz = Annotated[float, positive("Hz")]
Seconds = Annotated[float, positive("s")]
MetresPerSecond = Annotated[float, positive("m/s")]
Count = Annotated[int, within(1)]
Seed = Annotated[int, within(0)]


def convert(value: object, kind: Any, key: str) -> Any:
    """Return `value` as the type `kind`, or raise InputError with `key`; numbers may be those of NumPy."""
    try:
        return msgspec.convert(_plain(value, key), kind)
    except msgspec.ValidationError as error:
        for index in re.findall(r"\[(\d+)\]", str(error).rpartition(" - at ")[2]):  # of an entry of a list
            value, kind = typing.cast(Any, value)[int(index)], typing.get_args(_bare(kind)[0])[0]
        raise refused(key, value, kind) from error


def _plain(value: Any, key: str) -> Any:
    """Return a value as files hold it: without types of NumPy, NaN, and integers of very many digits."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(entry, key) for entry in value]
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, Real):
        return value
    if isinstance(value, Integral):
        if abs(int(value)) >= LARGEST_INTEGER:
            raise InputError(f"{key} is too large a number", "use a smaller one", key=key)
        return int(value)
    if math.isnan(value):
        raise InputError(f"{key} = nan must be a number", key=key, value=value)
    return float(value)


def require_positive(key: str, value: object, unit: str = "") -> None:
    """Raise InputError unless `value` is a number above zero."""
    convert(value, Annotated[float, positive(unit)], key)


def refused(key: str, value: object, kind: Any) -> InputError:
    """Return the error for a value that is not of the type `kind`."""
    bare, meta = _bare(kind)
    if typing.get_origin(bare) is Literal:
        choices = ", ".join(map(str, typing.get_args(bare)))
        return InputError(f'{key} = "{shown(value)}" is unknown', f"use one of {choices}", key=key, value=value)
    number = isinstance(value, Real) and not isinstance(value, (bool, np.bool_))
    if meta is None or not number or (bare is int and not isinstance(value, Integral)):
        entries = typing.get_origin(bare) is tuple
        words = "a list" if entries else WORDS.get(bare, "another value")
        problem, remedy = f"{key} = {shown_literal(value)} must be {words}", "write it as [1, 2]" if entries else ""
        return InputError(problem, remedy or f"give {words}", key=key, value=value)
    low, high, unit = meta.ge, meta.le, (meta.extra or {}).get("unit", "")
    why = "is out of range"
    if low == LIMITS.smallest:
        why = "must be finite and above zero"
    elif low == 0 and typing.cast(float, value) < 0:
        why = "is negative"
    remedy = f"use {low:g} or more" if high is None else f"use a number from {low:g} to {high:g}"
    return refusal(key, value, why, remedy, unit)


def _bare(kind: Any) -> tuple[Any, msgspec.Meta | None]:
    """Return a type without None and annotations, and its range."""
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
    """Return the type of a field, without None, and what `within` says of it."""
    kind, meta = _bare(_hints(record)[name])
    return kind, (meta.extra or {}) if meta else {}


def _is_plain(kind: Any) -> bool:
    """Return whether msgspec reads a type: texts, numbers, choices, and tuples of these."""
    bare = _bare(kind)[0]
    if typing.get_origin(bare) is tuple:
        return _is_plain(typing.get_args(bare)[0])
    return bare in (str, int, float, bool) or typing.get_origin(bare) is Literal


def check(record: Any, prefix: str = "", names: Mapping[str, str] = MappingProxyType({})) -> None:
    """Raise InputError unless every field of a dataclass that holds texts or numbers is as declared.

    `prefix` stands before a key in messages, as "solver."; `names` has keys that are called otherwise there.
    """
    for field in dataclasses.fields(record):
        kind = _hints(type(record))[field.name]
        if _is_plain(kind):
            convert(getattr(record, field.name), kind, prefix + names.get(field.name, field.name))


def build(cls: Any, table: dict[str, Any], prefix: str = "", whole: str = "scene") -> Any:
    """Return a dataclass with the values of a table; its `check` is left to the class.

    Defaults apply in Python alone. A table must give every field except those that the class lists in OPTIONAL, or in
    `optional(table)` where that depends on other keys, so that no constant of a run is hidden in code. A class with
    `from_text(text)` may be given as a text. `prefix`, as "room.", and `whole`, the file, are words of the messages.
    """
    fields = [field.name for field in dataclasses.fields(cls)]
    require_known(table, fields, prefix, whole)
    optional = cls.optional(table) if hasattr(cls, "optional") else getattr(cls, "OPTIONAL", ())
    for key in fields:
        if key not in table and key not in optional:
            raise InputError(f"{prefix}{key} is missing", f"add it to the {whole}", key=f"{prefix}{key}")
    return cls(**{key: _built(_hints(cls)[key], value, prefix + key, whole) for key, value in table.items()})


def require_known(table: Iterable[str], fields: Iterable[str], prefix: str = "", whole: str = "scene") -> None:
    """Raise InputError for a key that is none of `fields`, with the one that may be meant."""
    for key in table:
        if key not in fields:
            near = difflib.get_close_matches(key[:LONGEST_KEY], fields, 1)
            remedy = f'did you mean "{prefix}{near[0]}"?' if near else f"known keys: {', '.join(fields)}"
            raise InputError(f"{prefix}{shown(key)} is not a key of a {whole}", remedy, key=f"{prefix}{key}")


def _built(kind: Any, value: Any, key: str, whole: str) -> Any:
    """Return a value of a table as the type of a field."""
    bare = _bare(kind)[0]
    if typing.get_origin(bare) is tuple and dataclasses.is_dataclass(typing.get_args(bare)[0]):
        if not isinstance(value, list):
            raise refused(key, value, kind)
        one = typing.get_args(bare)[0]  # each with keys of its own, hence its number from 1
        return tuple(_built(one, entry, f"{key}[{i}]", whole) for i, entry in enumerate(value, 1))
    if not dataclasses.is_dataclass(bare):
        return convert(value, kind, key)
    if isinstance(value, str) and hasattr(bare, "from_text"):
        return typing.cast(Any, bare).from_text(value)
    if not isinstance(value, dict):
        problem = f"{key} = {shown_literal(value)} must be a table"
        raise InputError(problem, f"write it as [{key}]", key=key, value=value)
    return build(bare, value, f"{key}.", whole)
