"""Scenes as TOML files: those that come with fdcal, and anyone's own."""

from __future__ import annotations

import os
from pathlib import Path

from .from_table import build
from .measured_room import is_response_file
from .measured_scene import load_measured_scene
from .reading import parse_toml, read_bytes
from .scene import Scene
from .validation import InputError, shown

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


def scene_table(path: str | Path) -> dict:
    """Return the table of a scene's file, of `load_scene`'s argument, as `fdcal.model.from_table.build` takes it.

    In place of the table `measurement` that of a measured scene has the path of its measurement.
    """
    path = _file_of(Path(path))
    table = parse_toml(read_bytes(path, what="scene"), path)
    table = {"name": path.stem, "title": path.stem, **table}
    return _with_files_beside(table, path.resolve().parent)


def _with_files_beside(table: dict, folder: Path) -> dict:
    """Return the table of a scene with the paths of a measurement and of a measured room's file.

    In the file they are relative to the scene's folder.
    """
    room, measurement = table.get("room"), table.get("measurement")
    if isinstance(measurement, str):
        table = {**table, "measurement": str(folder / measurement)}
    text = room.get("response") if isinstance(room, dict) else room
    if not isinstance(text, str) or not is_response_file(text):
        return table
    found = str(folder / text)
    return {**table, "room": {**room, "response": found} if isinstance(room, dict) else found}


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
        raise InputError(f'scene "{shown(str(path))}" is unknown', f"use {available}", key="scene", value=path)
    return scene_folder() / f"{path.name}.toml"
