"""Laws of the error ellipses."""

import numpy as np
import pytest
from fields import measured

from fdcal.assessment.error_ellipses import ellipse_axes, one_sigma
from fdcal.assessment.uncertainty import (
    GROUP_SIZE,
    Information,
    grouped_gradients,
    information,
    model_covariance,
    observable_moves,
    robust_covariance,
    scale_sigma,
    step_along,
)
from fdcal.cost.likelihood import DiffuseField, diffuse_field, kernel
from fdcal.model.gauge import align, rigid_motions
from fdcal.solvers.levenberg_marquardt import DAMPING
from fdcal.solvers.position_fit import position_step

TRUTH = np.random.default_rng(5).uniform(-0.5, 0.5, (9, 2)) + [2.6, 2.3]
KNOWN = np.array([0, 4, 7])
NONE = np.zeros(0, int)
K = np.linspace(0.5, 4.2, 16)
NOISE = 1e-3


def settle(p, field, known, start=TRUTH):
    x, damping, basis = start, DAMPING.first, observable_moves(TRUTH, known)
    for _ in range(8):
        trial = position_step(x, p, field, basis, damping)
        x, damping = trial.unknowns, trial.damping
        if trial.moved < 3e-4:
            break
    return x


def diffuse(rng, noise=NOISE):
    """Pressures of a diffuse field in noise : (16, 9) complex128, and what is known of it."""
    apart = np.linalg.norm(TRUTH[:, None] - TRUTH[None], axis=-1)
    G = np.linalg.cholesky(kernel(K[:, None, None] * apart, 2) + noise * np.eye(len(TRUTH)))
    draws = rng.standard_normal((2, len(K), len(TRUTH), 1)) * np.sqrt(0.5)
    field = DiffuseField(K, np.ones(len(K)), np.full(len(K), noise), 2)
    return (G @ (draws[0] + 1j * draws[1]))[..., 0], field


@pytest.mark.parametrize("known", [KNOWN, NONE], ids=["known", "blind"])
def test_95_percent_ellipses_cover_95_percent_of_200_draws(known):
    """The array as a whole: its Mahalanobis distance squared is chi-squared, of mean F, for every draw."""
    rng = np.random.default_rng(1)
    modelled, robust = [], []
    for _ in range(200):
        p, field = diffuse(rng)
        x = settle(p, field, known)
        found = information(x, p, field, known)
        error = (x if len(known) else align(x, TRUTH)) - TRUTH
        free = np.setdiff1d(np.arange(len(TRUTH)), known)
        for kept, blocks in ((modelled, model_covariance(found)), (robust, robust_covariance(found))):
            along = np.linalg.solve(blocks[free], error[free][..., None])[..., 0]
            kept.append(np.mean(np.sum(error[free] * along, axis=1) < -2 * np.log(0.05)))
    for kept in (modelled, robust):
        sampling = np.std(kept) / np.sqrt(len(kept))
        assert 0.95 - 3 * sampling - 0.015 < np.mean(kept) < 0.95 + 3 * sampling + 0.015


def test_standing_waves_of_a_room_enlarge_the_ellipses():
    """They are not as diffuse as assumed; the curvature alone would promise several times too much."""
    plain, robust, error = [], [], []
    for seed in range(8):
        problem = measured(TRUTH, KNOWN, highest=230, snr_db=40, seed=seed, source=(5.6 - 0.2 * seed, 4.5)).problem()
        p = problem.pressures
        field = diffuse_field(p, problem.wavenumbers, problem.noise_power, 2)
        x = settle(p, field, KNOWN)
        found = information(x, p, field, KNOWN)
        plain.append(np.mean(one_sigma(model_covariance(found)) ** 2))
        robust.append(np.mean(one_sigma(robust_covariance(found)) ** 2))
        error.append(np.mean(np.sum((x - TRUTH) ** 2, axis=1)))
    plain, robust, error = (np.sqrt(np.mean(values)) for values in (plain, robust, error))
    assert error > 2 * plain
    assert error / 2.5 < robust < 2.5 * error


def test_moves_leave_the_gauge_and_the_known_microphones_alone():
    for known, count in ((NONE, 18 - 3), (KNOWN[:1], 16 - 1), (KNOWN[:2], 14), (KNOWN, 12)):
        basis = observable_moves(TRUTH, known)
        assert basis.shape == (18, count)
        np.testing.assert_allclose(basis.T @ basis, np.eye(count), atol=1e-12)
        assert not basis.reshape(9, 2, count)[known].any()
    np.testing.assert_allclose(observable_moves(TRUTH, NONE).T @ rigid_motions(TRUTH), 0, atol=1e-12)
    space = np.random.default_rng(0).normal(size=(9, 3))
    assert observable_moves(space, NONE).shape == (27, 21)
    assert observable_moves(space, np.array([0])).shape == (27, 21)


