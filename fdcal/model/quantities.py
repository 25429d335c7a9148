"""Declared types of values: numbers with their range and unit, coordinates, and fields that are options.

`fdcal.model.validation` checks values against these declarations.
"""

import dataclasses
from typing import Annotated, Any

import msgspec

from .validation import LIMITS, within

Point = tuple[float, ...]  # coordinates, metres


def positive(unit: str = "", **option: Any) -> msgspec.Meta:
    """Return the range of positive numbers whose products cannot overflow."""
    return within(LIMITS.smallest, LIMITS.largest, unit, **option)


def option(default: Any, text: str, metavar: str | None = None) -> Any:
    """Return a field that is an option of the command line, with its help and placeholder."""
    return dataclasses.field(default=default, metadata={"help": text, "metavar": metavar})


Positive = Annotated[float, positive()]
Metres = Annotated[float, positive("m")]
Hertz = Annotated[float, positive("Hz")]
Seconds = Annotated[float, positive("s")]
MetresPerSecond = Annotated[float, positive("m/s")]
Count = Annotated[int, within(1)]
Whole = Annotated[int, within(0)]
Seed = Whole
