"""Sets of modes as text: "1-9, 12"."""

from __future__ import annotations

import re

from .validation import InputError

LONGEST = 200  # characters that are read of a text


def parse(text: str, count: int) -> tuple[int, ...]:
    """Return the modes that a text lists, counted from 1, ascending.

    `text`: numbers and ranges with commas between; `count`: number of modes that exist. Raises InputError for a text
    that lists no mode, or one that does not exist.

    Examples
    --------
    >>> parse("1-3, 5", 20)
    (1, 2, 3, 5)
    """
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


def to_text(modes) -> str:
    """Return the shortest text that `parse` reads as `modes`, an iterable of int."""
    modes, parts = sorted(set(modes)), []
    while modes:
        end = 0
        while end + 1 < len(modes) and modes[end + 1] == modes[end] + 1:
            end += 1
        parts.append(f"{modes[0]}-{modes[end]}" if end > 1 else ", ".join(map(str, modes[: end + 1])))
        modes = modes[end + 1 :]
    return ", ".join(parts)