def test_known_microphones_have_no_uncertainty_and_noise_adds_to_it():
    p, field = diffuse(np.random.default_rng(0))
    blocks = model_covariance(information(TRUTH, p, field, KNOWN))
    assert not one_sigma(blocks)[KNOWN].any() and np.all(one_sigma(blocks)[1:4] > 0)
    noisier = diffuse_field(p, K, 100 * field.noise, 2)
    assert np.all(one_sigma(model_covariance(information(TRUTH, p, noisier, KNOWN)))[1:4] > one_sigma(blocks)[1:4])


def test_ellipse_axes_are_those_of_the_covariance():
    blocks = np.array([[[4.0, 0.0], [0.0, 9.0]], [[2.0, 1.0], [1.0, 2.0]]])
    axes = ellipse_axes(blocks, factor=2.0)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=2), [[4, 6], [2, 2 * np.sqrt(3)]])
    np.testing.assert_allclose(np.einsum("nka,nkb->nab", axes, axes) / 4, blocks, atol=1e-12)


def test_a_wrong_scale_of_the_known_microphones_is_found():
    """`step_along` a direction in which the truth lies 2 % away finds those 2 %."""
    p, field = diffuse(np.random.default_rng(3), 1e-5)
    centre = TRUTH[KNOWN].mean(axis=0)
    wrong = TRUTH.copy()
    wrong[KNOWN] = centre + 0.98 * (TRUTH[KNOWN] - centre)
    x = settle(p, field, KNOWN, wrong)
    found = information(x, p, field, KNOWN)
    along = np.zeros_like(x)
    along[KNOWN] = x[KNOWN] - centre
    step, variance = step_along(found, along.reshape(-1, 1))
    assert abs(step[0] - 1 / 0.98 + 1) < 3 * np.sqrt(variance[0, 0]) < 0.03
    assert 0 < scale_sigma(information(TRUTH, p, field, NONE), TRUTH) < 0.05


def test_the_small_sample_correction_makes_the_scatter_about_the_mean_unbiased():
    """Gradients sum to zero at the solution; their squares must still estimate the variance of one gradient."""
    rng, modes = np.random.default_rng(2), 4
    drawn = rng.normal(size=(4000, modes, 3))
    centred = drawn - drawn.mean(axis=1, keepdims=True)
    unit = np.eye(3)
    influences = [Information(unit, unit, unit, gradients, (1, 3)).influences[0] for gradients in centred]
    assert np.mean(np.square(influences)) == pytest.approx(1.0, rel=0.03)


def test_neighbouring_modes_that_err_alike_count_as_one():
    rng = np.random.default_rng(0)
    shape, modes = (6, 2), 240
    alone = rng.normal(size=(modes, 12))
    alike = np.repeat(rng.normal(size=(modes // GROUP_SIZE, 12)), GROUP_SIZE, axis=0)
    basis = np.eye(12)
    size = {}
    for name, slopes in (("alone", alone), ("alike", alike)):
        blocks = robust_covariance(Information(basis, np.eye(12) / modes, modes * np.eye(12), slopes, shape))
        size[name] = np.trace(blocks, axis1=1, axis2=2).mean()
    assert size["alone"] == pytest.approx(2 / modes, rel=0.4)
    assert size["alike"] == pytest.approx(2 * GROUP_SIZE / modes, rel=0.4)
    assert len(grouped_gradients(np.ones((57, 3)))) == 57 // GROUP_SIZE
    assert np.allclose(grouped_gradients(alone).sum(axis=0), alone.sum(axis=0))
    assert len(grouped_gradients(np.ones((5, 3)))) == 5, "few modes stand alone"


@pytest.mark.parametrize("modes", [3, 5])
def test_the_disagreement_of_few_modes_is_estimated_without_bias(modes):
    """The gradients sum to zero at the solution, which takes a share 1 / modes off their squares; it is put back."""
    rng, sigma, found = np.random.default_rng(1), 10.0, []  # far more than the model's own covariance
    for _ in range(400):
        gradients = sigma * rng.normal(size=(modes, 12))
        gradients -= gradients.mean(axis=0)
        inverse, H = np.eye(12) / modes, modes * np.eye(12)
        found.append(robust_covariance(Information(np.eye(12), inverse, H, gradients, (6, 2))))
    size = np.trace(np.mean(found, axis=0), axis1=1, axis2=2).mean()
    assert size == pytest.approx(2 * sigma**2 / modes, rel=0.06)
