"""Points: their check, and how they are written."""

from __future__ import annotations

from .limits import LIMITS
from .validation import InputError, require_finite


def require_point(key: str, values, lengths: tuple[int, ...]) -> None:
    """Raise InputError unless `values` are finite coordinates, as many as one of `lengths`, which are 2 or 3."""
    if len(values) not in lengths:
        words = " or ".join({2: "two, along x and y", 3: "three, along x, y and z"}[n] for n in lengths)
        raise InputError(f"{key} = {list(values)} has {len(values)} numbers", f"give {words}", key=key, value=values)
    require_finite(key, values)
    if max(map(abs, values)) > LIMITS.coordinate:
        remedy = f"use coordinates up to {LIMITS.coordinate:g} m"
        raise InputError(f"{key} = {list(values)} is too far away", remedy, key=key, value=values)


def point_text(point) -> str:
    """Return the coordinates of a point for a message: "(1.25, 0.5) m"."""
    return f"({', '.join(f'{coordinate:.4g}' for coordinate in point)}) m"
