"""The noise that the likelihood estimates, and the directions of the field that it learns."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from fdcal.cost import noise as estimates
from fdcal.cost.kernels import diffuse_matrices, directions_needed, plane_waves, wave_directions
from fdcal.cost.likelihood import FieldModel, likelihood_terms

TRUTH = np.random.default_rng(3).uniform(-0.5, 0.5, (20, 2))
K = np.linspace(0.5, 4.5, 40)  # rad/m
M, N = len(K), len(TRUTH)
ONES = np.ones(M)


def draws(ratio, count, power=ONES, tau=np.ones(N), seed=0):  # noqa: B008
    """Yield pressures of a diffuse field at the true positions, `ratio` of the mean power noise."""
    rng = np.random.default_rng(seed)
    C = (1 - ratio) * power[:, None, None] * diffuse_matrices(TRUTH, K, 2, False)[0] + ratio * np.diag(tau)
    G = np.linalg.cholesky(C)
    for _ in range(count):
        re, im = rng.standard_normal((2, M, N, 1)) / np.sqrt(2)
        yield (G @ (re + 1j * im))[..., 0]


def unit(p):
    return p / np.sqrt(np.mean(np.abs(p) ** 2, axis=1, keepdims=True))


def test_position_errors_are_distinguished_from_noise():
    """The effect of position errors grows with the frequency, that of noise does not."""
    rng, found, spread = np.random.default_rng(0), [], 0.03
    for p in draws(1e-4, 4):
        model = FieldModel(K, ONES, 0 * ONES, np.ones(N), 2)
        off = TRUTH + rng.normal(0, spread, TRUTH.shape)
        estimate = estimates.estimate_noise(off, unit(p), model, estimates.DIFFUSE_FLOOR)
        found.append((estimate.spread, estimate.noise_fraction))
        assert estimate.alone > estimate.noise_fraction
    spreads, shares = np.mean(found, axis=0)
    assert spreads == pytest.approx(spread * np.sqrt(2), rel=0.3)  # the error is that of both coordinates together
    assert shares < 5e-3


@pytest.mark.parametrize("complex_k", [False, True])
def test_the_noise_found_is_the_likeliest_one(complex_k):
    """With a very small spread, its cost equals that of `likelihood_terms`, and no other noise has a lower cost."""
    (p,), tau = draws(0.05, 1, tau=np.linspace(0.5, 2, N)), np.linspace(0.5, 2, N)
    field = FieldModel(K - 0.01j if complex_k else K, np.linspace(0.8, 1.2, M), 0 * ONES, tau, 2)

    def cost(log):
        return likelihood_terms(TRUTH, p, replace(field, noise=np.exp(log) * ONES), derivatives=False).cost

    least = minimize_scalar(cost, bounds=(np.log(1e-3), np.log(0.5)), method="bounded")
    estimate = estimates.estimate_noise(TRUTH, p, field, 1e-3)
    assert estimate.alone == pytest.approx(np.exp(least.x), rel=0.02)
    assert estimate.cost < least.fun - np.log(tau).sum() * M + 0.5, "the position error is one more free parameter"


@pytest.mark.parametrize("spread", [0.0, 0.02, 0.4])
def test_the_cost_of_an_estimate_is_that_of_its_noise_in_every_mode(spread):
    """Position errors add k^2 spread^2 / D, up to the largest fraction that noise may have."""
    (p,) = draws(1e-3, 1)
    x = TRUTH + np.random.default_rng(1).normal(0, spread, TRUTH.shape)
    field = FieldModel(K, ONES, 0 * ONES, np.ones(N), 2)
    found = estimates.estimate_noise(x, unit(p), field, estimates.DIFFUSE_FLOOR)
    noise = np.minimum(found.noise_fraction + (K * found.spread) ** 2 / 2, estimates.MAX_NOISE_FRACTION)
    assert (noise.max() == estimates.MAX_NOISE_FRACTION) == (spread == 0.4)
    cost = likelihood_terms(x, unit(p), replace(field, noise=noise), derivatives=False).cost
    assert found.cost == pytest.approx(cost, rel=1e-9)


def started(seed=0):
    """Pressures of modes of unequal power in channels of unequal noise, and a field that assumes equal ones."""
    rng = np.random.default_rng(seed)
    power, tau = rng.permutation(np.geomspace(0.2, 5, M)), rng.permutation(np.geomspace(0.5, 20, N))
    (p,) = draws(0.02, 1, power, tau / np.median(tau))
    return p, power, tau / np.median(tau), FieldModel(K, ONES, 0.02 * ONES, np.ones(N), 2)


@pytest.mark.parametrize("explained", [True, False])
def test_the_power_ends_where_likelihood_and_prior_are_stationary(explained):
    """This also holds for pressures that are noise but not declared so: the field is then weaker than expected."""
    p, _, tau, field = started()
    p, tau = (p, tau) if explained else (next(draws(1.0, 1)), np.ones(N))
    field = replace(field, channel_noise=tau, noise=field.noise if explained else 0.1 * ONES)
    for _ in range(200):
        field = replace(field, power=estimates.updated_power(field, likelihood_terms(TRUTH, p, field)))
    h = 1e-4

    def costs(way):
        scaled = replace(field, power=np.exp(way * h) * field.power)
        ratio = estimates.expected_power(field, p) / scaled.power  # the prior is inverse gamma
        prior = estimates.POWER_COUNT * (ratio - 1 - np.log(ratio))
        of_channels = estimates.CHANNEL_COUNT * np.sum(1 / tau - 1 + np.log(tau))
        assert estimates.hyper_cost(scaled, p) == pytest.approx(prior.sum() + of_channels)
        return likelihood_terms(TRUTH, p, scaled, derivatives=False).costs + prior

    np.testing.assert_allclose((costs(1) - costs(-1)) / (2 * h), 0.0, atol=1e-4)
    for mode in range(0, M, 7):
        for factor in (0.8, 1.25):
            other = replace(field, power=np.where(np.arange(M) == mode, factor, 1.0) * field.power)
            costs_of = [likelihood_terms(TRUTH, p, one, derivatives=False).cost for one in (other, field)]
            assert costs_of[0] + estimates.hyper_cost(other, p) > costs_of[1] + estimates.hyper_cost(field, p)


def test_the_channel_noise_ends_where_likelihood_and_prior_are_stationary():
    """This holds up to a common factor, which the median removes and the noise of the array contains."""
    p, _, _, field = started()
    for _ in range(300):
        field = replace(field, channel_noise=estimates.updated_channel_noise(field, likelihood_terms(TRUTH, p, field)))
    h, tau = 1e-4, field.channel_noise
    assert np.median(tau) == pytest.approx(1.0)
    inner = np.flatnonzero(tau > 1.01 * estimates.MIN_CHANNEL_NOISE)
    assert len(inner) > N // 2

    def cost(n, way):
        changed = replace(field, channel_noise=np.where(np.arange(N) == n, np.exp(way * h), 1.0) * tau)
        # The expected power hardly depends on the channel noise.
        prior = estimates.CHANNEL_COUNT * np.sum(1 / changed.channel_noise - 1 + np.log(changed.channel_noise))
        return likelihood_terms(TRUTH, p, changed, derivatives=False).cost + prior

    slopes = np.array([(cost(n, 1) - cost(n, -1)) / (2 * h) for n in inner])
    left = np.sum(field.noise[:, None] * likelihood_terms(TRUTH, p, field).precision, axis=0)[inner] * tau[inner]
    factor = 1 - slopes / (left + estimates.CHANNEL_COUNT)
    np.testing.assert_allclose(factor, factor.mean(), rtol=1e-5)


def test_a_singular_field_and_a_dead_channel_stay_within_their_bounds():
    p, _, _, field = started()
    p[:, 0] = 1e-9
    p[:, 1] *= 1e6
    for _ in range(50):
        terms = likelihood_terms(TRUTH, p, field)
        noise = estimates.updated_channel_noise(field, terms)
        field = replace(field, power=estimates.updated_power(field, terms), channel_noise=noise)
    expected = estimates.expected_power(field, p)
    assert np.all(np.isfinite(field.power)) and np.all(field.power <= estimates.MAX_POWER * expected * (1 + 1e-9))
    assert field.channel_noise.min() >= estimates.MIN_CHANNEL_NOISE
    assert field.channel_noise[1] > 100 and field.channel_noise.max() <= estimates.MAX_CHANNEL_NOISE


# Each iteration of the power by direction raises the likelihood, and finds the waves of the field.


WAVENUMBERS = np.array([1.5, 2.5, 4.0])  # rad/m
MODES = len(WAVENUMBERS)
POWER, NOISE = np.array([1.0, 0.7, 1.6]), np.array([0.03, 0.05, 0.02])
ARRAYS = [(2, 2), (3, 3), (3, 2)]  # dimensions of the field and of the array
# The first cases have fewer microphones than directions, the last two have more.
CASES = [(*array, 9, damping) for array in ARRAYS for damping in (0.0, 0.1)] + [(2, 2, 40, 0.0), (2, 2, 40, 0.1)]


def drawn(dimension, D, count, damping):
    """Positions, pressures, wavenumbers, channel noise, and powers by direction that all differ."""
    rng = np.random.default_rng(D)
    x = rng.uniform(-0.4, 0.4, (count, D)) + np.arange(2, 2 + D)
    p = rng.normal(size=(MODES, count)) + 1j * rng.normal(size=(MODES, count))
    k = WAVENUMBERS - 1j * damping if damping else WAVENUMBERS
    powers = rng.exponential(size=(MODES, directions_needed(x, WAVENUMBERS, dimension)))
    return x, p, k, rng.uniform(0.5, 3, count), powers


TAKES = np.array([0, 1, 0])


@pytest.mark.parametrize("count", [0.0, 0.5])
@pytest.mark.parametrize(("dimension", "D", "microphones", "damping"), CASES)
def test_an_iteration_is_that_of_the_formula(dimension, D, microphones, damping, count):
    """The powers S of a row become S (|alpha|^2 / s + var), computed explicitly, and are averaged with their take's."""
    x, p, k, tau, powers = drawn(dimension, D, microphones, damping)
    about, w = x + 0.05, wave_directions(dimension, powers.shape[1])[1]
    powers /= (powers @ w)[:, None]
    assert (powers.shape[1] <= microphones) == (microphones == 40)
    W = plane_waves(x - about.mean(axis=0), k, powers, dimension)
    strength, resolved = np.empty_like(powers), np.empty_like(powers)
    for m in range(MODES):
        A = W[m].T  # shape (N, Q)
        C = POWER[m] * A @ A.conj().T + NOISE[m] * np.diag(tau)
        strength[m] = np.abs(POWER[m] * A.conj().T @ np.linalg.solve(C, p[m])) ** 2 / POWER[m]
        resolved[m] = POWER[m] * np.diag(A.conj().T @ np.linalg.solve(C, A)).real
    own = powers * (strength + 1 - resolved)
    own /= (own @ w)[:, None]
    expected = np.empty_like(own)
    for take in (0, 1):
        rows = take == TAKES
        A, c = powers[rows].mean(axis=0), estimates.ISOTROPY * w * resolved[rows].sum()
        A = A * np.sqrt((strength[rows].sum(axis=0) + c / A) / (resolved[rows].sum(axis=0) + c))
        expected[rows] = (own[rows] + count * A / (w @ A)) / (1 + count)
    field = FieldModel(k, POWER, NOISE, tau, dimension, about=about, directions=powers)
    found = estimates.learned_powers(x, p, field, TAKES, 1, count)
    np.testing.assert_allclose(found, expected, rtol=1e-7)
    np.testing.assert_allclose(found @ w, 1.0, rtol=1e-12)
    twice = estimates.learned_powers(x, p, replace(field, directions=found), TAKES, 1, count)
    np.testing.assert_allclose(estimates.learned_powers(x, p, field, TAKES, 2, count), twice, rtol=1e-9)
