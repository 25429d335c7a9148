"""Waves of real wavenumbers in opposite pairs: the same covariance and the same power by direction as one by one."""

import numpy as np
import pytest

from fdcal.cost.angular_prior import diffuse_prior, learned_prior, plane_wave_kernel
from fdcal.cost.wave_directions import DEGREES, direction_count, wave_directions


@pytest.fixture(params=[2, 3])
def dimension(request):
    return request.param


@pytest.fixture
def array(dimension):
    """Positions, wavenumbers, and powers by direction that all differ, more directions than microphones."""
    rng = np.random.default_rng(dimension)
    x, k = 0.2 * rng.normal(size=(9, dimension)), rng.uniform(2, 9, 5)
    return x, k, rng.exponential(size=diffuse_prior(x, k, dimension).shape)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("order", [2, 5, *(degree // 2 for degree in DEGREES[3:12])])
def test_the_second_half_of_the_directions_is_opposite_to_the_first(dimension, order):
    u, w = wave_directions(dimension, direction_count(dimension, order))
    half = len(w) // 2
    np.testing.assert_allclose(u[:, half:], -u[:, :half], atol=1e-15)
    np.testing.assert_allclose(w[half:], w[:half])


def test_the_covariance_is_that_of_complex_waves(array, dimension):
    x, k, prior = array
    real, complex_ = (plane_wave_kernel(x, x, one, prior, True, dimension) for one in (k, k.astype(complex)))
    for found, expected in zip(real, complex_, strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_the_slope_is_the_derivative_of_the_covariance(array, dimension):
    x, k, prior = array
    step, (_, slope) = 1e-6, plane_wave_kernel(x, x, k, prior, True, dimension)
    for axis in range(dimension):
        ends = [np.array(x), np.array(x)]
        ends[0][0, axis] -= step
        ends[1][0, axis] += step
        low, high = (plane_wave_kernel(end, x, k, prior, False, dimension)[0] for end in ends)
        np.testing.assert_allclose(slope[axis][:, 0, 1:], ((high - low) / (2 * step))[:, 0, 1:], atol=1e-7)


@pytest.mark.parametrize("uneven", [False, True])
def test_as_much_power_is_learned_as_of_complex_waves(array, dimension, uneven):
    x, k, prior = array
    rng = np.random.default_rng(7)
    p = rng.normal(size=(len(k), len(x))) + 1j * rng.normal(size=(len(k), len(x)))
    channels = rng.uniform(1, 3, len(x)) if uneven else None
    power, noise = np.linspace(0.8, 1.3, len(k)), np.linspace(0.05, 0.2, len(k))
    learned = [learned_prior(x, p, one, power, noise, prior, 4, channels, 0.5, None, dimension) for one in (k, k + 0j)]
    np.testing.assert_allclose(learned[0], learned[1], rtol=1e-9)
    assert not np.allclose(learned[0], prior, rtol=0.1), "something was learned"
