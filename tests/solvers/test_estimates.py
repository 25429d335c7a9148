"""What is estimated and assumed beside the positions: noise, power, evidence, faulty channels."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fields import measured
from solving import run_from

from fdcal import solvers
from fdcal.model.settings import SolverSettings
from fdcal.solvers import load
from fdcal.solvers.robust import channels, noise, objective, result, schedule
from fdcal.solvers.robust import objective as objectives
from fdcal.solvers.robust.noise import with_silent_inside
from fdcal.solvers.robust.objective import channel_step, in_unit_power, objective_of, unknowns_of, used_modes
from fdcal.solvers.robust.schedule import StageEnd, after_stage, begin_final, likeliest, optima_agree
from fdcal.solvers.robust.state import FINAL, STAGES, LocalOptimum

COUNT, KNOWN, MODES = 24, [0, 5, 9, 14], 40
TRUTH = np.random.default_rng(7).uniform(-0.5, 0.5, (COUNT, 2)) + [2.61, 2.31]


@pytest.fixture(scope="module")
def ended():
    """A problem in unit power at 26 dB, and the last state of a run."""
    problem = measured(TRUTH, KNOWN, snr_db=26, modes=MODES).problem()
    *_, state = solvers.run(problem, SolverSettings(name="robust", modes=MODES), 0)
    return in_unit_power(problem), state


def likelihood(problem, state) -> float:
    """The likelihood alone at `state`."""
    return objective_of(problem, state, used_modes(problem, state)).evaluate(unknowns_of(state), False).terms.cost


def test_a_gain_that_all_channels_share_goes_to_the_field_and_changes_no_likelihood(ended):
    problem, state = ended
    louder = replace(state, gains=state.gains + [0.3, -0.2])
    centred = noise.centred(louder)
    np.testing.assert_allclose(np.median(centred.gains - centred.offsets, axis=0), 0, atol=1e-12)
    assert likelihood(problem, centred) == pytest.approx(likelihood(problem, louder), rel=1e-10)


def test_the_covariance_does_not_rest_on_a_field_as_isotropic_as_assumed(ended, monkeypatch):
    problem, state = ended
    weaker = result(problem, state).spread.newton
    monkeypatch.setattr(objective, "WEAKER_FIELD", 1.0)
    assert np.trace(weaker) > 1.02 * np.trace(result(problem, state).spread.newton)


def test_of_two_optima_of_one_cost_the_less_determined_one_has_more_evidence(ended):
    """Laplace: half the logarithm of the determinant, one half log 4 for each unknown that is twice as certain."""
    problem, state = ended
    state = replace(state, progress=replace(state.progress, stage=FINAL))
    goal, here = objective_of(problem, state, used_modes(problem, state)), unknowns_of(state)
    trial = channel_step(here, goal, goal.free(here), 1e-3)
    sharper = replace(trial, matrix=4 * trial.matrix)
    rise = noise.score(problem, state, goal, sharper) - noise.score(problem, state, goal, trial)
    assert rise == pytest.approx(len(trial.matrix) / 2 * np.log(4), rel=1e-9)
    looser = replace(goal, priors=replace(goal.priors, known_sigma=np.e * goal.priors.known_sigma))
    rise = noise.score(problem, state, looser, trial) - noise.score(problem, state, goal, trial)
    assert rise == pytest.approx(2 * len(KNOWN), rel=1e-9), "so has a prior that expects less"


def test_a_position_that_the_pressures_contradict_holds_nothing(ended):
    problem, state = ended
    wrong = np.arange(len(KNOWN)) == 2
    places = problem.known_positions + np.outer(wrong, [0.3, -0.2])

    def cost(places, contradicted):
        held = replace(state, model=replace(state.model, places=places, contradicted=contradicted))
        return objective_of(problem, held, used_modes(problem, held)).evaluate(unknowns_of(held), False).cost

    none = np.zeros(len(KNOWN), bool)
    assert cost(places, wrong) == cost(problem.known_positions, wrong)
    assert cost(places, none) > cost(problem.known_positions, none) + 5


def test_a_channel_that_is_only_noisy_stays_where_it_is(ended):
    """Its own noise explains it better than any other place or gain; one that is elsewhere moves."""
    problem, state = ended
    share, rng = state.model.noise_fraction, np.random.default_rng(3)
    tau = np.where(np.arange(COUNT) == 7, 60.0, 1.0)
    p = np.array(problem.pressures)
    draws = rng.normal(size=(2, MODES)) * np.sqrt(60 * share / 2)
    p[:, 7] += draws[0] + 1j * draws[1]
    noisy = replace(state, model=replace(state.model, channel_noise=tau))
    assert not channels.relocated(replace(problem, pressures=p), noisy)[1]
    away = np.array(state.positions)
    away[7] += 0.25, -0.3
    found, moved = channels.relocated(problem, replace(noisy, positions=away))
    assert moved and np.linalg.norm(found.positions[7] - state.positions[7]) < 0.1


# Laws of the noise that the likelihood solver assumes, and of what it accepts as the end of its search.


WIDE = np.random.default_rng(7).uniform(-0.5, 0.5, (40, 2)) + [2.61, 2.31]
THREE = [0, 1, 2]
SETTINGS = SolverSettings(name="joint", modes=40)


def last_state(measurement, settings=SETTINGS):
    return list(solvers.run(measurement.problem(), settings, 0))[-1]


@pytest.mark.parametrize(("reported", "restarts"), [(1.25, 1), (0.5, 2)])
def test_a_restart_is_the_last_at_once_only_if_it_leaves_no_more_than_the_reported_noise(reported, restarts):
    """`reported` is the noise power in the measurement over the true one; a doubtful optimum needs another to agree."""
    measurement = measured(WIDE, THREE, snr_db=20, seed=1)
    last = last_state(replace(measurement, noise_power=reported * measurement.noise_power))
    assert last.converged and len(last.optima) == restarts
    if restarts == 1:  # nothing holds the size of a blind array: a stretched one may leave little more than the noise
        blind = measured(WIDE, [], snr_db=20, seed=1)
        assert len(last_state(replace(blind, noise_power=reported * blind.noise_power)).optima) >= 2


def test_a_channel_of_noise_alone_stands_in_the_middle_of_the_others_unless_its_place_is_given():
    problem = measured(WIDE, THREE, snr_db=40, seed=2).problem()
    away = WIDE + 9.0 * np.isin(np.arange(len(WIDE)), [1, 5])[:, None]
    state = load("robust").init(problem, replace(SETTINGS, name="robust"), 0, away)
    loud = np.where(np.isin(np.arange(len(WIDE)), [1, 5]), 1e6, 1.0)
    state = replace(state, positions=away, model=replace(state.model, noise_fraction=1e-4, channel_noise=loud))
    placed = with_silent_inside(problem, state).positions
    np.testing.assert_allclose(placed[5], np.delete(WIDE, [1, 5], axis=0).mean(axis=0))
    others = np.arange(len(WIDE)) != 5
    np.testing.assert_array_equal(placed[others], away[others])


# What follows a stage, and when restarts agree.


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
