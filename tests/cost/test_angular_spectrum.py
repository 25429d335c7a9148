"""Power by direction: each iteration is one of expectation and maximisation, and finds the waves that are there."""

from dataclasses import replace

import numpy as np
import pytest

from fdcal.cost.angular_spectrum import learned_powers
from fdcal.cost.likelihood import FieldModel, likelihood_terms
from fdcal.cost.waves import directions_needed, plane_waves, wave_directions

K = np.array([1.5, 2.5, 4.0])  # rad/m
M = len(K)
POWER, NOISE = np.array([1.0, 0.7, 1.6]), np.array([0.03, 0.05, 0.02])
ARRAYS = [(2, 2), (3, 3), (3, 2)]  # dimensions of the field and of the array
# fewer microphones than directions, and more
CASES = [(*array, 9, damping) for array in ARRAYS for damping in (0.0, 0.1)] + [(2, 2, 40, 0.0), (2, 2, 40, 0.1)]


def drawn(dimension, D, count, damping):
    """Positions, pressures, wavenumbers, channel noise, and powers by direction that all differ."""
    rng = np.random.default_rng(D)
    x = rng.uniform(-0.4, 0.4, (count, D)) + np.arange(2, 2 + D)
    p = rng.normal(size=(M, count)) + 1j * rng.normal(size=(M, count))
    k = K - 1j * damping if damping else K
    powers = rng.exponential(size=(M, directions_needed(x, K, dimension)))
    return x, p, k, rng.uniform(0.5, 3, count), powers


@pytest.mark.parametrize("count", [0.0, 0.5])
@pytest.mark.parametrize(("dimension", "D", "microphones", "damping"), CASES)
def test_an_iteration_is_one_of_expectation_and_maximisation(dimension, D, microphones, damping, count):
    """S <- S (|alpha|^2 / s + var), from the explicit covariance; then of mean 1, and with the prior."""
    x, p, k, tau, powers = drawn(dimension, D, microphones, damping)
    about = x + 0.05
    assert (powers.shape[1] <= microphones) == (microphones == 40)
    W, _ = plane_waves(x - about.mean(axis=0), k, powers, False, dimension)
    expected, w = np.empty_like(powers), wave_directions(dimension, powers.shape[1])[1]
    for m in range(M):
        A = W[m].T  # (N, Q)
        C = POWER[m] * A @ A.conj().T + NOISE[m] * np.diag(tau)
        amplitude = POWER[m] * A.conj().T @ np.linalg.solve(C, p[m])
        variance = 1 - POWER[m] * np.diag(A.conj().T @ np.linalg.solve(C, A)).real
        fresh = powers[m] * (np.abs(amplitude) ** 2 / POWER[m] + variance)
        expected[m] = (fresh / (w @ fresh) + count) / (1 + count)
    found = learned_powers(x, p, k, POWER, NOISE, powers, 1, tau, count, about, dimension)
    np.testing.assert_allclose(found, expected, rtol=1e-7)
    np.testing.assert_allclose(found @ w, 1.0, rtol=1e-12)
    twice = learned_powers(x, p, k, POWER, NOISE, found, 1, tau, count, about, dimension)
    at_once = learned_powers(x, p, k, POWER, NOISE, powers, 2, tau, count, about, dimension)
    np.testing.assert_allclose(at_once, twice, rtol=1e-9)


@pytest.mark.parametrize(("dimension", "D", "microphones", "damping"), CASES)
def test_many_observations_of_a_diffuse_field_keep_it_diffuse(dimension, D, microphones, damping):
    x, p, k, tau, powers = drawn(dimension, D, microphones, damping)
    found = learned_powers(x, p, k, POWER, NOISE, powers, 1, tau, 1e9, x, dimension)
    np.testing.assert_allclose(found, 1.0, rtol=1e-6)


@pytest.mark.parametrize("microphones", [14, 40])
@pytest.mark.parametrize("dimension", [2, 3])
def test_iterations_raise_the_likelihood_and_find_a_wave(dimension, microphones):
    x = drawn(dimension, dimension, microphones, 0.0)[0]
    towards = np.array([0.6, -0.48, 0.64]) if dimension == 3 else np.array([np.cos(0.7), np.sin(0.7)])
    p, tau = np.exp(-1j * K[:, None] * (x @ towards)), np.linspace(0.5, 3.0, microphones)
    powers, costs = np.ones((M, directions_needed(x, K, dimension))), []
    field = FieldModel(K, np.ones(M), np.full(M, 1e-2), tau, dimension, about=x)
    for _ in range(6):
        costs.append(likelihood_terms(x, p, replace(field, directions=powers), derivatives=False).cost)
        powers = learned_powers(x, p, K, field.power, field.noise, powers, 1, tau, 0.0, x, dimension)
    assert np.all(np.diff(costs) < 0)
    u, spacing = wave_directions(dimension, powers.shape[1])[0], 2 * np.pi / powers.shape[1]
    found = np.arccos(towards @ u[:, np.argmax(powers, axis=1)])
    assert np.all(found < (np.arccos(0.9) if dimension == 3 else spacing))
