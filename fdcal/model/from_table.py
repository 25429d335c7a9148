"""Build a frozen dataclass from a TOML table: every key known, present and of its type.

Defaults apply in Python alone. A table must give every field except those that its class lists in OPTIONAL, or in
`optional(table)` where that depends on other keys, so that no constant of a run is hidden in code. A class with
`from_text(text)` may be given as a text in place of a table.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import math
import typing
from typing import Any

from .validation import InputError, shown, shown_literal

LONGEST_KEY = 100  # letters that are compared
WORDS = {float: "a number", int: "a whole number", str: "a text", bool: "true or false", dict: "a table"}


_hints = functools.cache(typing.get_type_hints)


def build(cls: Any, table: dict[str, Any], prefix: str = "", whole: str = "scene") -> Any:
    """Return a dataclass with the values of a table.

    `cls`, type, dataclass with fields of str, int, float, bool, dict, dataclasses, or tuples of these. Its OPTIONAL, or
    what its `optional(table)` returns, lists the keys that may be left out; `table`: as tomllib reads it; `prefix`: put
    before a key in messages, for example "room."; `whole`: what messages call the file. Raises InputError for an
    unknown or missing key, or a value of another type.

    Examples
    --------
    >>> from fdcal.model.settings import Search
    >>> build(Search, {"origin": [0, 0], "size": [1, 1], "step": 0.1, "radius": 0.7}).shape
    (11, 11)
    """
    hints = _hints(cls)
    fields = {f.name: f for f in dataclasses.fields(cls)}
    for key in table:
        if key not in fields:
            near = difflib.get_close_matches(key[:LONGEST_KEY], fields, 1)
            remedy = f'did you mean "{prefix}{near[0]}"?' if near else f"known keys: {', '.join(fields)}"
            raise InputError(f"{prefix}{shown(key)} is not a key of a {whole}", remedy, key=f"{prefix}{key}")
    optional = cls.optional(table) if hasattr(cls, "optional") else getattr(cls, "OPTIONAL", ())
    for key in fields:
        if key not in table and key not in optional:
            raise InputError(f"{prefix}{key} is missing", f"add it to the {whole}", key=f"{prefix}{key}")
    return cls(**{key: _convert(hints[key], value, f"{prefix}{key}", whole) for key, value in table.items()})


def _convert(hint: Any, value: Any, key: str, whole: str) -> Any:
    """Return `value` as the type `hint`, or raise InputError with `key`."""
    if dataclasses.is_dataclass(hint):
        from_text = getattr(hint, "from_text", None)
        if from_text is not None and isinstance(value, str):
            return from_text(value)
        if not isinstance(value, dict):
            raise InputError(
                f"{key} = {shown_literal(value)} must be a table", f"write it as [{key}]", key=key, value=value
            )
        return build(hint, value, f"{key}.", whole)
    arguments = typing.get_args(hint)
    if type(None) in arguments:
        return _convert(arguments[0], value, key, whole)
    if typing.get_origin(hint) is tuple:
        if not isinstance(value, list):
            raise InputError(
                f"{key} = {shown_literal(value)} must be a list", "write it as [1, 2]", key=key, value=value
            )
        tables = dataclasses.is_dataclass(arguments[0])  # each with keys of its own, hence its number from 1
        names = (f"{key}[{i}]" if tables else key for i in range(1, len(value) + 1))
        return tuple(_convert(arguments[0], entry, name, whole) for entry, name in zip(value, names, strict=True))
    accepted = (int, float) if hint is float else hint
    if not isinstance(value, accepted) or (isinstance(value, bool) and hint is not bool):
        raise InputError(
            f"{key} = {shown_literal(value)} must be {WORDS[hint]}",
            key=key,
            value=value,
        )
    if isinstance(value, int) and abs(value) >= 2**63:
        raise InputError(f"{key} is too large a number", "use a smaller one", key=key)
    converted = hint(value)
    if hint is float and math.isnan(converted):
        raise InputError(f"{key} = nan must be a number", key=key, value=value)
    return converted
