"""Laws of what is estimated beside the positions: noise, power, evidence, faulty channels, and what a result holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fields import measured

from fdcal import solvers
from fdcal.model.settings import SolverSettings
from fdcal.solvers.robust import noise, outliers, result
from fdcal.solvers.robust.objective import (
    channel_step,
    in_unit_power,
    objective_of,
    unknowns_of,
    used_modes,
)
from fdcal.solvers.robust.state import FINAL

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


def test_noise_that_is_assumed_lower_is_given_back_in_the_result(ended):
    problem, state = ended
    state = replace(state, settings=replace(state.settings, noise="auto"))
    one, third = (noise.with_noise(problem, state, deflation, rough=False).model for deflation in (1.0, 3.0))
    np.testing.assert_allclose(3 * third.noise, one.noise, rtol=1e-12)
    assert (one.deflation, third.deflation) == (1.0, 3.0)
    found, same = (result.result(problem, replace(state, model=model)) for model in (one, third))
    np.testing.assert_allclose(same.field.noise, found.field.noise, rtol=1e-12)
    np.testing.assert_allclose(same.spread.newton, found.spread.newton, rtol=1e-9, atol=1e-15)


def test_the_covariance_does_not_rest_on_a_field_as_isotropic_as_assumed(ended, monkeypatch):
    problem, state = ended
    assert not state.model.conditional
    weaker = result.result(problem, state).spread.newton
    monkeypatch.setattr(result, "WEAKER_FIELD", 1.0)
    assert np.trace(weaker) > 1.02 * np.trace(result.result(problem, state).spread.newton)


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
    share, rng = state.model.share, np.random.default_rng(3)
    tau = np.where(np.arange(COUNT) == 7, 60.0, 1.0)
    p = np.array(problem.pressures)
    draws = rng.normal(size=(2, MODES)) * np.sqrt(60 * share / 2)
    p[:, 7] += draws[0] + 1j * draws[1]
    noisy = replace(state, model=replace(state.model, channel_noise=tau))
    assert not outliers.relocated(replace(problem, pressures=p), noisy)[1]
    away = np.array(state.positions)
    away[7] += 0.25, -0.3
    found, moved = outliers.relocated(problem, replace(noisy, positions=away))
    assert moved and np.linalg.norm(found.positions[7] - state.positions[7]) < 0.1
