"""The kinds of map in the list Show: their labels, and the style that each stands for."""

from __future__ import annotations

from ...model.measurement import Measurement
from .choices import BASINS, FLOOR, NOTHING, RELIEF, SHAPE, VOLUME, Choices, has_volume

KINDS = (FLOOR, RELIEF, SHAPE, BASINS, VOLUME, NOTHING)


def kinds_of(measurement: Measurement) -> tuple[str, ...]:
    """Return those of KINDS that there can be of a measurement."""
    return tuple(kind for kind in KINDS if kind != VOLUME or has_volume(measurement))


def kind_of(choices: Choices) -> str:
    """Return which kind of map the choices ask for."""
    style = choices.style
    if not choices.shown:
        return NOTHING
    if style.basins:
        return BASINS
    if style.volume:
        return VOLUME
    return RELIEF if style.relief else SHAPE if style.shape else FLOOR


def style_of(kind: str, measurement: Measurement) -> dict[str, bool]:
    """Return the fields of a MapStyle that make a map one of `kinds_of`.

    The basins of an array in space are those of descent in three dimensions, on a slice.
    """
    return {
        "relief": kind == RELIEF,
        "shape": kind == SHAPE,
        "basins": kind == BASINS,
        "volume": kind == VOLUME or (kind == BASINS and has_volume(measurement)),
    }
