"""Wavenumbers that measurements hold: whether they follow from frequency and sound speed, or were given.

`dataclasses.replace` hands a measurement the very array that another one holds, so that a change of the sound speed
alone would leave the wavenumbers, and all positions that follow from them, at the old one.
"""

from __future__ import annotations

import weakref
from dataclasses import dataclass

import numpy as np

from .validation import InputError


@dataclass(frozen=True)
class HeldWavenumbers:
    """Wavenumbers of a measurement.

    Attributes
    ----------
    array : reference to them; dead after the last measurement that holds them
    speed : sound speed of this measurement, m/s
    derived : whether they are 2 pi f / c
    """

    array: weakref.ref
    speed: float
    derived: bool


_held: dict[int, HeldWavenumbers] = {}  # by the id of the array


def hold(array: np.ndarray, speed: float, derived: bool) -> np.ndarray:
    """Remember wavenumbers (M,), rad/m, as long as they live, and return them."""
    key = id(array)
    _held[key] = HeldWavenumbers(weakref.ref(array, lambda _: _held.pop(key, None)), speed, derived)
    return array


def given_wavenumbers(values, speed: float):
    """Return the wavenumbers that are given for a measurement, None where they are to follow from the frequencies.

    Parameters
    ----------
    values : array_like or None
        Those of another measurement count as given only if they were given there.
    speed : float
        m/s, of the measurement.

    Raises
    ------
    InputError
        They were given for a measurement of another sound speed.
    """
    held = _held.get(id(values))
    if held is None or held.array() is not values:
        return values
    if held.derived:
        return None
    if held.speed != speed:
        problem = f"sound_speed = {speed:g} m/s, and the wavenumbers belong to a measurement of {held.speed:g} m/s"
        remedy = "give <wavenumbers>, too: None for 2 pi f / c, those of the new speed, or a copy to keep the old ones"
        raise InputError(problem, remedy, key="wavenumbers", value=speed)
    return values
