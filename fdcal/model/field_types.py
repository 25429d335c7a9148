"""Types of the fields of a dataclass that somebody fills in Python, where nothing else converts them."""

from __future__ import annotations

import functools
import typing

from .validation import InputError, require_integer, require_number, shown_literal

_hints = functools.cache(typing.get_type_hints)
ANY_WHOLE_NUMBER = -(2**62)


def require_field_types(record: object, prefix: str = "") -> None:
    """Raise InputError unless every field of a dataclass that holds a text or a number is of its type.

    Parameters
    ----------
    record : dataclass
        Its fields of str, int, float, or one of these or None, are checked.
    prefix : str
        Put before a key in messages, for example "solver.".
    """
    for name, hint in _hints(type(record)).items():
        value, kinds = getattr(record, name), typing.get_args(hint) or (hint,)
        if value is None and type(None) in kinds:
            continue
        if str in kinds and not isinstance(value, str):
            problem = f"{prefix}{name} = {shown_literal(value)} is no text"
            raise InputError(problem, "give a text", key=prefix + name, value=value)
        if int in kinds:
            require_integer(prefix + name, value, ANY_WHOLE_NUMBER, "give a whole number")
        if float in kinds and typing.get_origin(hint) is not tuple:
            require_number(prefix + name, value)
