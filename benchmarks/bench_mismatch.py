"""What 1 dB of gain and 5 degrees of phase mismatch between the channels cost: RMS position error of `draws.SOLVER`."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np

from fdcal.acoustics.measurement_cache import cached_measurement
from fdcal.model.gauge import position_errors
from fdcal.model.scene_file import load_scene
from fdcal.solvers import run as solve

from .draws import SOLVER
from .report import Figure

DRAWS = int(os.environ.get("FDCAL_BENCH_DRAWS", "5"))
KINDS = {"no mismatch": (0.0, 0.0), "1 dB": (1.0, 0.0), "5 degrees": (0.0, 5.0), "1 dB and 5 degrees": (1.0, 5.0)}


def mismatched(measurement, gain_db: float, phase_deg: float, rng: np.random.Generator):
    """`measurement` with a gain and a phase of its own in each channel, Gaussian of these standard deviations."""
    N = measurement.count
    factor = 10 ** (gain_db * rng.standard_normal(N) / 20) * np.exp(1j * np.deg2rad(phase_deg) * rng.standard_normal(N))
    return replace(measurement, pressures=measurement.pressures * factor)


def rms_error(measurement, settings) -> float:
    """Of the positions that `settings` finds, metres."""
    for state in solve(measurement.problem(), settings, 0):
        last = state
    return float(np.sqrt(np.mean(position_errors(last.positions, measurement.positions) ** 2)))


def run() -> list[Figure]:
    figures = []
    for name in ("array1_circle", "array2_random"):
        scene = load_scene(name)
        measurement = cached_measurement(scene)
        settings = replace(scene.solver, name=SOLVER)
        for kind, (gain, phase) in KINDS.items():
            rng = np.random.default_rng(0)
            draws = DRAWS if gain or phase else 1
            errors = [rms_error(mismatched(measurement, gain, phase, rng), settings) for _ in range(draws)]
            pooled = 1e3 * float(np.sqrt(np.mean(np.square(errors))))
            figures.append(Figure(f"{name}, {settings.modes} modes, {kind}: RMS error of {draws} draws", pooled, "mm"))
    return figures
