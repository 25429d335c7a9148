"""What is estimated and assumed beside the positions: noise, power, evidence, faulty channels."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fields import measured, waves
from solving import run_from

from fdcal import solvers
from fdcal.model.gauge import rigid_motions
from fdcal.model.measurement import Measurement
from fdcal.model.settings import SolverSettings
from fdcal.solvers import load
from fdcal.solvers.robust import channels, noise, objective, result, spread
from fdcal.solvers.robust import objective as objectives
from fdcal.solvers.robust.noise import with_silent_inside
from fdcal.solvers.robust.objective import channel_step, in_unit_power, objective_of, unknowns_of, used_modes
from fdcal.solvers.robust.schedule import StageEnd, after_stage, likeliest, next_restart
from fdcal.solvers.robust.state import FINAL, SEARCH, STAGES, FittedStart, LocalOptimum

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


def test_the_uncertainty_of_a_dead_channel_is_not_that_of_the_array():
    problem, x = measured(TRUTH, [], snr_db=26, modes=10).problem(), TRUTH[:6]
    healthy = np.repeat(np.arange(6) != 2, 2)
    gauge = spread._gauge(replace(problem, frame=None), x, healthy)
    assert np.abs(gauge @ rigid_motions(x)).max() < 1e-9, "no rigid motion is left"
    assert np.abs((gauge @ np.diag(np.where(healthy, 0.0, 1.0)) @ gauge.T)[healthy]).max() < 1e-9


def test_a_gain_that_all_channels_share_goes_to_the_field_and_changes_no_likelihood(ended):
    problem, state = ended
    louder = replace(state, gains=state.gains + [0.3, -0.2])
    centred = noise.centred(louder)
    np.testing.assert_allclose(np.median(centred.gains - centred.offsets, axis=0), 0, atol=1e-12)
    assert likelihood(problem, centred) == pytest.approx(likelihood(problem, louder), rel=1e-10)


def test_the_covariance_assumes_a_less_isotropic_field_than_the_cost(ended, monkeypatch):
    problem, state = ended
    weaker = result(problem, state).spread.newton
    monkeypatch.setattr(objective, "FIELD_POWER_FACTOR", 1.0)
    assert np.trace(weaker) > 1.02 * np.trace(result(problem, state).spread.newton)


def test_the_less_determined_of_two_optima_with_equal_cost_has_more_evidence(ended):
    """Laplace: evidence falls by half the log determinant, by half log 4 for each unknown that is twice as certain."""
    problem, state = ended
    state = replace(state, progress=replace(state.progress, stage=FINAL))
    goal, here = objective_of(problem, state, used_modes(problem, state)), unknowns_of(state)
    trial = channel_step(here, goal, goal.free(here), 1e-3)
    sharper = replace(trial, matrix=4 * trial.matrix)
    rise = noise.score(problem, state, goal, sharper) - noise.score(problem, state, goal, trial)
    assert rise == pytest.approx(len(trial.matrix) / 2 * np.log(4), rel=1e-9)
    looser = replace(goal, priors=replace(goal.priors, known_sigma=np.e * goal.priors.known_sigma))
    rise = noise.score(problem, state, looser, trial) - noise.score(problem, state, goal, trial)
    assert rise == pytest.approx(2 * len(KNOWN), rel=1e-9), "a wider prior lowers the evidence, too"


@pytest.mark.parametrize(("name", "limit"), [("robust", 3e8), ("robust", 0.0), ("joint", 3e8)])
def test_the_power_in_space_depends_on_the_direction_unless_that_takes_too_long(monkeypatch, name, limit):
    x, k = np.random.default_rng(0).normal(0, 0.3, (20, 3)), np.linspace(1, 6, 12)
    problem = Measurement(k * 343 / (2 * np.pi), waves(x, k), 343.0, dimension=3).problem()
    monkeypatch.setattr(noise, "MAX_DIRECTION_PRODUCTS", limit)
    state = solvers.load(name).init(problem, SolverSettings(name=name, modes=12), 0, x)
    assert noise.with_last_field(problem, state).model.directional == (name == "robust" and limit > 0)


def test_a_position_that_the_pressures_contradict_constrains_nothing(ended):
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
    """Its noise explains it better than another place or gain; a channel whose microphone is elsewhere moves."""
    problem, state = ended
    share, rng = state.model.noise_fraction, np.random.default_rng(3)
    tau, p = np.where(np.arange(COUNT) == 7, 60.0, 1.0), np.array(problem.pressures)
    draws = rng.normal(size=(2, MODES)) * np.sqrt(60 * share / 2)
    p[:, 7] += draws[0] + 1j * draws[1]
    noisy = replace(state, model=replace(state.model, channel_noise=tau))
    assert not channels.relocated(replace(problem, pressures=p), noisy)[1]
    away = np.array(state.positions)
    away[7] += 0.25, -0.3
    found, moved = channels.relocated(problem, replace(noisy, positions=away))
    assert moved and np.linalg.norm(found.positions[7] - state.positions[7]) < 0.1


@pytest.mark.parametrize("direction", [(1.0, 0.0), (0.6, -0.8)])
def test_a_local_search_reaches_a_third_of_the_shortest_wavelength(ended, direction):
    problem, state = ended
    used = used_modes(problem, state, channels.SEARCH_MODES)
    wavelength = 2 * np.pi / problem.wavenumbers[used].real.max()
    tau, away = np.where(np.arange(COUNT) == 7, 60.0, 1.0), np.array(state.positions)
    away[7] += wavelength / 3 * np.array(direction)
    suspicious = replace(state, positions=away, model=replace(state.model, channel_noise=tau))
    found, moved = channels.relocated(problem, suspicious, local=True)
    assert moved and np.linalg.norm(found.positions[7] - state.positions[7]) < wavelength / 8


def test_a_channel_of_noise_alone_stands_in_the_middle_of_the_others_unless_its_place_is_given():
    silent = np.isin(np.arange(COUNT), [1, 5])
    problem, away = measured(TRUTH, [0, 1, 2], snr_db=40, seed=2).problem(), TRUTH + 9.0 * silent[:, None]
    state = load("robust").init(problem, SolverSettings(name="robust", modes=MODES), 0, away)
    noisy = np.where(silent, 1e6, 1.0), np.zeros((COUNT, 2))
    # These channels have no noise, but are 60 dB below the others.
    dead = np.ones(COUNT), np.where(silent[:, None], [-6.9, 0.0], 0.0)
    for channel_noise, gains in (noisy, dead):
        model = replace(state.model, noise_fraction=1e-4, channel_noise=channel_noise)
        placed = with_silent_inside(problem, replace(state, positions=away, gains=gains, model=model))
        np.testing.assert_allclose(placed.positions[5], np.delete(TRUTH, [1, 5], axis=0).mean(axis=0))
        np.testing.assert_array_equal(np.delete(placed.positions, 5, axis=0), np.delete(away, 5, axis=0))
        assert placed.model.channel_noise[5] >= 1e4, "all of its power is noise"


# After each stage or restart, the solver decides what follows.


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


def test_the_last_stage_goes_on_from_the_likeliest_optimum(run):
    problem, states = run
    worse = optimum(states[-1], 0.05, 50.0)
    for optima in ((worse, likeliest(states[-1])), (likeliest(states[-1]), worse)):
        begun = next_restart(problem, replace(states[-1], starts=(), optima=optima, finished=False))
        np.testing.assert_allclose(begun.positions, likeliest(states[-1]).positions, atol=1e-12)
        assert STAGES[begun.progress.stage].name == "final"
        running = replace(states[-1], optima=optima, finished=False, progress=states[0].progress)
        assert running.best_positions is likeliest(states[-1]).positions, "while another restart runs"


def test_each_likely_start_is_refined_and_then_the_likeliest_result(run):
    problem, states = run
    best = likeliest(states[-1])
    elsewhere = best.positions + np.random.default_rng(0).normal(0, 0.3, best.positions.shape)
    plan = tuple(FittedStart(x, np.ones(COUNT, bool), 0.0, hits=1) for x in (elsewhere, best.positions))
    following = next_restart(problem, replace(states[-1], starts=plan, optima=()))
    np.testing.assert_array_equal(following.positions, elsewhere)
    assert following.starts is not None and len(following.starts) == 1
    assert next_restart(problem, replace(following, starts=(), optima=(best,))).progress.stage == FINAL


@pytest.mark.parametrize("stage", range(SEARCH + 1, len(STAGES)))
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
