"""Scenes as TOML files: those that come with fdcal, and anyone's own; simulated, or a measurement with a title."""

import difflib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .declared import build
from .measurement import Measurement, load_measurement
from .room import Room, Source, is_response_file
from .scene import Array, Gauge, Scene
from .settings import Search, Sensing, SolverSettings
from .storage import parse_toml, read_bytes
from .validation import InputError, shown, shown_literal

CELLS = 50  # steps along the search domain of a placeholder
MARGIN = 1.0  # metres around the known positions of the array
KEYS = ("name", "title", "measurement", "remark")  # of the file of a scene that is a measurement


@dataclass(frozen=True)
class MeasuredScene(Scene):
    """A scene whose title, solver, seed and gauge are real; room, source and array are placeholders."""

    file: str = ""  # path of the measurement; "" where whoever opens the scene has the measurement
    remark: str = ""  # what was measured, by whom, and under which licence: shown below the scene's name

    @staticmethod
    def optional(table: dict[str, Any]) -> tuple[str, ...]:
        """Return the keys that the table of a measured scene may leave out."""
        return (*Scene.optional(table), "file", "remark")


def load_measured_scene(table: Mapping[str, Any]) -> MeasuredScene:
    """Return the scene of a measurement in a file, of a table with the KEYS, all texts; `remark` may be missing."""
    for key, value in table.items():
        if key not in KEYS:
            problem = f"{key} has no meaning in a scene that is a measurement, of which nothing is simulated"
            raise InputError(problem, "remove it", key=key)
        if not isinstance(value, str):
            raise InputError(f"{key} = {shown_literal(value)} must be a text", "write it in quotes", key=key)
    file, remark = table["measurement"], table.get("remark", "")
    return placeholder_scene(
        load_measurement(file), table["name"], SolverSettings(), title=table["title"], file=file, remark=remark
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
    """Return a scene for a measurement that has none; `title`: the name and "as measured" unless given."""
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


def _rows(values: Any) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in np.asarray(values).tolist())


# Files that are taken for scenes: what they are instead, and where they belong.
OTHER_FILES = {
    ".csv": "a table, which <positions> and the known microphones of an import take",
    ".xml": "a table of positions, which <positions> takes",
    ".json": "a result or a session, which `fdcal export` or `fdcal view` takes",
}


def scene_folder() -> Path:
    """Return the folder of the scenes that come with fdcal: in the checkout, or inside an installed package."""
    beside = Path(__file__).parents[1] / "scenes"
    return beside if beside.is_dir() else Path(__file__).parents[2] / "scenes"


def scene_names() -> list[str]:
    """Return the names of the scenes that come with fdcal."""
    return sorted(path.stem for path in scene_folder().glob("*.toml"))


def load_scene(path: str | Path) -> Scene:
    """Return the scene of a TOML file, or one that comes with fdcal, by its name.

    Parameters
    ----------
    path : str or Path
        A .toml file, or one of `scene_names()`.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        For an unknown or missing key, a wrong type or an impossible value.
    StorageError
        If the file cannot be read.

    Examples
    --------
    >>> load_scene("tiny").room.size
    (1.68, 1.2)
    """
    table = scene_table(path)
    return load_measured_scene(table) if isinstance(table.get("measurement"), str) else build(Scene, table)


def scene_table(path: str | Path) -> dict[str, Any]:
    """Return the table of a scene's file, of `load_scene`'s argument, as `fdcal.model.declared.build` takes it.

    Of a measured scene `measurement` is a path. The paths in a file are relative to its folder.
    """
    path = _file_of(Path(path))
    table = {"name": path.stem, "title": path.stem, **parse_toml(read_bytes(path, what="scene"), path)}
    folder, room = path.resolve().parent, table.get("room")
    if isinstance(table.get("measurement"), str):
        table["measurement"] = str(folder / table["measurement"])
    text = room.get("response") if isinstance(room, dict) else room
    if isinstance(text, str) and is_response_file(text):
        table["room"] = {**room, "response": str(folder / text)} if isinstance(room, dict) else str(folder / text)
    return table


def _file_of(path: Path) -> Path:
    """Return the file of a scene that is given by its path or its name."""
    available = f"a .toml file or one of {', '.join(scene_names())}"
    if path.suffix == ".npz":
        raise InputError(f"{path} is a measurement", f"give a scene: {available}", key="scene", value=path)
    if path.suffix.lower() in OTHER_FILES and os.path.isfile(path):  # False for a name that is too long
        raise InputError(f"{path} is {OTHER_FILES[path.suffix.lower()]}", f"give a scene: {available}", key="scene")
    if os.path.isdir(path) and path.name not in scene_names():
        problem = f"{path} is a folder in which no recordings were found"
        raise InputError(problem, f"give a file, a folder of MeshRIR, or {available}", key="scene", value=path)
    if path.suffix == ".toml" or "\0" in str(path) or os.path.isfile(path):
        return path
    if path.suffix.lower() in OTHER_FILES:
        return path  # there is none: reading it says so
    if path.name not in scene_names() or path.name != str(path):
        near = [name for name in scene_names() if name.startswith(str(path))]
        near = near or difflib.get_close_matches(str(path)[:60], scene_names(), 1)
        meant = f"did you mean {near[0]}? use {available}" if near else f"use {available}"
        raise InputError(f'scene "{shown(str(path))}" is unknown', meant, key="scene", value=path)
    return scene_folder() / f"{path.name}.toml"
