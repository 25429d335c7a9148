"""Power by direction: each iteration raises the likelihood, and finds the waves that are there."""

from dataclasses import replace

import numpy as np
import pytest

from fdcal.cost.angular_spectrum import ISOTROPY, learned_powers
from fdcal.cost.kernels import directions_needed, plane_waves, wave_directions
from fdcal.cost.likelihood import FieldModel, likelihood_terms

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


TAKES = np.array([0, 1, 0])


@pytest.mark.parametrize("count", [0.0, 0.5])
@pytest.mark.parametrize(("dimension", "D", "microphones", "damping"), CASES)
def test_an_iteration_is_that_of_the_formula(dimension, D, microphones, damping, count):
    """Of a row: S <- S (|alpha|^2 / s + var), from the explicit covariance; then towards the spectrum of its take."""
    x, p, k, tau, powers = drawn(dimension, D, microphones, damping)
    about, w = x + 0.05, wave_directions(dimension, powers.shape[1])[1]
    powers /= (powers @ w)[:, None]
    assert (powers.shape[1] <= microphones) == (microphones == 40)
    W, _ = plane_waves(x - about.mean(axis=0), k, powers, False, dimension)
    strength, resolved = np.empty_like(powers), np.empty_like(powers)
    for m in range(M):
        A = W[m].T  # (N, Q)
        C = POWER[m] * A @ A.conj().T + NOISE[m] * np.diag(tau)
        strength[m] = np.abs(POWER[m] * A.conj().T @ np.linalg.solve(C, p[m])) ** 2 / POWER[m]
        resolved[m] = POWER[m] * np.diag(A.conj().T @ np.linalg.solve(C, A)).real
    own = powers * (strength + 1 - resolved)
    own /= (own @ w)[:, None]
    expected = np.empty_like(own)
    for take in (0, 1):
        rows = take == TAKES
        A, c = powers[rows].mean(axis=0), ISOTROPY * w * resolved[rows].sum()
        A = A * np.sqrt((strength[rows].sum(axis=0) + c / A) / (resolved[rows].sum(axis=0) + c))
        expected[rows] = (own[rows] + count * A / (w @ A)) / (1 + count)
    field = FieldModel(k, POWER, NOISE, tau, dimension, about=about, directions=powers)
    found = learned_powers(x, p, field, TAKES, 1, count)
    np.testing.assert_allclose(found, expected, rtol=1e-7)
    np.testing.assert_allclose(found @ w, 1.0, rtol=1e-12)
    twice = learned_powers(x, p, replace(field, directions=found), TAKES, 1, count)
    at_once = learned_powers(x, p, field, TAKES, 2, count)
    np.testing.assert_allclose(at_once, twice, rtol=1e-9)


@pytest.mark.parametrize(("dimension", "D", "microphones", "damping"), CASES)
def test_many_observations_make_the_rows_of_a_take_alike_and_leave_other_takes_alone(
    dimension, D, microphones, damping
):
    x, p, k, tau, powers = drawn(dimension, D, microphones, damping)
    field = FieldModel(k, POWER, NOISE, tau, dimension, directions=powers)
    found = learned_powers(x, p, field, TAKES, 3, 1e9)
    np.testing.assert_allclose(found[0], found[2], rtol=1e-6)
    assert np.abs(found[0] / found[1] - 1).max() > 0.1
    one = np.array([1])
    alone = FieldModel(k[one], POWER[one], NOISE[one], tau, dimension, about=x, directions=powers[one])
    np.testing.assert_allclose(learned_powers(x, p[one], alone, TAKES[one], 3, 1e9), found[one], rtol=1e-6)


def objective(x, p, field, w):
    """-log likelihood and the prior of the spectrum, which all rows share, up to a constant."""
    cost = likelihood_terms(x, p, field, derivatives=False).cost
    W, _ = plane_waves(x - field.about.mean(axis=0), field.wavenumbers, field.directions, False, field.dimension)
    seen = 0.0
    for m, power in enumerate(field.power):
        C = power * W[m].T @ W[m].conj() + field.noise[m] * np.diag(field.channel_noise)
        seen += power * np.sum(W[m].conj() * np.linalg.solve(C, W[m].T).T).real
    A = field.directions[0]
    return cost, seen, ISOTROPY * np.sum(w * (np.log(A) + 1 / A))


@pytest.mark.parametrize("microphones", [14, 40])
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("count", [0.0, 1e9])
def test_iterations_raise_the_likelihood_and_find_a_wave(dimension, microphones, count):
    x = drawn(dimension, dimension, microphones, 0.0)[0]
    towards = np.array([0.6, -0.48, 0.64]) if dimension == 3 else np.array([np.cos(0.7), np.sin(0.7)])
    p, tau = np.exp(-1j * K[:, None] * (x @ towards)), np.linspace(0.5, 3.0, microphones)
    powers, costs = np.ones((M, directions_needed(x, K, dimension))), []
    field, w = (
        FieldModel(K, np.ones(M), np.full(M, 1e-2), tau, dimension, about=x),
        wave_directions(dimension, powers.shape[1])[1],
    )
    for _ in range(6):
        field = replace(field, directions=powers)
        cost, seen, prior = objective(x, p, field, w)
        costs.append(cost + (seen * prior if count else 0.0))
        powers = learned_powers(x, p, field, np.zeros(M, int), 1, count)
    assert np.all(np.diff(costs) < 0)
    u, spacing = wave_directions(dimension, powers.shape[1])[0], 2 * np.pi / powers.shape[1]
    found = np.arccos(towards @ u[:, np.argmax(powers, axis=1)])
    assert np.all(found < (np.arccos(0.9) if dimension == 3 else spacing))
