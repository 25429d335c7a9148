"""Laws of the Gaussian likelihood."""

import dataclasses

import numpy as np
import pytest
from fields import measured
from scipy.special import spherical_jn

from fdcal.acoustics.sinc import complex_sinc, sinc
from fdcal.cost.leave_one_out import likelihood_landscape, likelihood_landscapes, precision_terms
from fdcal.cost.likelihood import (
    DiffuseField,
    diffuse_field,
    kernel,
    likelihood,
    mode_gradients,
    newton_terms,
    total_cost,
)
from fdcal.cost.noise_model import estimate_noise, estimate_noise_share

TRUTH = np.random.default_rng(3).uniform(-0.5, 0.5, (20, 2)) + [2.61, 2.31]
PROBLEM = measured(TRUTH, [0, 1, 2], highest=200.0, snr_db=30).problem()
RATIO = 1e-3


def field_and_guess(dimension):
    """The room's field for 2-D; for 3-D the pressures do not fit the kernel, which no law below minds."""
    power = np.mean(np.abs(PROBLEM.pressures) ** 2, axis=1)
    field = diffuse_field(PROBLEM.pressures, PROBLEM.wavenumbers, RATIO * power, dimension)
    rng = np.random.default_rng(4)
    guess = np.column_stack([TRUTH, rng.uniform(-0.3, 0.3, len(TRUTH))])[:, :dimension]
    return field, guess + rng.normal(0, 0.03, guess.shape)


def test_the_fast_sine_over_z_and_its_slope_are_the_spherical_bessel_functions():
    z = np.concatenate([[0.0], np.geomspace(1e-9, 1e3, 4001), np.pi / 4 * np.arange(1, 400)])
    value, slope = sinc(z)
    np.testing.assert_allclose(value, spherical_jn(0, z), rtol=0, atol=4e-15)
    np.testing.assert_allclose(slope * z, -spherical_jn(1, z), rtol=0, atol=2e-14)
    assert (value[0], slope[0]) == (1.0, pytest.approx(-1 / 3))
    assert sinc(z[:6].reshape(2, 3))[1].shape == (2, 3)


def test_sine_over_z_of_a_complex_square_does_not_depend_on_the_root():
    size = np.concatenate([np.geomspace(1e-5, 30, 301), np.linspace(0.0199, 0.0201, 21)])
    z = np.multiply.outer(size, np.exp(1j * np.linspace(-np.pi, np.pi, 17))).ravel()
    growth = np.exp(np.abs(z.imag))
    value, slope = complex_sinc(z * z)
    assert np.max(np.abs(value - spherical_jn(0, z)) / growth) < 2e-14
    assert np.max(np.abs(slope * z + spherical_jn(1, z)) / growth) < 1e-12, "SciPy loses digits near 0"
    value, slope = complex_sinc(np.array([0.0, -4.0]))
    assert value == pytest.approx([1.0, np.sinh(2) / 2]), "the square of a damped wave may be negative"
    assert slope == pytest.approx([-1 / 3, -(np.cosh(2) - np.sinh(2) / 2) / 4])


def test_power_of_field_and_noise_add_up_to_the_power_of_the_pressures():
    measured_power = np.mean(np.abs(PROBLEM.pressures) ** 2, axis=1)
    for share in (0.0, 0.1, 0.6):
        field = diffuse_field(PROBLEM.pressures, PROBLEM.wavenumbers, share * measured_power, 2)
        np.testing.assert_allclose(field.power + field.noise, measured_power, rtol=1e-12)
    assert np.all(diffuse_field(PROBLEM.pressures, PROBLEM.wavenumbers, 2 * measured_power, 2).power > 0)


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_cost_of_a_step_is_the_likelihood_of_all_modes(dimension):
    field, guess = field_and_guess(dimension)
    cost = newton_terms(guess, PROBLEM.pressures, field)[0]
    assert cost == pytest.approx(likelihood(guess, PROBLEM.pressures, field).sum(), rel=1e-9)


def draws(ratio, count):
    """Pressures drawn from the model itself, of unit power, `ratio` of it noise, at the true positions."""
    rng = np.random.default_rng(int(100 * ratio))
    distance = np.linalg.norm(TRUTH[:, None] - TRUTH[None], axis=-1)
    C = (1 - ratio) * kernel(PROBLEM.wavenumbers.real[:, None, None] * distance, 2) + ratio * np.eye(len(TRUTH))
    G = np.linalg.cholesky(C)
    for _ in range(count):
        re, im = rng.standard_normal((2, *PROBLEM.pressures.shape, 1)) / np.sqrt(2)
        yield (G @ (re + 1j * im))[..., 0]


def test_curvature_is_the_hessian_in_the_mean():
    ratios, h = [], 1e-5
    for p in draws(RATIO, 4):
        M = len(p)
        field = DiffuseField(PROBLEM.wavenumbers.real, np.full(M, 1 - RATIO), np.full(M, RATIO), 2)
        moves = h * np.eye(40)[::5].reshape(-1, 20, 2)
        slopes = [(newton_terms(TRUTH + d, p, field)[1], newton_terms(TRUTH - d, p, field)[1]) for d in moves]
        hessian = np.array([(there - back).ravel() / (2 * h) for there, back in slopes])
        curvature = newton_terms(TRUTH, p, field)[2].reshape(40, 40)
        ratios.append(np.trace(hessian[:, ::5]) / np.diag(curvature)[::5].sum())
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)


