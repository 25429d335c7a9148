"""Sets of modes as a hand writes them: "1-9, 12"."""

from __future__ import annotations

import re

from .validation import InputError

LONGEST = 200  # characters


def parse(text: str, count: int) -> tuple[int, ...]:
    """Modes, counted from 1 and ascending, of a text such as "1-9, 12"; InputError for what `count` modes lack."""
    found: set[int] = set()
    for part in filter(None, (part.strip() for part in str(text)[:LONGEST].split(","))):
        match = re.fullmatch(r"(\d{1,6})(?:\s*-\s*(\d{1,6}))?", part)
        low, high = (int(match[1]), int(match[2] or match[1])) if match else (0, 0)
        if not 1 <= low <= high <= count:
            raise InputError(f'"{part}" names no modes; write numbers from 1 to {count}, as in 1-3, 5')
        found |= set(range(low, high + 1))
    if not found:
        raise InputError(f"no mode is named; write numbers from 1 to {count}, as in 1-3, 5")
    return tuple(sorted(found))


def to_text(modes) -> str:
    """The shortest text that `read` takes back to `modes`."""
    modes, parts = sorted(set(modes)), []
    while modes:
        end = 0
        while end + 1 < len(modes) and modes[end + 1] == modes[end] + 1:
            end += 1
        parts.append(f"{modes[0]}-{modes[end]}" if end > 1 else ", ".join(map(str, modes[: end + 1])))
        modes = modes[end + 1 :]
    return ", ".join(parts)
