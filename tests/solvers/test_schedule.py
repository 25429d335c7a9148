"""Laws of what follows a stage, and of when restarts agree."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fields import measured
from solving import run_from

from fdcal import solvers
from fdcal.model.settings import SolverSettings
from fdcal.solvers.robust import objective as objectives
from fdcal.solvers.robust import schedule
from fdcal.solvers.robust.objective import in_unit_power
from fdcal.solvers.robust.schedule import StageEnd, after_stage, begin_final, likeliest, optima_agree
from fdcal.solvers.robust.state import STAGES, LocalOptimum

TRUTH = np.random.default_rng(7).uniform(-0.5, 0.5, (24, 2)) + [2.61, 2.31]


@pytest.fixture(scope="module")
def run() -> tuple[Any, list]:
    """A blind run in noise: several restarts, then the last stage."""
    problem = measured(TRUTH, [], snr_db=30, modes=40).problem()
    solver = solvers.load("robust")
    states = run_from(solver, problem, solver.init(problem, SolverSettings(name="robust", modes=40), 0))
    return in_unit_power(problem), states


def optimum(state, away: float, score: float, **changes) -> LocalOptimum:
    """The likeliest optimum of `state` with one microphone `away`, metres, and another score."""
    best = likeliest(state)
    moved = best.positions + np.where(np.arange(24)[:, None] == 3, [away, 0.0], 0.0)
    return replace(best, positions=moved, score=best.score + score, **changes)


def test_optima_agree_only_if_restarts_end_in_one_place_but_for_faulty_channels(run):
    problem, states = run
    best = optimum(states[-1], 0.0, 0.0)
    noisy = replace(best, model=replace(best.model, channel_noise=np.where(np.arange(24) == 3, 100.0, 1.0)))
    for one, away, score, agree in (
        (best, 1e-3, 5.0, True), (best, 0.2, 5.0, False), (best, 1e-3, np.inf, False), (noisy, 0.2, 5.0, True),
    ):  # fmt: skip
        both = (optimum(states[-1], away, score), one)
        assert optima_agree(problem, replace(states[-1], optima=both)) == agree, (away, score)
    assert not optima_agree(problem, replace(states[-1], optima=(best,))), "one optimum confirms nothing"


def test_the_last_stage_goes_on_from_the_likeliest_optimum(run):
    problem, states = run
    worse = optimum(states[-1], 0.05, 50.0)
    for optima in ((worse, likeliest(states[-1])), (likeliest(states[-1]), worse)):
        begun = begin_final(problem, replace(states[-1], optima=optima, finished=False))
        np.testing.assert_allclose(begun.positions, likeliest(states[-1]).positions, atol=1e-12)
        assert STAGES[begun.progress.stage].name == "final"


def test_a_doubtful_restart_is_followed_by_another_until_two_agree(run):
    problem, states = run
    numbers = [state.progress.restart for state in states]
    count = len(states[-1].optima)
    assert count > 1 and sorted(set(numbers)) == list(range(count)) and numbers == sorted(numbers)
    assert optima_agree(problem, states[-1])
    before = [state for state in states if 1 < len(state.optima) < count]
    assert not any(optima_agree(problem, state) for state in before)


@pytest.mark.parametrize(("noisier", "explained"), [(1.0, True), (50.0, True), (1e6, False)])
def test_without_noise_an_array_with_a_channel_that_fits_nowhere_explains_nothing(run, noisier, explained):
    """Even where what is left of all channels is rounding: the channel's own noise is far more than that."""
    problem, states = run
    quiet = replace(problem, noise_power=np.zeros(len(problem.pressures)))
    loud = np.where(np.arange(24) == 3, noisier, 1.0)
    model = replace(states[-1].model, directional=True, noise_fraction=1e-8, channel_noise=loud)
    assert schedule.explains_all(quiet, replace(states[-1], model=model)) == explained


@pytest.mark.parametrize("stage", range(len(STAGES)))
def test_a_singular_covariance_ends_the_restart_and_chosen_modes_end_the_run(run, stage):
    problem, states = run
    reached = next(state for state in states if state.progress.stage == stage)
    objective = objectives.objective_of(problem, reached, objectives.used_modes(problem, reached))
    singular = objectives.ChannelStep(objectives.unknowns_of(reached), np.inf, 0.0, 1e-3, 0.0, np.arange(0))
    after = after_stage(StageEnd(problem, reached, objective, singular, False))
    if STAGES[stage].name == "final":
        assert after.finished and not after.converged
    else:
        assert len(after.optima) == len(reached.optima) + 1 and after.optima[-1].score == np.inf
        terms = objective.evaluate(singular.unknowns).terms
        chosen = StageEnd(problem, replace(reached, automatic=False), objective, replace(singular, terms=terms), True)
        assert after_stage(chosen).finished and after_stage(chosen).converged
