"""Lengths and sets of modes as texts: "4.13 mm", "1-9, 12"."""

import re
from typing import Any

from .validation import InputError


def format_mm(length: float) -> str:
    """Return a length in metres as a text in millimetres: "4.13 mm", "535 mm"."""
    return f"{mm_text(length)} mm"


def length_text(length: float, digits: int = 3) -> str:
    """Return a length in metres as a text, with `digits` below a decimetre: "4.13 mm", "535 mm", "1.16 m"."""
    return f"{mm_text(length, digits)} mm" if length < 0.9995 else f"{length:.{max(3, len(str(int(length))))}g} m"


def mm_text(length: float, digits: int = 3) -> str:
    """Return the number of millimetres of a length in metres, with `digits` digits below a decimetre."""
    if length < 1e-6:
        return "0"
    return f"{1e3 * length:.{digits}g}" if length < 0.0995 else f"{1e3 * length:.0f}"


LONGEST = 200  # characters that are read of a text


def parse_modes(text: str, count: int) -> tuple[int, ...]:
    """Return the modes of 1 to `count` that a text as "1-3, 5" lists, ascending; InputError for any other text."""
    remedy = f"write numbers from 1 to {count}, as in 1-3, 5"
    found: set[int] = set()
    for part in filter(None, (part.strip() for part in str(text)[:LONGEST].split(","))):
        match = re.fullmatch(r"(\d{1,6})(?:\s*-\s*(\d{1,6}))?", part)
        low, high = (int(match[1]), int(match[2] or match[1])) if match else (0, 0)
        if not 1 <= low <= high <= count:
            raise InputError(f'"{part}" names no modes', remedy, key="modes", value=part)
        found |= set(range(low, high + 1))
    if not found:
        raise InputError("no mode is named", remedy, key="modes", value=text)
    return tuple(sorted(found))


def modes_text(modes: Any) -> str:
    """Return the shortest text that `parse` reads as `modes`, an iterable of int."""
    modes, parts = sorted(set(modes)), list[str]()
    while modes:
        end = 0
        while end + 1 < len(modes) and modes[end + 1] == modes[end] + 1:
            end += 1
        parts.append(f"{modes[0]}-{modes[end]}" if end > 1 else ", ".join(map(str, modes[: end + 1])))
        modes = modes[end + 1 :]
    return ", ".join(parts)
