"""A stand-in for the scene of a measurement, whose room nobody has told: the page wants one, and draws none of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .array_layout import Array, Gauge
from .measurement import Measurement
from .room import Room, Source
from .scene import Scene
from .settings import Search, Sensing, SolverSettings

CELLS = 50  # of the lattice that stands in
AROUND = 1.0  # metres, by which the room that stands in is larger than what is known of the array


@dataclass(frozen=True)
class MeasuredScene(Scene):
    """A scene of which title, solver, seed and gauge are true, room, source and array only stand in."""


def placeholder_scene(measurement: Measurement, name: str, solver: SolverSettings, seed: int = 0) -> MeasuredScene:
    """The scene of a measurement that has none."""
    D, d = measurement.dimension, measurement.array_dimension
    places = measurement.positions if measurement.positions is not None else measurement.known_positions
    low, high = (np.min(places, axis=0), np.max(places, axis=0)) if len(places) else (np.zeros(d), np.ones(d))
    low, size = low - AROUND, np.maximum(high - low, 0.1) + 2 * AROUND
    boxed, step = D == 3, float(size.max()) / CELLS
    search = measurement.search or (None if boxed else Search(tuple(low.tolist()), (CELLS * step,) * 2, step))
    corners = low + size * np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) if not boxed else None
    c = measurement.sound_speed
    return MeasuredScene(
        name=name,
        title=f"{name}, as measured",
        room=Room(size=(9.0, 8.0, 7.0), sound_speed=c) if boxed else Room(outline=_rows(corners), sound_speed=c),
        source=Source(position=(0.1,) * 3 if boxed else tuple((low + 0.1).tolist())),
        array=_array(measurement, boxed, d),
        gauge=Gauge(known=tuple(measurement.known.tolist())),
        search=search,
        measurement=Sensing(wavenumber="continuous"),
        solver=solver,
        seed=seed,
    )


def _array(measurement: Measurement, boxed: bool, d: int) -> Array:
    """As many microphones, of as many coordinates."""
    if boxed and d == 2:
        return Array("plane", center=(4.5, 4.0, 3.5), shape=(measurement.count, 1), size=(1.0, 0.1))
    places = measurement.positions
    if places is None:
        places = 0.1 * np.arange(measurement.count)[:, None] * np.ones(d)
    return Array("positions", positions=_rows(places))


def _rows(values) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in np.asarray(values).tolist())
