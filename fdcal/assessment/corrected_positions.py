"""Given positions as a calibration corrects them, and their key in a result file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..model.validation import InputError

KEY = "given_positions"
FIELDS = ("name", "given_m", "found_m", "difference_m", "sigma_m", "wrong")


@dataclass(frozen=True)
class GivenPosition:
    """A given position and the one found for its microphone.

    Attributes
    ----------
    name : str
        Of the microphone.
    given, found : tuple of D float
        Metres.
    sigma : float
        Metres, one sigma of the position found, the square root of the trace of its covariance.
    wrong : bool
        Whether the pressures contradict the position given.

    Examples
    --------
    >>> GivenPosition("7", (0.0, 0.0), (0.003, 0.004), 0.001, True).difference
    0.005
    """

    name: str
    given: tuple[float, ...]
    found: tuple[float, ...]
    sigma: float
    wrong: bool

    @property
    def difference(self) -> float:
        """Distance of the position found from the one given, metres."""
        return math.dist(self.given, self.found)


def given_table(positions: tuple[GivenPosition, ...]) -> dict:
    """Return the key of the given positions in a result file; none without any."""
    rows = [
        dict(zip(FIELDS, (p.name, list(p.given), list(p.found), p.difference, p.sigma, p.wrong), strict=True))
        for p in positions
    ]
    return {KEY: rows} if rows else {}


def given_of(table: dict) -> tuple[GivenPosition, ...]:
    """Return the given positions in the table of a result file that `require_given` has checked."""
    rows = table.get(KEY, [])
    return tuple(
        GivenPosition(r["name"], tuple(r["given_m"]), tuple(r["found_m"]), r["sigma_m"], r["wrong"]) for r in rows
    )


def require_given(table: dict, where: str) -> None:
    """Raise InputError for a malformed list of given positions."""
    rows, axes = table.get(KEY, []), np.shape(table["positions"])[1]
    if isinstance(rows, list) and all(_is_row(row, axes, table.get("names")) for row in rows):
        return
    fields = ", ".join(f'"{name}"' for name in FIELDS)
    raise InputError(
        f'{where}: "{KEY}" must be a list of {{{fields}}} with {axes} coordinates',
        "write it with `fdcal calibrate -o`",
        key=KEY,
    )


def _is_row(row: Any, axes: int, names: Any) -> bool:
    if not isinstance(row, dict) or set(row) != set(FIELDS) or not isinstance(row["name"], str):
        return False
    if (names is not None and row["name"] not in names) or not isinstance(row["wrong"], bool):
        return False
    places = [row["given_m"], row["found_m"]]
    if not all(isinstance(place, list) and len(place) == axes for place in places):
        return False
    numbers = [*places[0], *places[1], row["difference_m"], row["sigma_m"]]
    return all(_is_finite(number) for number in numbers)


def _is_finite(number: Any) -> bool:
    if isinstance(number, bool) or not isinstance(number, (int, float)):
        return False
    try:
        return math.isfinite(number)
    except OverflowError:  # an integer beyond the range of floats
        return False
