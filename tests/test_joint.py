"""Laws of the joint solver and of the affine start."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from fields import measured

from fdcal import solvers
from fdcal.checks import InputError
from fdcal.gauge import align, position_errors
from fdcal.scene import Solver
from fdcal.solvers import joint, starts

TRUTH = np.random.default_rng(7).uniform(-0.5, 0.5, (40, 2)) + [2.61, 2.31]
KNOWN = [0, 1, 2]
SETTINGS = Solver(name="joint", modes=40)


def solve(measurement, settings=SETTINGS):
    return list(solvers.run(measurement.problem(), settings, 0))


@pytest.fixture(scope="module")
def clean():
    return solve(measured(TRUTH, KNOWN))


def test_three_known_microphones_place_the_rest_within_millimetres(clean):
    assert clean[-1].finished and clean[-1].converged
    assert position_errors(clean[-1].positions, TRUTH).max() < 2e-3


def test_known_microphones_never_move(clean):
    assert all(np.array_equal(state.positions[KNOWN], TRUTH[KNOWN]) for state in clean)


def test_cost_never_rises_within_a_stage(clean):
    same = [(a, b) for a, b in pairwise(clean) if a.stage == b.stage]
    assert len(same) > 4 and all(b.cost <= a.cost * (1 + 1e-12) for a, b in same)


def test_no_known_microphone_is_needed_up_to_a_rigid_motion():
    last = solve(measured(TRUTH, []))[-1]
    assert last.converged
    assert position_errors(align(last.positions, TRUTH), TRUTH).max() < 5e-3


@pytest.mark.parametrize("snr_db, rms_mm", [(40, 3.0), (20, 40.0)])
def test_noise_costs_accuracy_in_proportion_and_loses_no_array(snr_db, rms_mm):
    for known in (KNOWN, []):
        last = solve(measured(TRUTH, known, snr_db=snr_db, seed=1))[-1]
        placed = last.positions if known else align(last.positions, TRUTH)
        assert np.sqrt(np.mean(position_errors(placed, TRUTH) ** 2)) < 1e-3 * rms_mm


def test_noise_that_nobody_told_is_estimated():
    measurement = replace(measured(TRUTH, KNOWN, snr_db=20, seed=2), noise_power=None)
    last = solve(measurement)[-1]
    assert last.noise[0] == pytest.approx(1e-2, rel=0.4)
    assert np.sqrt(np.mean(position_errors(last.positions, TRUTH) ** 2)) < 0.04


def test_rigid_motion_of_the_truth_moves_the_answer_with_it():
    """The same pressures with the known microphones told in another frame."""
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    measurement = measured(TRUTH, KNOWN)
    told = TRUTH @ turn.T + [1.0, -4.0]
    moved = replace(measurement, positions=told, known_positions=told[KNOWN])
    here, there = (solve(m)[-1].positions for m in (measurement, moved))
    np.testing.assert_allclose(there, here @ turn.T + [1.0, -4.0], atol=2e-4)


def test_same_bits_again_and_gone_on_from_any_state(clean):
    again = solve(measured(TRUTH, KNOWN))
    assert len(again) == len(clean)
    assert all(np.array_equal(a.positions, b.positions) for a, b in zip(again, clean, strict=True))
    problem = measured(TRUTH, KNOWN).problem()
    resumed = joint.step(problem, clean[3])
    np.testing.assert_array_equal(resumed.positions, clean[4].positions)


def test_landscape_is_lowest_at_the_microphone_once_it_is_found(clean):
    problem = measured(TRUTH, KNOWN).problem()
    last, n = clean[-1], 9
    total = joint.landscape(problem, last, n, last.modes).sum(axis=0)
    iy, ix = np.unravel_index(total.argmin(), total.shape)
    lowest = np.array(problem.search.origin) + problem.search.step * np.array([ix, iy])
    assert np.abs(lowest - TRUTH[n]).max() <= problem.search.step


def test_affine_start_is_exact_for_an_affine_field():
    measurement = measured(TRUTH, KNOWN)
    rng = np.random.default_rng(0)
    shape = (len(measurement.frequencies), 2)
    slopes = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    pressures = slopes @ (TRUTH - TRUTH.mean(axis=0)).T + rng.normal(size=(shape[0], 1))
    problem = replace(measurement, pressures=pressures).problem()
    np.testing.assert_allclose(starts.affine(problem), TRUTH, atol=1e-9)


def test_modes_by_hand():
    problem = measured(TRUTH, KNOWN).problem()
    state = joint.use_modes(problem, joint.init(problem, SETTINGS, 0), 3, 20, automatic=False)
    for _ in range(40):
        state = joint.step(problem, state)
        assert (state.first, state.last) == (3, 20)
    assert state.finished


def test_what_cannot_be_solved_is_refused():
    with pytest.raises(InputError, match="use at least"):
        solve(measured(TRUTH, KNOWN), replace(SETTINGS, modes=5, first_modes=3))
    with pytest.raises(InputError, match="were measured"):
        solve(measured(TRUTH, KNOWN), replace(SETTINGS, modes=5000))
    with pytest.raises(InputError, match="span the array, or none"):
        solve(measured(TRUTH, [0, 1]))
    line = np.column_stack([np.linspace(2.2, 3.0, 20), np.full(20, 2.3)])
    with pytest.raises(InputError, match=r"on a line|span the array"):
        solve(measured(line, [0, 1, 2]))
