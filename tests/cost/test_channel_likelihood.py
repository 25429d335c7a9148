"""The likelihood with channel gains: derivatives, invariances, the likelihood of positions alone."""

from dataclasses import replace

import numpy as np
import pytest

from fdcal.cost.angular_prior import diffuse_prior, learned_prior, plane_wave_kernel
from fdcal.cost.channel_field import Conditional
from fdcal.cost.channel_kernels import series_kernel
from fdcal.cost.channel_likelihood import ChannelField, channel_terms, log_response
from fdcal.cost.likelihood import diffuse_field, newton_terms
from fdcal.cost.wave_directions import wave_directions

K = np.array([1.5, 2.5, 4.0])  # rad/m
SHARE = 1e-2  # of noise in the power


def drawn(dimension, damped=False, count=9, seed=0):
    """Positions (N, D), pressures of a diffuse field (M, N), and what is assumed of it."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-0.4, 0.4, (count, dimension))
    directions = rng.normal(size=(60, dimension))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    amplitudes = rng.normal(size=(2, len(K), 60)) / np.sqrt(120)
    waves = np.exp(1j * K[:, None, None] * (x @ directions.T))
    noise = np.sqrt(SHARE / 2) * rng.normal(size=(2, len(K), count))
    p = np.einsum("mnw,mw->mn", waves, amplitudes[0] + 1j * amplitudes[1]) + noise[0] + 1j * noise[1]
    k = K - 0.02j if damped else K
    ones = np.ones(len(K))
    return x, p, ChannelField(k, ones, SHARE * ones, np.ones(count), dimension, about=x.copy() if damped else None)


def lopsided(field, x):
    """`field` with a power that depends on the direction."""
    about = x if field.about is None else field.about
    directions = np.random.default_rng(3).uniform(0.1, 2.0, diffuse_prior(x, field.wavenumbers, field.dimension).shape)
    return replace(field, directions=directions, about=about)


def conditional(field, gains, damped=False):
    """`field` with a conditional likelihood, whose noise is that behind other gains than `gains`."""
    return replace(field, conditional=Conditional(50.0, 0.1, bool(damped), log_response(gains, K)[0] + 0.05))


@pytest.mark.parametrize("conditioned", [False, True])
@pytest.mark.parametrize(
    ("dimension", "damped", "directed"),
    [(2, 0, 0), (2, 1, 0), (3, 0, 0), (3, 1, 0), (2, 0, 1), (2, 1, 1), (3, 0, 1), (3, 1, 1)],
)
def test_gradient_is_that_of_finite_differences(dimension, damped, directed, conditioned):
    x, p, field = drawn(dimension, damped)
    field = lopsided(field, x) if directed else field
    field = conditional(field, np.zeros((len(x), 4)), damped) if conditioned else field
    rng = np.random.default_rng(1)
    gains = 0.1 * rng.normal(size=(len(x), 4))
    gradient, _ = channel_terms(x, gains, p, field).newton()
    direction = rng.normal(size=gradient.shape)
    h = 1e-5

    def cost(step):
        moved = step * h * direction
        return channel_terms(x + moved[:, :dimension], gains + moved[:, dimension:], p, field, 0).cost

    slope = (cost(1) - cost(-1)) / (2 * h)
    assert slope == pytest.approx(np.sum(gradient * direction), rel=1e-5)


@pytest.mark.parametrize("dimension", [2, 3])
def test_without_gains_it_is_the_likelihood_of_the_positions(dimension):
    x, p, field = drawn(dimension)
    plain = diffuse_field(p, K, SHARE * np.ones(len(K)), dimension)
    same = ChannelField(K, plain.power, plain.noise, field.channel_noise, dimension)
    cost, gradient, curvature = newton_terms(x, p, plain)
    terms = channel_terms(x, np.zeros((len(x), 2)), p, same)
    found, matrix = terms.newton()
    np.testing.assert_allclose(found[:, :dimension], gradient, atol=1e-7 * np.abs(gradient).max())
    np.testing.assert_allclose(matrix[:, :dimension, :, :dimension], curvature, atol=1e-7 * np.abs(curvature).max())
    there = np.array(x) + 1e-3
    moved = newton_terms(there, p, plain)[0] - cost
    assert channel_terms(there, np.zeros((len(x), 2)), p, same, 0).cost - terms.cost == pytest.approx(moved, abs=1e-6)


def test_gains_multiplied_into_the_pressures_cost_only_their_jacobian():
    x, p, field = drawn(2)
    gains = 0.3 * np.random.default_rng(2).normal(size=(len(x), 2))
    plain = channel_terms(x, np.zeros_like(gains), p, field, 0).cost
    turned = channel_terms(x, gains, p * np.exp(gains[:, 0] + 1j * gains[:, 1]), field, 0).cost
    assert turned == pytest.approx(plain + 2 * len(K) * gains[:, 0].sum())


def test_a_delay_and_a_high_pass_are_what_they_do_to_a_signal():
    d, corner = 0.34, 0.8  # metres and rad/m
    filtered = np.exp(log_response(np.array([[0, 0, d, 0], [0, 0, 0, corner], [0, 0, 0, -corner]]), K)[0])
    high_pass = 1j * K / (corner + 1j * K)
    expected = np.column_stack([np.exp(-1j * K * d), high_pass, 1 / high_pass])
    np.testing.assert_allclose(filtered, expected, rtol=1e-12)


def test_a_channel_of_pure_noise_pulls_on_no_other_microphone():
    x, p, field = drawn(2)
    others = np.arange(1, len(x))
    loud = np.where(np.arange(len(x)) == 0, 1e9, 1.0)
    noisy = ChannelField(field.wavenumbers, field.power, field.noise, loud, 2)
    without = ChannelField(field.wavenumbers, field.power, field.noise, np.ones(len(others)), 2)
    gains = np.zeros((len(x), 2))
    whole, _ = channel_terms(x, gains, p, noisy).newton()
    rest, _ = channel_terms(x[others], gains[others], p[:, others], without).newton()
    np.testing.assert_allclose(whole[others], rest, atol=1e-5 * np.abs(rest).max())


@pytest.mark.parametrize("damping", [0.0, 0.05])
def test_waves_of_equal_power_from_everywhere_are_a_diffuse_field(damping):
    x = drawn(2)[0]
    k = K - 1j * damping
    about = x - [0.3e-3, 0.2e-3]
    K1, D1 = series_kernel(x, about, k, 2, False)
    K2, D2 = plane_wave_kernel(x, about, k, np.ones((len(k), 40)))
    np.testing.assert_allclose(K2, K1, atol=1e-4 if damping else 1e-9)  # the series' centre is a little beside the mean
    np.testing.assert_allclose(D2, D1, atol=1e-3 if damping else 1e-8)


@pytest.mark.parametrize("damping", [0.0, 0.05])
def test_waves_of_equal_power_from_the_whole_sphere_are_a_diffuse_field_in_space(damping):
    x, k = drawn(3)[0], K - 1j * damping
    about = x - [0.3e-3, 0.2e-3, 0.3e-3]
    K1, D1 = series_kernel(x, about, k, 3, False)
    K2, D2 = plane_wave_kernel(x, about, k, diffuse_prior(x, k, 3), dimension=3)
    np.testing.assert_allclose(K2, K1, atol=1e-4 if damping else 1e-9)
    np.testing.assert_allclose(D2, D1, atol=1e-3 if damping else 1e-7)


def test_learning_the_directions_in_space_raises_the_likelihood_and_finds_a_wave():
    x, _, field = drawn(3, count=14)
    towards = np.array([0.6, -0.48, 0.64])
    p = np.exp(-1j * K[:, None] * (x @ towards))
    prior, costs = diffuse_prior(x, K, 3), []
    assert prior.shape[1] > len(x)
    for _ in range(6):
        costs.append(channel_terms(x, np.zeros((14, 2)), p, replace(field, directions=prior), 0).cost)
        prior = learned_prior(x, p, K, field.power, field.noise, prior, 1, field.channel_noise, dimension=3)
    assert np.all(np.diff(costs) < 0)
    found = wave_directions(3, prior.shape[1])[0][:, np.argmax(prior, axis=1)]
    assert np.all(towards @ found > 0.9)


def test_learning_the_directions_raises_the_likelihood_and_finds_a_wave():
    x, _, field = drawn(2, count=14)
    field = replace(field, channel_noise=np.linspace(0.5, 3.0, 14))
    angle = 0.7
    p = np.exp(-1j * K[:, None] * (x @ [np.cos(angle), np.sin(angle)]))
    prior, costs = diffuse_prior(x, K), []
    for _ in range(6):
        costs.append(channel_terms(x, np.zeros((14, 2)), p, replace(field, directions=prior), 0).cost)
        prior = learned_prior(x, p, K, field.power, field.noise, prior, 1, field.channel_noise)
    assert np.all(np.diff(costs) < 0)
    found = 2 * np.pi / prior.shape[1] * np.argmax(prior, axis=1)
    assert np.all(np.abs(found - angle) < np.pi / prior.shape[1] + 0.3)
