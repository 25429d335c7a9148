"""Accuracy of the paper's descent: arrays 1 and 2, ten seeds each, from a random start."""

import time
from dataclasses import replace

import numpy as np

from benchmarks.report import Figure
from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.model.gauge import position_errors
from fdcal.model.scene import load_scene

SEEDS = 10
NEAR = 0.05  # metres


def run() -> list[Figure]:
    return [figure for name in ("array1_circle", "array2_random") for figure in _scene(name)]


def _scene(name: str) -> list[Figure]:
    scene = load_scene(name)
    settings, measurement = replace(scene.solver, name="descent"), cached_measurement(scene)
    problem = measurement.problem(scene.solver.weights)
    errors, sweeps, start = [], [], time.process_time()
    for seed in range(SEEDS):
        for state in solvers.run(problem, settings, seed):  # noqa: B007, the last one counts
            pass
        errors.append(position_errors(state.positions, measurement.positions).mean())
        sweeps.append(state.sweep)
    seconds = (time.process_time() - start) / SEEDS
    near = np.array(errors) <= NEAR
    return [
        Figure(f"{name}: mean error at the end, median of {SEEDS} seeds", 1e3 * float(np.median(errors)), "mm"),
        Figure(f"{name}: least and", 1e3 * min(errors), "mm"),
        Figure(f"{name}: largest mean error", 1e3 * max(errors), "mm"),
        Figure(f"{name}: seeds that end within 5 cm", 100 * float(near.mean()), "%"),
        Figure(f"{name}: sweeps, mean", float(np.mean(sweeps)), ""),
        Figure(f"{name}: processor time of a run, mean", seconds, "s", "at most 45", seconds <= 45),
    ]
