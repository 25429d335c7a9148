"""Laws of the noise that the likelihood solver assumes, and of what it accepts as the end of its search."""

from dataclasses import replace

import numpy as np
import pytest
from fields import measured

from fdcal import solvers
from fdcal.cost.likelihood import isotropic_field, likelihood_terms
from fdcal.model.gauge import align, position_errors
from fdcal.model.settings import SolverSettings
from fdcal.solvers import load
from fdcal.solvers.robust.noise import with_silent_inside

TRUTH = np.random.default_rng(7).uniform(-0.5, 0.5, (40, 2)) + [2.61, 2.31]
KNOWN = [0, 1, 2]
SETTINGS = SolverSettings(name="joint", modes=40)


def last_state(measurement, settings=SETTINGS):
    return list(solvers.run(measurement.problem(), settings, 0))[-1]


def cramer_rao_bound(measurement, modes):
    """RMS position error over all microphones, metres, that no unbiased estimate of positions and field undercuts."""
    p = measurement.pressures[:modes]
    power = np.mean(np.abs(p) ** 2, axis=1)
    field = isotropic_field(p, measurement.wavenumbers[:modes].real, measurement.noise_power[:modes], 2)
    field = replace(field, power=1000 * power)  # the coefficients of the field are as good as unknown
    H = likelihood_terms(measurement.positions, p, field).newton()[1]
    free = np.setdiff1d(np.arange(len(TRUTH)), measurement.known)
    values = np.linalg.eigvalsh(H[free][:, :, free].reshape(2 * len(free), -1))
    if not len(measurement.known):
        values = values[3:]  # translation and rotation
    return np.sqrt(np.sum(1 / values) / len(TRUTH))


@pytest.mark.parametrize("known", [KNOWN, []], ids=["known", "blind"])
def test_the_isotropic_prior_does_not_bias_the_positions_in_a_room(known):
    """A room's field is not isotropic. At 30 dB the noise is assumed smaller than it is, or the prior would pull."""
    errors, bounds = [], []
    for seed in range(3):
        measurement = measured(TRUTH, known, snr_db=30, seed=seed)
        found = last_state(measurement).positions
        found = found if known else align(found, TRUTH)
        errors.append(np.mean(position_errors(found, TRUTH) ** 2))
        bounds.append(cramer_rao_bound(measurement, 40) ** 2)
    assert np.mean(errors) < 1.1**2 * np.mean(bounds)


@pytest.mark.parametrize(("reported", "restarts"), [(1.25, 1), (0.5, 2)])
def test_a_restart_is_the_last_at_once_only_if_it_leaves_no_more_than_the_reported_noise(reported, restarts):
    """`reported` is the noise power in the measurement over the true one; a doubtful optimum needs another to agree."""
    measurement = measured(TRUTH, KNOWN, snr_db=20, seed=1)
    last = last_state(replace(measurement, noise_power=reported * measurement.noise_power))
    assert last.converged and len(last.optima) == restarts


def test_without_given_positions_one_restart_under_noise_is_never_enough():
    """Nothing holds the size of a blind array: a stretched one may leave little more than the noise."""
    measurement = measured(TRUTH, [], snr_db=20, seed=1)
    last = last_state(replace(measurement, noise_power=1.25 * measurement.noise_power))
    assert len(last.optima) >= 2


def test_a_channel_of_noise_alone_stands_in_the_middle_of_the_others_unless_its_place_is_given():
    problem = measured(TRUTH, KNOWN, snr_db=40, seed=2).problem()
    away = TRUTH + 9.0 * np.isin(np.arange(len(TRUTH)), [1, 5])[:, None]
    state = load("robust").init(problem, replace(SETTINGS, name="robust"), 0, away)
    loud = np.where(np.isin(np.arange(len(TRUTH)), [1, 5]), 1e6, 1.0)
    state = replace(state, positions=away, model=replace(state.model, share=1e-4, channel_noise=loud))
    placed = with_silent_inside(problem, state).positions
    np.testing.assert_allclose(placed[5], np.delete(TRUTH, [1, 5], axis=0).mean(axis=0))
    others = np.arange(len(TRUTH)) != 5
    np.testing.assert_array_equal(placed[others], away[others])
