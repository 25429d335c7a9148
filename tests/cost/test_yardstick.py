"""The cost by which the positions of all solvers are compared."""

import dataclasses

import numpy as np
import pytest

from fdcal.acoustics.fourier_bessel import max_order
from fdcal.acoustics.measurement_cache import cached_measurement
from fdcal.acoustics.spherical_harmonics import spherical_bessel
from fdcal.cost.eq7 import cost
from fdcal.cost.reference_cost import ReferenceCost, decibels, reference_cost_of
from fdcal.model.faults import Faults
from fdcal.model.scene_file import load_scene, scene_names
from fdcal.model.validation import InputError

SHIFT = 0.05  # m


def noise_free(name):
    """The measurement of a scene without noise and without faults of its channels."""
    scene = load_scene(name)
    plain = dataclasses.replace(scene.measurement, snr_db=np.inf)
    return cached_measurement(dataclasses.replace(scene, measurement=plain, faults=Faults()))


def brute_force(problem, positions, offset):
    """Eq. 7 of every mode with fewer functions than microphones, mode by mode, relative to the power, dB."""
    left = power = 0.0
    for p, k in zip(problem.pressures, problem.wavenumbers, strict=True):
        L = int(max_order(k, problem.search.radius, offset))
        if problem.dimension == 2:
            if 2 * L + 1 < len(p):
                left += cost(positions, p[None], [k], [L], positions.mean(axis=0))[0]
                power += np.sum(np.abs(p) ** 2)
            continue
        W = spherical_bessel(positions, complex(k), L, positions.mean(axis=0))
        if W.shape[1] < len(p):
            left += np.sum(np.abs(p - W @ np.linalg.pinv(W, rcond=1e-13) @ p) ** 2)
            power += np.sum(np.abs(p) ** 2)
    return 10 * np.log10(left / power)


@pytest.mark.parametrize("name", scene_names())
def test_from_the_truth_moving_any_microphone_raises_it(name):
    measurement = noise_free(name)
    truth, reference_cost = np.array(measurement.positions), ReferenceCost(measurement.problem())
    there, rng = reference_cost(truth), np.random.default_rng(0)
    for n in range(len(truth)):
        away = rng.normal(size=truth.shape[1])
        moved = truth.copy()
        moved[n] += SHIFT * away / np.linalg.norm(away)
        assert reference_cost(moved) > there + 5.0, n


@pytest.mark.parametrize("name", ["tiny", "ball3d", "plane3d"])
def test_it_is_equation_7_of_all_modes_at_one_order(name):
    measurement = cached_measurement(load_scene(name))
    problem, rng = measurement.problem(), np.random.default_rng(0)
    for spread in (0.0, 0.01, 0.3):
        positions = measurement.positions + spread * rng.normal(size=measurement.positions.shape)
        assert ReferenceCost(problem)(positions) == pytest.approx(brute_force(problem, positions, 2), abs=1e-6)
    far = measurement.positions + np.eye(measurement.count)[:, :1] * 9.0  # beyond the tables
    assert ReferenceCost(problem)(far) == pytest.approx(brute_force(problem, far, 2), abs=1e-6)


def test_it_falls_as_the_positions_improve():
    measurement = noise_free("tiny")
    reference_cost, rng = ReferenceCost(measurement.problem()), np.random.default_rng(1)
    away = rng.normal(size=measurement.positions.shape)
    costs = [reference_cost(measurement.positions + 0.03 * share * away) for share in (1.0, 0.5, 0.25, 0.1, 0.0)]
    assert all(np.diff(costs) < -3)


def test_rotations_translations_and_mirror_images_do_not_change_it():
    for name in ("tiny", "ball3d"):
        measurement = cached_measurement(load_scene(name))
        reference_cost, x = ReferenceCost(measurement.problem()), np.array(measurement.positions)
        turn, _ = np.linalg.qr(np.random.default_rng(2).normal(size=(x.shape[1], x.shape[1])))
        turned = x @ turn.T + 0.1
        assert reference_cost(turned) == pytest.approx(reference_cost(x), abs=1e-6)


def test_it_does_not_depend_on_how_the_modes_are_scaled_to_each_other_or_on_the_solver():
    measurement = cached_measurement(load_scene("tiny"))
    unit, raw = (ReferenceCost(measurement.problem(weights)) for weights in ("unit", "raw"))
    assert unit.count == raw.count == len(measurement.frequencies)
    assert raw(measurement.positions) < -30


def test_positions_that_are_not_finite_have_none():
    measurement = cached_measurement(load_scene("tiny"))
    assert np.isnan(ReferenceCost(measurement.problem())(np.full((16, 2), np.nan)))
    assert np.isnan(decibels(np.nan)) and decibels(0.0) == -160


def test_few_microphones_lower_the_order_and_too_few_have_none():
    measurement = cached_measurement(load_scene("tiny"))
    problem = measurement.problem()
    six = dataclasses.replace(problem, pressures=problem.pressures[:, :6])
    assert ReferenceCost(six).order_offset < 2 and np.isfinite(ReferenceCost(six)(measurement.positions[:6]))
    two = dataclasses.replace(problem, pressures=problem.pressures[:, :2])
    with pytest.raises(InputError, match="too few"):
        ReferenceCost(two)
    with pytest.raises(InputError, match="search"):
        ReferenceCost(dataclasses.replace(problem, search=None))
    assert reference_cost_of(two) is None
