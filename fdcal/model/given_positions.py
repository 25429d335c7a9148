"""Positions that somebody gives: of named microphones, as files hold them, and of those of a measurement."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .measurement import Measurement, microphone_index
from .validation import InputError, frozen_array, require_array, shown_literal


@dataclass(frozen=True)
class MicrophonePositions:
    """Positions of named microphones in space."""

    names: tuple[str, ...]  # (N,) tuple of str, each different
    positions: np.ndarray  # (N, 3) float64, metres; (N, 2) is taken as the plane z = 0
    uncertainty: np.ndarray | None = None  # (N,) float64 or None, one standard deviation of the position, metres
    frame: str = "as found"  # name of the coordinate system

    def __post_init__(self):
        positions = require_array("positions", self.positions, "real", (len(self.names), None), "m")
        if positions.shape[1] not in (2, 3):
            problem = f"positions have shape {positions.shape}"
            raise InputError(problem, "give shape (N, 2) or (N, 3), metres", key="positions")
        space = np.zeros((len(positions), 3))
        space[:, : positions.shape[1]] = positions
        object.__setattr__(self, "positions", frozen_array(space, float))
        if self.uncertainty is not None:
            spread = require_array("uncertainty_m", self.uncertainty, "real", (len(self.names),), "m")
            object.__setattr__(self, "uncertainty", spread)
        if len(set(self.names)) < len(self.names):
            raise InputError("two microphones have the same name", "rename one of them", key="names")


FLAT = 1e-6  # metres: heights that differ less are one height


def with_known(measurement: Measurement, known: Mapping[Any, Any] | Sequence[Any]) -> Measurement:
    """Return a measurement with other known microphones.

    `known`: names or numbers of microphones, which a mapping maps to positions (D,), metres. Of a sequence, the
    positions are those that the measurement has.
    """
    names = measurement.names
    numbers = [microphone_index(str(key), names, "known") for key in known]
    if len(set(numbers)) < len(numbers):
        raise InputError("known gives a microphone twice", "give each of <known> once", key="known")
    places: list[np.ndarray] = []
    for key, number in zip(known, numbers, strict=True):
        if isinstance(known, Mapping):
            try:
                places.append(np.asarray(known[key], float))
            except (TypeError, ValueError) as error:
                problem = f"the position of known microphone {key} is {shown_literal(known[key])}"
                raise InputError(problem, "give numbers, metres, in <known>", key="known", value=known[key]) from error
        elif number in measurement.known:
            places.append(measurement.known_positions[measurement.known.tolist().index(number)])
        elif measurement.positions is not None:
            places.append(measurement.positions[number])
        else:
            problem = f"the measurement holds no position of microphone {names[number]}"
            raise InputError(problem, "give a mapping of names to positions as <known>", key="known")
    shape = (measurement.array_dimension,)
    for number, place in zip(numbers, places, strict=True):
        if place.shape != shape:
            problem = f"the position of known microphone {names[number]} has shape {place.shape}"
            raise InputError(problem, f"give {shape[0]} coordinates, metres, in <known>", key="known")
    rows = np.array(places, float).reshape(len(numbers), *shape)
    return replace(measurement, known=numbers, known_positions=rows)


def with_positions(measurement: Measurement, placed: MicrophonePositions, excluded: int = 0) -> Measurement:
    """Return a measurement with the positions of all microphones, to compare with.

    Channels are found by name where all names are given, otherwise by order. `placed` may also hold the `excluded`
    channels that were left out of the measurement.
    """
    rows = _rows(measurement.names, placed.names, excluded)
    positions = np.asarray(placed.positions)[rows]
    D = measurement.array_dimension
    if D == 2 and np.ptp(positions[:, 2]) > FLAT:
        problem = "the positions given have different heights, and this array is in the plane"
        raise InputError(problem, "give <positions> of one height", key="positions")
    return replace(
        measurement,
        positions=positions[:, :D],
        known=measurement.known,
        known_positions=measurement.known_positions,
        nominal=False,
    )


def listed_names(names: Sequence[str], given: Sequence[str], excluded: int = 0) -> tuple[str, ...]:
    """Return the name of each channel, with the one of its row of a list in parentheses where that is another."""
    rows = zip(names, _rows(names, given, excluded), strict=True)
    return tuple(name if given[row] == name else f"{name} ({given[row]})" for name, row in rows)


def row_order_remark(names: Sequence[str], given: Sequence[str]) -> str:
    """Return in words that the rows of a list count and not their names, `given`; "" where it has all of `names`."""
    shared = len(set(names) & set(given))
    if shared == len(names):
        return ""
    few = f"only {shared} of {len(names)} names of the list are names of channels" if shared else "the names differ"
    return f"{few}: the list is taken in row order, {given[0]} = channel {names[0]}"


def _rows(names: Sequence[str], given: Sequence[str], excluded: int) -> list[int]:
    """Return the row of `given` for each of `names`."""
    if set(names) <= set(given):
        return [list(given).index(name) for name in names]
    if len(given) == len(names):
        return list(range(len(names)))
    numbers = [int(name) for name in names if name.isascii() and name.isdigit()]
    if len(given) == len(names) + excluded and len(numbers) == len(names) and max(numbers) < len(given):
        return numbers
    problem = f"{len(given)} positions are given for {len(names)} microphones, and their names differ"
    remedy = "give <positions> of all microphones, in the order of the channels or with their names"
    raise InputError(problem, remedy, key="positions")
