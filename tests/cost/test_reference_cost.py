"""The cost by which the positions of all solvers are compared, also where the solver estimates faulty channels."""

from dataclasses import replace

import numpy as np
import pytest
from solving import run_from

from fdcal import solvers
from fdcal.acoustics.dictionary import max_order, spherical_bessel
from fdcal.acoustics.measure import cached_measurement
from fdcal.cost.eq7 import ReferenceCost, cost, decibels, reference_cost_of
from fdcal.cost.maps import eq7_maps, mode_shape, power_shares
from fdcal.model.problem import ChannelCorrection
from fdcal.model.scene import load_scene
from fdcal.model.validation import InputError
from fdcal.session.scene_edits import edited

SHIFT = 0.05  # m
FAULTY = (9, 3)  # inverted, dead


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


@pytest.mark.parametrize("name", ["tiny", "ball3d", "plane3d"])
def test_it_is_equation_7_of_all_modes_at_one_order(name):
    measurement = cached_measurement(load_scene(name))
    problem, rng = measurement.problem(), np.random.default_rng(0)
    for spread in (0.0, 0.01, 0.3):
        positions = measurement.positions + spread * rng.normal(size=measurement.positions.shape)
        assert ReferenceCost(problem)(positions) == pytest.approx(brute_force(problem, positions, 2), abs=1e-6)
    raw = ReferenceCost(measurement.problem("raw"))
    assert raw.count == ReferenceCost(problem).count and raw(measurement.positions) < -30, "however modes are scaled"
    assert np.isnan(raw(np.nan * positions)) and np.isnan(decibels(np.nan)) and decibels(0.0) == -160
    far = measurement.positions + np.eye(measurement.count)[:, :1] * 9.0  # beyond the tables
    assert ReferenceCost(problem)(far) == pytest.approx(brute_force(problem, far, 2), abs=1e-6)


def test_few_microphones_lower_the_order_and_too_few_have_none():
    measurement = cached_measurement(load_scene("tiny"))
    problem = measurement.problem()
    six = replace(problem, pressures=problem.pressures[:, :6])
    assert ReferenceCost(six).order_offset < 2 and np.isfinite(ReferenceCost(six)(measurement.positions[:6]))
    two = replace(problem, pressures=problem.pressures[:, :2])
    with pytest.raises(InputError, match="too few"):
        ReferenceCost(two)
    with pytest.raises(InputError, match="search"):
        ReferenceCost(replace(problem, search=None))
    assert reference_cost_of(two) is None


@pytest.fixture(scope="module")
def run():
    """`tiny` with faulty channels, calibrated: its true positions, problem, and the states of the run."""
    faults = {"inverted": [FAULTY[0]], "dead": [FAULTY[1]], "gain_db": 1.0, "phase_deg": 5.0}
    scene = edited(load_scene("tiny"), {f"faults.{key}": value for key, value in faults.items()})
    measurement, solver = cached_measurement(scene), solvers.load(scene.solver.name)
    problem = measurement.problem(scene.solver.weights, scene.solver.known)
    return (
        np.array(measurement.positions),
        problem,
        run_from(solver, problem, solver.init(problem, scene.solver, scene.seed)),
    )


def test_moving_any_healthy_microphone_from_the_truth_raises_it(run):
    truth, problem, states = run
    reference_cost, channels, rng = ReferenceCost(problem), states[-1].channels, np.random.default_rng(0)
    there = reference_cost(truth, channels)
    for n in np.setdiff1d(np.arange(len(truth)), FAULTY):
        away, moved = rng.normal(size=2), truth.copy()
        moved[n] += SHIFT * away / np.linalg.norm(away)
        assert reference_cost(moved, channels) > there + 5.0, n


def test_a_map_at_the_estimate_is_the_reference_cost(run):
    _, problem, states = run
    state, reference_cost, search = states[-1], ReferenceCost(problem), problem.search
    there = replace(search, origin=tuple(map(float, state.positions[7])), size=(search.step,) * 2)
    modes = range(1, reference_cost.count + 1)
    total = eq7_maps(problem, state.positions, 7, modes, 2, there, state.channels).sum(axis=0)
    assert decibels(total[0, 0]) == pytest.approx(reference_cost.of(state), abs=1e-6)
    alone = [eq7_maps(problem, state.positions, 7, (mode,), 2, there, state.channels)[0, 0, 0] for mode in modes]
    assert power_shares(problem, state, modes) @ alone == pytest.approx(total[0, 0], rel=1e-9)


def test_gains_multiplied_into_the_pressures_come_out_again():
    measurement = cached_measurement(load_scene("tiny"))
    problem, x, rng = measurement.problem(), measurement.positions, np.random.default_rng(3)
    gains = np.exp(0.3 * rng.normal(size=len(x)) + 3j * rng.normal(size=len(x)))
    spoiled = replace(problem, pressures=problem.pressures * gains)
    channels = ChannelCorrection(gains, np.ones(len(x)))
    assert ReferenceCost(spoiled)(x, channels) == pytest.approx(ReferenceCost(problem)(x), abs=1e-6)
    assert ReferenceCost(spoiled)(x) > ReferenceCost(problem)(x) + 20
    maps = (eq7_maps(spoiled, x, 9, (1, 5), 2, None, channels), eq7_maps(problem, x, 9, (1, 5), 2))
    np.testing.assert_allclose(*maps, rtol=1e-6, atol=1e-12)
    turned = replace(spoiled, pressures=spoiled.pressures * np.exp(0.8j))  # the phase of a mode is unknown
    shapes = mode_shape(turned, x, 5, 2, channels), mode_shape(problem, x, 5, 2)
    np.testing.assert_allclose(*shapes, atol=1e-9)


def test_a_channel_of_infinite_noise_is_as_if_it_were_left_out():
    measurement = cached_measurement(load_scene("tiny"))
    problem, x = measurement.problem(), np.array(measurement.positions)
    low = slice(0, 8)  # modes that one microphone fewer can carry
    problem = replace(problem, pressures=problem.pressures[low], wavenumbers=problem.wavenumbers[low])
    x[:-1] += 0.01 * np.random.default_rng(4).normal(size=x[:-1].shape)
    x[-1] = x[:-1].mean(axis=0)  # the centre of the expansion stays
    noise = np.append(np.ones(len(x) - 1), 1e14)
    fewer = replace(problem, pressures=problem.pressures[:, :-1])
    assert ReferenceCost(problem).count == ReferenceCost(fewer).count == 8
    expected = ReferenceCost(fewer)(x[:-1])
    assert ReferenceCost(problem)(x, ChannelCorrection(np.ones(len(x)), noise)) == pytest.approx(expected, abs=1e-6)
