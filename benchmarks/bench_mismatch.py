"""How a mismatch of 1 dB and 5 degrees between the channels affects the RMS position error of `draws.SOLVER`.

In the measured room one channel is inverted and one is dead, too. Both must be named; the error is that of the others.
"""

import os
from dataclasses import replace

import numpy as np

from fdcal.acoustics.measure import cached_measurement
from fdcal.model.gauge import position_errors
from fdcal.model.scene import load_scene
from fdcal.model.settings import Faults
from fdcal.session.calibration_run import solve as calibrate
from fdcal.session.sources import CalibrationInput
from fdcal.solvers import run as solve

from .draws import SOLVER
from .report import Figure

DRAWS = int(os.environ.get("FDCAL_BENCH_DRAWS", "5"))
LAB_SEEDS = 2
KINDS = {"no mismatch": (0.0, 0.0), "1 dB": (1.0, 0.0), "5 degrees": (0.0, 5.0), "1 dB and 5 degrees": (1.0, 5.0)}


def mismatched(measurement, gain_db: float, phase_deg: float, rng: np.random.Generator):
    """Return a measurement whose channels have random gains and phases with these standard deviations."""
    N = measurement.count
    factor = 10 ** (gain_db * rng.standard_normal(N) / 20) * np.exp(1j * np.deg2rad(phase_deg) * rng.standard_normal(N))
    return replace(measurement, pressures=measurement.pressures * factor)


def rms_error(measurement, settings) -> float:
    """Return the RMS error of the positions that `settings` finds, metres."""
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
    return [*figures, *measured_room()]


def measured_room() -> list[Figure]:
    """Calibrate the listening room with mismatch and two faults, as the command line does."""
    figures = []
    for seed in range(LAB_SEEDS):
        scene = load_scene("listening_lab")
        inverted, dead = np.random.default_rng(seed).choice(scene.array.count, 2, replace=False).tolist()
        faults = Faults(inverted=(inverted,), dead=(dead,), gain_db=1.0, phase_deg=5.0)
        measurement = cached_measurement(replace(scene, seed=seed, faults=faults))
        settings = replace(scene.solver, name=SOLVER)
        found = calibrate(CalibrationInput("listening_lab", scene, measurement, settings, 0))
        healthy = np.delete(found.errors, [inverted, dead])
        named = {fault.name for fault in found.channels.faults} == {str(inverted), str(dead)}
        rms = 1e3 * float(np.sqrt(np.mean(healthy**2)))
        name = f"listening_lab, seed {seed}, mismatch, one inverted, one dead: {found.verdict}, RMS error"
        figures.append(Figure(name, rms, "mm", "<= 4 mm, both named", rms <= 4 and named))
    return figures
