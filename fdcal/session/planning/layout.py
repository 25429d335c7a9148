"""The array of a plan: from a table, a geometry of Acoular, a scene, or words such as "circle 16 0.2"."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...acoustics.measure import cached_measurement
from ...model.array_layout import Array
from ...model.arrays import positions_of
from ...model.geometries import ball, box, circle, rectangle
from ...model.measured_scene import MeasuredScene
from ...model.scene import Scene
from ...model.scene_file import load_scene, scene_names
from ...model.validation import InputError, frozen_array
from ...recordings.formats.positions import READERS, read_positions

FLAT_M = 1e-6  # heights that differ by less are one plane
FORMS = ("circle", "rectangle", "ball", "box")
EXAMPLES = '"circle 16 0.2", "rectangle 4x4 0.6x0.6", "ball 32 0.3" or "box 32 0.6x0.6x0.4"'


@dataclass(frozen=True)
class Layout:
    """The microphones of a plan."""

    name: str  # of the file or scene, or the words
    names: tuple[str, ...]  # (N,) tuple of str
    positions: np.ndarray  # (N, D) float64, metres; D is 2 for a plane array
    scene: Scene | None = None


def read_layout(text: str, seed: int = 0) -> Layout:
    """Return the array that `text` names.

    `text`: a table with the columns name,x,y[,z] (.csv), a geometry of Acoular (.xml), a scene, or a geometry in words:
    its name as in scenes, then count and radius, or shape and size, metres; `seed`: of the random geometries "ball" and
    "box". Raises InputError, StorageError: it names no array, or the file cannot be read.
    """
    words = text.split()
    if Path(text).suffix.lower() in READERS:
        placed = read_positions(text)
        return Layout(Path(text).name, placed.names, _flattened(placed.positions))
    if len(words) > 1 or text in FORMS:
        positions = _of_words(words, text, seed)
        return Layout(text, tuple(map(str, range(len(positions)))), frozen_array(positions, float))
    if text in scene_names() or text.lower().endswith(".toml"):
        scene = load_scene(text)
        if isinstance(scene, MeasuredScene):
            return _of_measurement(scene)
        positions = positions_of(scene)
        return Layout(scene.name, tuple(map(str, range(len(positions)))), positions, scene)
    remedy = f"give a .csv or .xml file of positions, a scene ({', '.join(scene_names())}), or a geometry as {EXAMPLES}"
    raise InputError(f'"{text}" names no array', remedy, key="layout", value=text)


def _of_measurement(scene: MeasuredScene) -> Layout:
    measurement = cached_measurement(scene)
    if measurement.positions is None:
        problem = f"{scene.name} is a measurement without positions"
        raise InputError(problem, "give a table of them, or another scene", key="layout", value=scene.name)
    return Layout(scene.name, measurement.names, measurement.positions)


def _flattened(positions: np.ndarray) -> np.ndarray:
    """Return the positions of a horizontal array without their heights."""
    flat = np.ptp(positions[:, 2]) < FLAT_M
    return frozen_array(positions[:, :2] if flat else positions, float)


def _of_words(words: list[str], text: str, seed: int) -> np.ndarray:
    kind, rng = words[0], np.random.default_rng(seed)
    if kind not in FORMS or len(words) != 3:
        raise InputError(f'"{text}" is no geometry', f"write it as {EXAMPLES}", key="layout", value=text)
    first, second = _numbers(words[1], int, text), _numbers(words[2], float, text)
    if kind == "rectangle":
        array = Array(kind, shape=first, size=second)
        return rectangle(array.shape or (), array.size or ())
    if kind == "box":
        array = Array(kind, count=first[0], size=second)
        return box(array.count or 0, array.size, rng)
    array = Array(kind, count=first[0], radius=second[0])
    if kind == "circle":
        return circle(array.count or 0, array.radius or 0.0)
    return ball(array.count or 0, array.radius or 0.0, rng)


def _numbers(word: str, kind: type, text: str) -> tuple:
    try:
        return tuple(kind(part) for part in word.lower().split("x"))
    except ValueError:
        raise InputError(f'"{text}" is no geometry', f"write it as {EXAMPLES}", key="layout", value=text) from None
