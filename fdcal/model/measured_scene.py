"""The scene of a measurement, whose room is unknown.

The page and session files work with a scene. Of a measured one they show title, remark, solver, seed and gauge alone;
its room, source and array are placeholders, which nothing simulates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .array_layout import Array, Gauge
from .measurement import Measurement
from .measurement_file import load_measurement
from .room import Room, Source
from .scene import Scene
from .sensing import Sensing
from .settings import Search, SolverSettings
from .validation import InputError, shown_literal

CELLS = 50  # steps along the search domain of a placeholder
MARGIN = 1.0  # metres around the known positions of the array
KEYS = ("name", "title", "measurement", "remark")  # of the file of a scene that is a measurement


@dataclass(frozen=True)
class MeasuredScene(Scene):
    """A scene whose title, solver, seed and gauge are real; room, source and array are placeholders."""

    file: str = ""  # path of the measurement; "" where whoever opens the scene has the measurement
    remark: str = ""  # what was measured, by whom, and under which licence: shown below the scene's name

    @staticmethod
    def optional(table: dict) -> tuple[str, ...]:
        """Return the keys that the table of a measured scene may leave out."""
        return (*Scene.optional(table), "file", "remark")


def load_measured_scene(table: Mapping[str, Any]) -> MeasuredScene:
    """Return the scene of a measurement that comes as a file.

    `table`: `name`, `title`, `measurement`, the path of an .npz file, and `remark`, which may be missing. Raises
    InputError for another key, or a value that is no text; StorageError: the measurement cannot be read.
    """
    for key, value in table.items():
        if key not in KEYS:
            problem = f"{key} has no meaning in a scene that is a measurement, of which nothing is simulated"
            raise InputError(problem, "remove it", key=key)
        if not isinstance(value, str):
            raise InputError(f"{key} = {shown_literal(value)} must be a text", "write it in quotes", key=key)
    measurement = load_measurement(table["measurement"])
    return placeholder_scene(
        measurement,
        table["name"],
        SolverSettings(),
        title=table["title"],
        file=table["measurement"],
        remark=table.get("remark", ""),
    )


def placeholder_scene(
    measurement: Measurement,
    name: str,
    solver: SolverSettings,
    seed: int = 0,
    *,
    title: str = "",
    file: str = "",
    remark: str = "",
) -> MeasuredScene:
    """Return a scene for a measurement that has none.

    `name`: name of its file; `title`: the name and "as measured" unless given; `file`, `remark`: as of `MeasuredScene`.
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
        title=title or f"{name}, as measured",
        room=Room(size=(9.0, 8.0, 7.0), sound_speed=c) if boxed else Room(outline=_rows(corners), sound_speed=c),
        source=Source(position=(0.1,) * 3 if boxed else tuple((low + 0.1).tolist())),
        array=_array(measurement, boxed, d),
        gauge=Gauge(known=tuple(measurement.known.tolist())),
        search=search,
        measurement=Sensing(wavenumber="continuous"),
        solver=solver,
        seed=seed,
        file=file,
        remark=remark,
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
