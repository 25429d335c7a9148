"""Parts of a calibration, and their keys in a result file: the evidence of a verdict, and the room of solver "room"."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Evidence:
    """The figures behind a verdict.

    Attributes
    ----------
    residual_to_noise : float
        Reduced chi-square of the pressures: power of the residual over that of the noise.
    leave_one_out_db : float or None
        Leave-one-out prediction error over pressure, decibels, of all microphones and frequencies together.
    microphones_db : (N,) float64 or None
        The same of each microphone.
    frequencies_db : (M,) float64 or None
        The same of each frequency.
    """

    residual_to_noise: float
    leave_one_out_db: float | None = None
    microphones_db: np.ndarray | None = None
    frequencies_db: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class KnownRoom:
    """What solver "room" finds beside the positions.

    Attributes
    ----------
    size : tuple of D float
        Metres.
    source : (D,) float64
        Position of the source, metres.
    admittance : complex
        Specific admittance of the walls.
    symmetries : tuple of (str, (N, D) float64)
        Each array that the pressures cannot distinguish from the one found, which comes first: the map, such as
        "(6 - x, y)", and the positions, metres.
    """

    size: tuple[float, ...]
    source: np.ndarray
    admittance: complex
    symmetries: tuple[tuple[str, np.ndarray], ...]


def plain(value):
    """Return a value as JSON can hold it: arrays and tuples as lists."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    return list(value) if isinstance(value, tuple) else value


def evidence_table(evidence: Evidence | None) -> dict:
    """Return the keys of the evidence in a result file; none without it."""
    if evidence is None:
        return {}
    return {
        "residual_to_noise": evidence.residual_to_noise,
        "left_out_db": evidence.leave_one_out_db,
        "left_out_microphones_db": plain(evidence.microphones_db),
        "left_out_frequencies_db": plain(evidence.frequencies_db),
    }


def evidence_of(table: dict) -> Evidence | None:
    """Return the evidence in the table of a result file; None where an older version wrote it."""
    if "residual_to_noise" not in table:
        return None
    names = ("left_out_db", "left_out_microphones_db", "left_out_frequencies_db")
    return Evidence(table["residual_to_noise"], *(table.get(name) for name in names))


def room_table(room: KnownRoom | None) -> dict:
    """Return the keys of the room in a result file; none without it."""
    if room is None:
        return {}
    return {
        "room": list(room.size),
        "symmetries": [{"map": name, "positions": positions.tolist()} for name, positions in room.symmetries],
        "source": room.source.tolist(),
        "admittance": [room.admittance.real, room.admittance.imag],
    }


def room_of(table: dict) -> KnownRoom | None:
    """Return the room in the table of a result file; None unless it is of solver "room"."""
    if "symmetries" not in table:
        return None
    size, walls = tuple(table["room"].tolist()), complex(*table["admittance"])
    return KnownRoom(size, table["source"], walls, tuple(table["symmetries"]))
