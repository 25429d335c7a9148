"""A frozen dataclass from a TOML table: every key known, present and of its type.

Defaults are for Python alone: a table gives every field but those that its class names in OPTIONAL, or in
`optional(table)` where that depends on the others, so that no constant of a run is decided out of sight.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import math
import typing

from .validation import InputError

WORDS = {float: "a number", int: "a whole number", str: "a text", bool: "true or false", dict: "a table"}


_hints = functools.cache(typing.get_type_hints)


def build(cls, table: dict, prefix: str = "", whole: str = "scene"):
    """Dataclass `cls` from a table, its fields' types deciding those of the values.

    Parameters
    ----------
    cls : dataclass of str, int, float, bool, dict, dataclasses, or tuples of these; its OPTIONAL, or what its
        `optional(table)` returns, names what may be left out
    table : dict, as tomllib reads it
    prefix : what messages put before a key, such as "room."
    whole : what messages call the file

    Raises
    ------
    InputError
        A key unknown or missing, a value of another type.
    """
    hints = _hints(cls)
    fields = {f.name: f for f in dataclasses.fields(cls)}
    for key in table:
        if key not in fields:
            near = difflib.get_close_matches(key, fields, 1)
            remedy = f'did you mean "{prefix}{near[0]}"?' if near else f"known keys: {', '.join(fields)}"
            raise InputError(f"{prefix}{key} is not a key of a {whole}; {remedy}")
    optional = cls.optional(table) if hasattr(cls, "optional") else getattr(cls, "OPTIONAL", ())
    for key in fields:
        if key not in table and key not in optional:
            raise InputError(f"{prefix}{key} is missing; add it to the {whole}")
    return cls(**{key: _convert(hints[key], value, f"{prefix}{key}", whole) for key, value in table.items()})


def _convert(hint, value, key: str, whole: str):
    """`value` as the type `hint`, or InputError naming `key`."""
    if dataclasses.is_dataclass(hint):
        if not isinstance(value, dict):
            raise InputError(f"{key} = {value!r} must be a table [{key}]")
        return build(hint, value, f"{key}.", whole)
    arguments = typing.get_args(hint)
    if type(None) in arguments:
        return _convert(arguments[0], value, key, whole)
    if typing.get_origin(hint) is tuple:
        if not isinstance(value, list):
            raise InputError(f"{key} = {value!r} must be a list")
        tables = dataclasses.is_dataclass(arguments[0])  # each with keys of its own, hence its number from 1
        names = (f"{key}[{i}]" if tables else key for i in range(1, len(value) + 1))
        return tuple(_convert(arguments[0], entry, name, whole) for entry, name in zip(value, names, strict=True))
    accepted = (int, float) if hint is float else hint
    if not isinstance(value, accepted) or (isinstance(value, bool) and hint is not bool):
        word = WORDS[hint]
        raise InputError(f"{key} = {value!r} must be {word}")
    if isinstance(value, int) and abs(value) >= 2**63:
        raise InputError(f"{key} is too large a number; use a smaller one")
    converted = hint(value)
    if hint is float and math.isnan(converted):
        raise InputError(f"{key} = nan must be a number")
    return converted
