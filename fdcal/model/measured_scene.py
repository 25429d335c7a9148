"""A placeholder scene of a measurement, whose room is unknown.

The page and session files work with a scene. Of a placeholder they show title, solver, seed and gauge alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .array_layout import Array, Gauge
from .measurement import Measurement
from .room import Room, Source
from .scene import Scene
from .sensing import Sensing
from .settings import Search, SolverSettings

CELLS = 50  # steps along the search domain of a placeholder
MARGIN = 1.0  # metres around the known positions of the array


@dataclass(frozen=True)
class MeasuredScene(Scene):
    """A scene whose title, solver, seed and gauge are real; room, source and array are placeholders."""


def placeholder_scene(measurement: Measurement, name: str, solver: SolverSettings, seed: int = 0) -> MeasuredScene:
    """Return a scene for a measurement that has none.

    Parameters
    ----------
    measurement : Measurement
    name : str
        Name of its file.
    solver : SolverSettings
    seed : int
    """
    D, d = measurement.dimension, measurement.array_dimension
    places = measurement.positions if measurement.positions is not None else measurement.known_positions
    low, high = (np.min(places, axis=0), np.max(places, axis=0)) if len(places) else (np.zeros(d), np.ones(d))
    low, size = low - MARGIN, np.maximum(high - low, 0.1) + 2 * MARGIN
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
    """Return an array with as many microphones and coordinates as the measurement."""
    if boxed and d == 2:
        return Array("plane", center=(4.5, 4.0, 3.5), shape=(measurement.count, 1), size=(1.0, 0.1))
    places = measurement.positions
    if places is None:
        places = 0.1 * np.arange(measurement.count)[:, None] * np.ones(d)
    return Array("positions", positions=_rows(places))


def _rows(values) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in np.asarray(values).tolist())
