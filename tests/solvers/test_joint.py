"""Laws of solver `joint`: the likelihood solver for matched channels and exact given positions."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from fields import measured, rigid_room, room_frequencies
from hypothesis import given, strategies
from hypothesis import settings as settings_of_hypothesis
from solving import same, simulated_square

from fdcal import solvers
from fdcal.acoustics import compiled
from fdcal.model.gauge import align, position_errors
from fdcal.model.measurement import Measurement
from fdcal.model.settings import SolverSettings
from fdcal.solvers import joint as joint
from fdcal.solvers.robust.objective import in_unit_power, objective_of, unknowns_of, used_modes
from fdcal.solvers.robust.state import SEARCH

TRUTH = np.random.default_rng(7).uniform(-0.5, 0.5, (28, 2)) + [2.61, 2.31]
KNOWN = [0, 1, 2]
SETTINGS = SolverSettings(name="joint", modes=40)


RUNS: dict[bytes, list] = {}  # the runs of this process: some tests start from the same run


def solve_again(measurement, settings=SETTINGS):
    return list(solvers.run(measurement.problem(), settings, 0))


def solve(measurement, settings=SETTINGS):
    key = pickle.dumps((measurement, settings))
    if key not in RUNS:
        RUNS[key] = solve_again(measurement, settings)
    return RUNS[key]


@pytest.fixture(scope="module")
def clean():
    return solve(measured(TRUTH, KNOWN))


def test_three_known_microphones_never_move_and_place_the_rest_within_millimetres(clean):
    assert clean[-1].finished and clean[-1].converged and are_held(clean, KNOWN, TRUTH[KNOWN])
    assert position_errors(clean[-1].positions, TRUTH).max() < 2e-3


def are_held(states, known, places):
    """Return whether known microphones are exactly in place in every state."""
    return all(np.array_equal(state.positions[known], places) for state in states)


def test_known_microphones_never_move_though_their_channels_record_only_noise_or_their_positions_are_wrong():
    measurement = measured(TRUTH[:12], [*KNOWN, 3], snr_db=40, modes=16)
    pressures, given = measurement.pressures.copy(), TRUTH[[*KNOWN, 3]].copy()
    draws = np.random.default_rng(1).normal(size=(2, len(pressures))) * np.sqrt(np.mean(np.abs(pressures) ** 2))
    pressures[:, 1] = draws[0] + 1j * draws[1]
    given[3] += 0.2, -0.1
    states = solve(replace(measurement, pressures=pressures, known_positions=given), replace(SETTINGS, modes=16))
    assert states[-1].finished and len(states[-1].optima) > 0
    assert are_held(states, [*KNOWN, 3], given)
    assert all(np.array_equal(one.positions[[*KNOWN, 3]], given) for one in states[-1].optima)


def test_a_step_never_raises_what_it_minimises(clean):
    """Power and noise of the field are estimated between steps, so that each step has its own objective."""
    problem = in_unit_power(measured(TRUTH, KNOWN).problem())
    same = [(a, b) for a, b in pairwise(clean) if a.stage == b.stage and a.progress.stage != SEARCH]
    assert len(same) > 4
    for before, after in same:
        goal = objective_of(problem, before, used_modes(problem, before))
        here, there = (goal.evaluate(unknowns_of(state), False).cost for state in (before, after))
        assert there == pytest.approx(after.cost, rel=1e-12) and there <= here


def test_noise_costs_accuracy_and_loses_no_array():
    last = solve(measured(TRUTH, [], snr_db=20, seed=1))[-1]
    assert np.sqrt(np.mean(position_errors(align(last.positions, TRUTH), TRUTH) ** 2)) < 0.04


def test_noise_is_estimated_unless_it_is_reported_and_a_given_snr_overrides_what_is_reported():
    """A stated noise within a factor of the estimate is used unchanged."""
    reported, settings = measured(TRUTH, KNOWN, snr_db=20, seed=2), replace(SETTINGS, modes=24)
    power = np.mean(np.abs(reported.pressures) ** 2, axis=1)
    near, far = (replace(reported, noise_power=factor * reported.noise_power) for factor in (1.5, 30.0))
    runs = (near, replace(settings, noise="20")), (near, settings), (far, replace(settings, noise="auto"))
    given, own, auto = (solve(*of)[-1] for of in runs)
    np.testing.assert_allclose(given.model.noise, 1 / 101, rtol=1e-12)
    np.testing.assert_allclose(own.model.noise, near.noise_power / power, rtol=1e-9)
    assert auto.model.noise_fraction == pytest.approx(1e-2, rel=0.4)
    assert np.sqrt(np.mean(position_errors(auto.positions, TRUTH) ** 2)) < 0.04


def test_a_rigid_motion_of_the_known_microphones_moves_the_answer_with_it_and_not_them():
    """This also holds for a known microphone at the origin of the other frame, where any rounding error would show."""
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    measurement = measured(TRUTH, KNOWN)
    positions = (TRUTH - TRUTH[KNOWN[0]]) @ turn.T
    states = solve(replace(measurement, positions=positions, known_positions=positions[KNOWN]))
    here = solve(measurement)[-1].positions
    np.testing.assert_allclose(states[-1].positions, (here - TRUTH[KNOWN[0]]) @ turn.T, atol=2e-4)
    assert are_held(states, KNOWN, positions[KNOWN])


def in_minimal_gauge(positions):
    """Return whether exactly the minimal gauge is fixed: the first known place, the direction, and the side."""
    ahead = TRUTH[1] - TRUTH[0]
    normal = np.array([-ahead[1], ahead[0]])
    a, b, c = positions[KNOWN]
    placed = np.allclose(a, TRUTH[0], atol=1e-12) and abs((b - a) @ normal) < 1e-12 and (b - a) @ ahead > 0
    return placed and np.sign((c - a) @ normal) == np.sign((TRUTH[2] - TRUTH[0]) @ normal)


@pytest.mark.parametrize("name", ["joint", "robust"])
def test_the_minimal_gauge_places_the_array_as_documented(name):
    problem = measured(TRUTH, KNOWN, snr_db=30).problem("unit", "minimal")
    states = list(solvers.run(problem, replace(SETTINGS, name=name, known="minimal"), 0))
    assert in_minimal_gauge(states[0].positions) and in_minimal_gauge(states[-1].positions)
    assert np.linalg.norm(states[-1].positions[1] - TRUTH[1]) > 1e-6
    assert position_errors(states[-1].positions, TRUTH).max() < 2e-2
    for state in states:  # the pressures do not determine the place of the array, but it does not drift either
        assert np.linalg.norm(state.positions.mean(axis=0) - TRUTH.mean(axis=0)) < 0.5


@settings_of_hypothesis(max_examples=2, deadline=None, derandomize=True)
@given(strategies.integers(0, 10_000), strategies.floats(3.5, 7.0), strategies.floats(0.6, 0.9))
def test_random_arrays_in_random_rooms_are_found_blind(seed, width, ratio):
    rng = np.random.default_rng(seed)
    size = width, width * ratio
    frequencies = room_frequencies(300, size=size)[:50]
    angle, reach = 2 * np.pi * rng.random(30), 0.5 * np.sqrt(rng.random(30))
    truth = np.column_stack([reach * np.cos(angle), reach * np.sin(angle)]) + np.multiply(size, [0.43, 0.46])
    wavenumbers = (2 * np.pi * frequencies - 3j) / 343.0
    pressures = rigid_room(truth, np.multiply(size, [0.95, 0.93]), wavenumbers, size=size)
    measurement = Measurement(frequencies, pressures, 343.0, wavenumbers=wavenumbers)
    last = solve(measurement, SolverSettings(modes=len(frequencies)))[-1]
    assert last.converged and position_errors(align(last.positions, truth), truth).max() < 5e-3


def test_the_bits_do_not_depend_on_the_number_of_cores(clean, monkeypatch):
    monkeypatch.setattr(compiled, "_pool", lambda name: ThreadPoolExecutor(1))
    np.testing.assert_array_equal(solve_again(measured(TRUTH, KNOWN))[-1].positions, clean[-1].positions)


def test_a_random_start_is_drawn_by_the_seed_and_nothing_else_is():
    problem, settings = measured(TRUTH, KNOWN).problem(), replace(SETTINGS, start="random")
    one, again, other = (joint.init(problem, settings, seed) for seed in (0, 0, 1))
    assert same(one, again) and not np.array_equal(one.positions, other.positions)
    assert same(*(joint.init(problem, SETTINGS, seed) for seed in (0, 1)), but=("seed",))


def test_a_random_start_in_a_wrong_basin_is_followed_by_the_starts_of_the_solver():
    """The likeliest of these starts explains this array, which has no noise."""
    measurement = simulated_square()
    settings = SolverSettings(name="joint", modes=57, start="random")
    states = list(solvers.run(measurement.problem(), settings, 1))
    assert {state.progress.restart for state in states} == {0, 1}
    assert states[-1].converged and position_errors(states[-1].positions, measurement.positions).max() < 5e-4


def test_an_array_in_another_frame_is_bent_to_exact_positions_before_the_first_step():
    """This also holds for a start at given positions: the deformation is smooth, and zero if they are in place."""
    problem, there = measured(TRUTH, KNOWN).problem(), np.array(TRUTH)
    assert np.array_equal(joint.init(problem, SETTINGS, 0, there).positions, TRUTH)
    off = there + 0.05 * np.sin(3 * there[:, ::-1])
    begun = joint.init(problem, SETTINGS, 0, off).positions
    assert np.array_equal(begun[KNOWN], TRUTH[KNOWN])
    assert position_errors(begun, TRUTH).max() < 2 * position_errors(off, TRUTH).max()
