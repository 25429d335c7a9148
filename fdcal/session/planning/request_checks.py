"""Checks of what a plan is asked for: each raises InputError with key and remedy."""

from __future__ import annotations

import numpy as np

from ...model import measurement_checks
from ...model.validation import InputError, require_integer, require_not_negative, require_positive
from .layout import Layout

ONE_PLACE = 1e-6  # of the array's extent: microphones that are closer count as one


def require_layout(layout: Layout, most: int) -> None:
    """Raise InputError for too few or too many microphones, or for two at one place."""
    x = layout.positions
    N, least = len(x), x.shape[1] + 3
    if not least <= N <= most:
        raise InputError(f"the layout has {N} microphones", f"give {least} to {most}", key="layout", value=N)
    apart = np.linalg.norm(x[:, None] - x[None], axis=-1)
    first, second = np.array(np.triu_indices(N, 1))[:, np.argmin(apart[np.triu_indices(N, 1)])]
    if apart[first, second] <= ONE_PLACE * apart.max():
        problem = f"microphones {layout.names[first]} and {layout.names[second]} are at one place"
        raise InputError(problem, "move them apart, or leave one out", key="layout")


def require_room(room: tuple[float, ...] | None, array_dimension: int) -> None:
    """Raise InputError unless a room has two or three lengths, and heights where the array has them."""
    if room is None:
        return
    if len(room) not in (2, 3):
        raise InputError(f"room = {list(room)} has {len(room)} lengths", "give <room> two or three", key="room")
    for length in room:
        require_positive("room", length, "m")
    if len(room) < array_dimension:
        raise InputError("the array has heights and the room has none", "give <room> three lengths", key="room")


def require_given(known: tuple[int, ...], known_sigma: float, positions: np.ndarray) -> None:
    """Raise InputError for given microphones that do not exist, or a sigma of positions that are not given."""
    N, D = positions.shape
    measurement_checks.known(known, None, positions, N, D)
    require_not_negative("known_sigma", known_sigma, "m")
    if known_sigma and not len(known):
        problem = f"known_sigma = {known_sigma:g} m is of given positions, and none is given"
        raise InputError(problem, "give <known>, or leave out <known_sigma>", key="known_sigma", value=known_sigma)


def require_modes(modes: int | None, least: int) -> None:
    """Raise InputError unless a number of frequencies is enough for a calibration."""
    if modes is not None:
        require_integer("modes", modes, least)


def require_takes(takes: int, most: int) -> None:
    """Raise InputError unless a number of takes is possible."""
    require_integer("takes", takes, 1)
    if takes > most:
        raise InputError(f"takes = {takes} are too many", f"give <takes> from 1 to {most}", key="takes", value=takes)
