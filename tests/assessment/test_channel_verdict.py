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