def test_landscape_is_the_likelihood_with_the_microphone_there():
    field, guess = field_and_guess(2)
    candidates = np.random.default_rng(5).uniform(-0.6, 0.6, (9, 2)) + TRUTH.mean(axis=0)
    costs = likelihood_landscape(guess, 6, candidates, PROBLEM.pressures, field)
    assert np.all(costs >= 0)
    for c, candidate in enumerate(candidates):
        moved = guess.copy()
        moved[6] = candidate
        np.testing.assert_allclose(costs[:, c], likelihood(moved, PROBLEM.pressures, field), rtol=1e-8)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_landscape_in_blocks_is_the_same(dimension):
    field, guess = field_and_guess(dimension)
    candidates = guess.mean(axis=0) + np.random.default_rng(5).uniform(-0.5, 0.5, (23, dimension))
    whole = likelihood_landscapes(guess, [1, 6], candidates, PROBLEM.pressures, field)
    parts = likelihood_landscapes(guess, [1, 6], candidates, PROBLEM.pressures, field, block=5 * len(guess))
    assert parts.shape == (len(PROBLEM.pressures), 2, 23)
    np.testing.assert_allclose(parts, whole, rtol=1e-9)


def test_at_infinity_the_projection_cost_falls_and_the_likelihood_does_not():
    """Far away the kernel is the identity and explains anything; the determinant makes that expensive."""
    likely, _ = field_and_guess(2)
    quadratic = dataclasses.replace(likely, log_det=False)
    rough = TRUTH + np.random.default_rng(6).normal(0, 0.02, TRUTH.shape)
    flown = TRUTH.copy()
    flown[4] += 50.0
    for near, far in ((TRUTH, flown), (TRUTH, 100 * TRUTH), (rough, 100 * rough)):
        assert total_cost(far, PROBLEM.pressures, quadratic) < total_cost(near, PROBLEM.pressures, quadratic)
        assert total_cost(far, PROBLEM.pressures, likely) > total_cost(near, PROBLEM.pressures, likely) + 100


@pytest.mark.parametrize("ratio", [1e-1, 1e-2, 1e-3])
def test_the_noise_is_recovered_at_the_true_positions(ratio):
    """Each mode has the same share of noise, whatever power its field was drawn with."""
    found = []
    for field, noise in zip(draws(1e-9, 10), draws(1.0, 10), strict=True):
        field = field / np.sqrt(np.mean(np.abs(field) ** 2, axis=1, keepdims=True))
        p = np.sqrt(1 - ratio) * field + np.sqrt(ratio) * noise
        found.append(estimate_noise_share(TRUTH, p, PROBLEM.wavenumbers, 2))
    assert np.mean(found) == pytest.approx(ratio, rel=0.15)


@pytest.mark.parametrize("spread", [0.015, 0.03])
def test_position_errors_are_distinguished_from_noise(spread):
    """Errors of the positions count the more the higher the mode, noise does not."""
    rng, found = np.random.default_rng(0), []
    for p in draws(1e-4, 6):
        rest = estimate_noise(TRUTH + rng.normal(0, spread, TRUTH.shape), p, PROBLEM.wavenumbers, 2)
        found.append((rest.spread, rest.noise))
    spreads, noises = np.mean(found, axis=0)
    assert spreads == pytest.approx(spread * np.sqrt(2), rel=0.3)  # of both coordinates together
    assert noises < 5e-3


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_gradients_of_all_modes_add_up_to_the_gradient(dimension):
    field, guess = field_and_guess(dimension)
    gradient = newton_terms(guess, PROBLEM.pressures, field)[1]
    each = mode_gradients(guess, PROBLEM.pressures, field)
    np.testing.assert_allclose(each.sum(axis=0), gradient, rtol=1e-9, atol=1e-9 * np.abs(gradient).max())


@pytest.mark.parametrize("dimension", [2, 3])
def test_precision_terms_are_those_of_the_explicit_covariance(dimension):
    field, guess = field_and_guess(dimension)
    distance = np.linalg.norm(guess[:, None] - guess[None], axis=-1)
    u, d = precision_terms(guess, PROBLEM.pressures, field)
    for m, p in enumerate(PROBLEM.pressures):
        C = field.power[m] * kernel(field.wavenumbers[m] * distance, dimension) + field.noise[m] * np.eye(len(guess))
        np.testing.assert_allclose(C @ u[m], p, rtol=1e-8, atol=1e-8 * np.abs(p).max())
        np.testing.assert_allclose(d[m], np.diag(np.linalg.inv(C)), rtol=1e-7)


def test_positions_that_are_not_a_number_are_refused():
    assert np.isnan(sinc(np.array([np.nan, 1.0]))[0][0])
    field, guess = field_and_guess(3)
    guess[4] = np.nan
    with pytest.raises(np.linalg.LinAlgError):
        total_cost(guess, PROBLEM.pressures, field)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9])
def test_power_of_the_field_and_of_the_noise_add_up_to_that_of_the_pressures(dimension, share):
    power = np.mean(np.abs(PROBLEM.pressures) ** 2, axis=1)
    field = diffuse_field(PROBLEM.pressures, PROBLEM.wavenumbers, share * power, dimension)
    np.testing.assert_allclose(field.power + field.noise, power, rtol=1e-12)


def test_pressures_of_pure_noise_still_have_a_field_of_little_power():
    power = np.mean(np.abs(PROBLEM.pressures) ** 2, axis=1)
    field = diffuse_field(PROBLEM.pressures, PROBLEM.wavenumbers, 2 * power, 2)
    assert np.all((field.power > 0) & (field.power < 0.01 * power))
