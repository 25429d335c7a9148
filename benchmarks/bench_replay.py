"""The replay of a run: how large 500 states of array 1 are, how long they take to write, and the largest file."""

import dataclasses
import functools

import numpy as np

from fdcal.graphics.replay import replay_html
from fdcal.model.measurement import Measurement
from fdcal.model.scene import load_scene

from .report import Figure, best_time

FIELDS = ("positions", "cost", "step", "sweep", "stage", "moved", "first", "last")


def run_of(count: int, states: int, dimension: int):
    """Return a measurement of zeros, and states in which every microphone moves at random, which compress worst."""
    rng = np.random.default_rng(0)
    truth = rng.uniform(0, 3, (count, dimension))
    pressures = rng.normal(size=(2, count)) + 1j * rng.normal(size=(2, count))
    measurement = Measurement([100.0, 150.0], pressures, 343.0, dimension, positions=truth, known=range(4))
    State = dataclasses.make_dataclass("State", FIELDS)
    moves = rng.normal(size=(states, *truth.shape))
    return measurement, [State(truth + move, 1.0, i, i, 0, -1, 1, 2) for i, move in enumerate(moves)]


def run() -> list[Figure]:
    scene = load_scene("array1_circle")
    figures = []
    for name, count, states, dimension in (("array 1", 65, 500, 2), ("1000 microphones in space", 1000, 500, 3)):
        measurement, moved = run_of(count, states, dimension)
        title = f"replay of {states} states of {name}"
        size = len(replay_html(scene, measurement, moved, title)) / 1e6
        figures.append(Figure(title, size, "MB", "at most 4.5", size <= 4.5))
        write = functools.partial(replay_html, scene, measurement, moved, title)
        figures.append(Figure(f"{title}, to write", best_time(write, 2), "s"))
    return figures
