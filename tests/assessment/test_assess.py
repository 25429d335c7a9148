"""The verdict on a result of solver robust: codes, texts, and that scale does not matter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fields import measured
from test_odd_channels import KNOWN, MODES, array

from fdcal.assessment.channel_verdict import judge
from fdcal.model.settings import SolverSettings
from fdcal.solvers import run
from fdcal.solvers.robust.convergence import is_converged, remaining_step


@pytest.fixture(scope="module")
def solved():
    """Problem and last state of a healthy array."""
    problem = measured(array(), np.array(KNOWN), snr_db=40.0, modes=MODES).problem("unit", "all")
    *_, state = run(problem, SolverSettings(name="robust", modes=MODES), 0)
    return problem, state


def test_a_healthy_array_is_good_and_its_residual_is_the_noise(solved):
    verdict = judge(*solved)
    assert verdict.code == "good" and verdict.message.startswith("nothing speaks against these positions")
    assert 0.5 < verdict.residual_to_noise < 2
    assert not verdict.positions.flags.writeable and np.all(verdict.sigma > 0)


def test_a_run_that_was_stopped_is_not_converged(solved):
    problem, state = solved
    verdict = judge(problem, replace(state, converged=False, finished=False))
    assert verdict.code == "not_converged"
    assert verdict.worded({"modes": "the number of modes"}).endswith("use other the number of modes")


def test_more_noise_than_given_is_a_mismatch_of_the_model(solved):
    problem, state = solved
    verdict = judge(replace(problem, noise_power=problem.noise_power / 30), state)
    assert verdict.code == "model_mismatch" and "what the noise explains" in verdict.message
    unexplained = replace(state, model=replace(state.model, share=0.01))
    verdict = judge(replace(problem, noise_power=0 * problem.noise_power), unexplained)
    assert verdict.code == "model_mismatch" and "free of noise" in verdict.message


def test_hardly_anything_but_noise_is_too_noisy(solved):
    problem, state = solved
    verdict = judge(problem, replace(state, model=replace(state.model, share=0.4)))
    assert verdict.code == "too_noisy" and "40 % of the power" in verdict.message


def test_another_end_that_is_as_likely_makes_it_ambiguous(solved):
    problem, state = solved
    best = min(state.ends, key=lambda end: end.score)
    away = best.positions + 0.1 * np.random.default_rng(0).normal(size=best.positions.shape)
    rival = replace(best, positions=away, score=best.score + 1.0)
    verdict = judge(problem, replace(state, ends=(best, rival)))
    assert verdict.code == "ambiguous" and "explains the pressures as well" in verdict.message
    unlikely = replace(rival, score=best.score + 100.0)
    assert judge(problem, replace(state, ends=(best, unlikely))).code == "good"


def test_sigma_holds_the_distance_to_another_end_by_its_likelihood(solved):
    problem, state = solved
    best = min(state.ends, key=lambda end: end.score)
    best = replace(best, positions=state.positions)
    aside = replace(best, positions=state.positions + [0.006, 0.0], score=best.score + 1.0)
    alone = judge(problem, replace(state, ends=(best,))).covariance
    both = judge(problem, replace(state, ends=(best, aside))).covariance
    weight = np.exp(-1) / (1 + np.exp(-1))
    assert np.allclose((both - alone)[:, 0, 0], weight * 0.006**2) and np.allclose((both - alone)[:, 1], 0, atol=1e-12)


def test_the_step_left_adds_to_sigma_and_a_long_one_is_no_convergence(solved):
    problem, state = solved
    before = judge(problem, state)
    n = int(np.setdiff1d(np.arange(len(state.positions)), problem.known)[0])
    aside = np.array(state.positions)
    aside[n, 0] += 2 * np.sqrt(before.covariance[n, 0, 0])
    after = judge(problem, replace(state, positions=aside, ends=()))
    assert after.sigma[n] > 1.5 * before.sigma[n] and not is_converged(problem, replace(state, positions=aside))
    aside[n, 0] += 10 * np.sqrt(before.covariance[n, 0, 0])
    assert judge(problem, replace(state, positions=aside, ends=())).code == "not_converged"


def test_given_positions_that_contradict_the_pressures_are_reported(solved):
    problem, state = solved
    errors = 0.003 * np.array([[1, 1], [-1, 1], [1, -1], [-1, -1]])
    moved = replace(problem, known_positions=problem.known_positions + errors)
    verdict = judge(moved, replace(state, model=replace(state.model, known_sigma=5e-4)))
    assert verdict.code == "known_position" and "do not agree" in verdict.message
    assert judge(problem, state).code == "good"


def test_a_given_position_that_nothing_checks_is_not_good():
    problem = measured(array(), np.array(KNOWN[:3]), snr_db=15.0, modes=8).problem("unit", "all")
    *_, state = run(problem, SolverSettings(name="robust", modes=8), 0)
    assert judge(problem, state).code != "good"


def test_uneven_residuals_are_a_mismatch_but_not_those_of_uneven_gains(solved):
    problem, state = solved
    tau = np.array(state.model.channel_noise)
    tau[:8] *= 4
    verdict = judge(problem, replace(state, model=replace(state.model, channel_noise=tau)))
    assert verdict.code == "model_mismatch" and "8 of" in verdict.message
    gains = np.array(state.gains)
    gains[:8, 0] -= np.log(2)
    quiet = replace(problem, pressures=problem.pressures * np.exp(gains[:, 0] - state.gains[:, 0]))
    faint = replace(state, gains=gains, model=replace(state.model, channel_noise=tau, gain_sigma=1.0))
    assert "times that of the median one" not in judge(quiet, faint).message


def test_a_run_converges_where_the_step_left_is_a_small_part_of_sigma(solved):
    problem, state = solved
    assert state.converged and is_converged(problem, state)
    step, sigma = remaining_step(problem, state)
    assert np.max(np.abs(step) / sigma) < 0.2 and np.all(sigma > 0)


def test_where_given_positions_place_the_array_a_step_of_the_whole_array_is_no_step_left(solved):
    problem, state = solved
    assert len(problem.known) and problem.frame is None
    _, sigma = remaining_step(problem, state)
    shifted = state.positions + 0.5 * sigma.min()
    assert np.max(np.abs(remaining_step(problem, replace(state, positions=shifted))[0]) / sigma) > 0.2
    assert is_converged(problem, replace(state, positions=shifted))
    alone = state.positions.copy()
    alone[problem.free[0]] += sigma[problem.free[0]]
    assert not is_converged(problem, replace(state, positions=alone))
