"""Checks of the values that a browser sends: each becomes a plain, bounded value before any other code reads it."""

from __future__ import annotations

import math
from collections.abc import Container

MAX_TEXT_LENGTH = 200  # characters of a text from a browser


def is_plain(updates) -> bool:
    """Return whether a browser's update sets one value: a truth value, a finite number or a short text."""
    if not isinstance(updates, dict) or set(updates) != {"value"}:
        return False
    value = updates["value"]
    if isinstance(value, str):
        return len(value) <= MAX_TEXT_LENGTH
    return isinstance(value, int) or (isinstance(value, float) and math.isfinite(value))


def bounded(value, low: int, high: int, otherwise: int) -> int:
    """Return `value` rounded to an integer and clipped.

    Parameters
    ----------
    value : what a browser has sent; it may be anything
    low, high : int, the bounds, both included
    otherwise : int, returned where `value` is not a number

    Returns
    -------
    int
    """
    try:
        return min(max(round(float(value)), low), high)
    except (TypeError, ValueError, OverflowError):
        return otherwise


def bounded_number(value, low: float, high: float, otherwise: float) -> float:
    """Return `value` as a float, clipped.

    Parameters
    ----------
    value : what a browser has sent; it may be anything
    low, high : float, the bounds, both included
    otherwise : float, returned where `value` is not a finite number

    Returns
    -------
    float
    """
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return otherwise
    return min(max(number, low), high) if math.isfinite(number) else otherwise


def one_of(value, options: Container[str], otherwise: str) -> str:
    """Return `value` if it is one of the texts `options`, and `otherwise` if it is not."""
    return value if isinstance(value, str) and value in options else otherwise
