"""Checks of the values that a browser sends: each becomes a plain, bounded value before any other code reads it."""

from __future__ import annotations

import math
from collections.abc import Container

MAX_TEXT_LENGTH = 200  # characters of a text from a browser
MAX_NUMBER = 2**53  # what a browser can count to; larger integers cannot be sent to the other browsers


def is_plain(updates) -> bool:
    """Return whether a browser's update sets one value: a truth value, a finite number or a short text."""
    if not isinstance(updates, dict) or set(updates) != {"value"}:
        return False
    value = updates["value"]
    if isinstance(value, str):
        return len(value) <= MAX_TEXT_LENGTH
    return isinstance(value, (int, float)) and abs(value) <= MAX_NUMBER  # False for NaN, too


def fits(control, value) -> bool:
    """Return whether a plain value is one that a control can have.

    `control`: handle of a control of viser; `value`: truth value, number or text, as `is_plain` accepts it.
    """
    options = getattr(control, "options", None)
    if options is not None:
        return isinstance(value, str) and value in options
    if isinstance(control.value, (bool, str)):
        return isinstance(value, type(control.value))
    low, high = getattr(control, "min", None), getattr(control, "max", None)
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return number and (low is None or value >= low) and (high is None or value <= high)


def bounded(value, low: int, high: int, otherwise: int) -> int:
    """Return `value` rounded to an integer and clipped.

    `value`: what a browser has sent; it may be anything; `low`, `high`: the bounds, both included; `otherwise`:
    returned where `value` is not a number.
    """
    try:
        return min(max(round(float(value)), low), high)
    except (TypeError, ValueError, OverflowError):
        return otherwise


def bounded_number(value, low: float, high: float, otherwise: float) -> float:
    """Return `value` as a float, clipped.

    `value`: what a browser has sent; it may be anything; `low`, `high`: the bounds, both included; `otherwise`:
    returned where `value` is not a finite number.
    """
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return otherwise
    return min(max(number, low), high) if math.isfinite(number) else otherwise


def one_of(value, options: Container[str], otherwise: str) -> str:
    """Return `value` if it is one of the texts `options`, and `otherwise` if it is not."""
    return value if isinstance(value, str) and value in options else otherwise
