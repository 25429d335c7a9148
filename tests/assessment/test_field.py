"""The field between the microphones, and the prediction of each of them by the others."""

from __future__ import annotations

import numpy as np
import pytest
from fields import measured
from scipy.linalg import solve

from fdcal.acoustics.box_field import point_source_pressures as box_field
from fdcal.acoustics.dictionary import dictionary
from fdcal.assessment.field import NOISE_DEFLATION, cross_validate, leave_one_out_errors
from fdcal.cost.noise import DIFFUSE_FLOOR
from fdcal.model.measurement import Measurement
from fdcal.model.scene import Room

RNG = np.random.default_rng(7)
PLANE = np.array([2.61, 2.31]) + RNG.uniform(-0.5, 0.5, (30, 2))
SPACE = np.array([1.9, 1.6, 1.3]) + RNG.uniform(-0.4, 0.4, (60, 3))
BOX, BOX_SOURCE = Room(size=(4.1, 3.3, 2.6)), (3.6, 0.4, 2.1)
SOURCE = (5.47, 4.53)


def plane(snr_db: float = np.inf, highest: float = 250.0) -> Measurement:
    return measured(PLANE, [0, 1, 2], highest, snr_db)


def space(places=SPACE) -> Measurement:
    frequencies = np.array([60.0, 130.0, 220.0])
    k = (2 * np.pi * frequencies - 3j) / 343.0
    pressures = box_field(BOX, BOX_SOURCE, places, k)
    noise = 1e-6 * np.mean(np.abs(pressures) ** 2, axis=1)
    return Measurement(frequencies, pressures, 343.0, 3, wavenumbers=k, noise_power=noise, positions=places)


def every(measurement: Measurement) -> slice:
    return slice(0, len(measurement.frequencies))


@pytest.mark.parametrize("faulty", [(), (3, 7)])
@pytest.mark.parametrize("measurement", [plane(40.0), space()], ids=["plane", "space"])
def test_leave_one_out_errors_are_those_of_a_fit_without_the_microphone(measurement, faulty):
    problem, modes = measurement.problem(), slice(2, 3)
    healthy = ~np.isin(np.arange(measurement.count), faulty)
    errors = leave_one_out_errors(problem, measurement.positions, modes, problem.noise_power, healthy)
    x, p = measurement.positions, problem.pressures[2]
    W = dictionary(x, problem.wavenumbers[2], 12, x[healthy].mean(axis=0), problem.dimension)
    power = np.mean(np.abs(p[healthy]) ** 2)
    v = max(problem.noise_power[2], DIFFUSE_FLOOR * power)
    mu = v / (NOISE_DEFLATION * (power - v))
    for n in (0, 7, 19):
        rest = healthy & (np.arange(len(p)) != n)
        A = W[rest].conj().T @ W[rest] + mu * np.eye(W.shape[1])
        predicted = W[n] @ solve(A, W[rest].conj().T @ p[rest], assume_a="pos")
        assert errors[0, n] == pytest.approx(p[n] - predicted, rel=1e-5, abs=1e-8)


def test_a_displaced_microphone_is_predicted_worst():
    measurement = plane(40.0)
    problem, displaced = measurement.problem(), PLANE.copy()
    inner = int(np.argmin(np.linalg.norm(PLANE - PLANE.mean(axis=0), axis=1)))
    displaced[inner] += [0.05, -0.05]
    found = cross_validate(problem, displaced, every(measurement), problem.noise_power)
    assert int(found.microphones.argmax()) == inner
    power = 10 ** (np.array([found.modes, [found.overall] * len(found.modes)]) / 10)
    assert power[0].mean() == pytest.approx(power[1, 0])
