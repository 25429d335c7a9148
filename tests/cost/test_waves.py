"""Circular and plane waves over an array: what they add up to, their slopes, how many are needed."""

import numpy as np
import pytest
from fields import bessel_kernel, plane_wave
from scipy.special import jv, spherical_jn, spherical_yn, yv

from fdcal.acoustics.dictionary import fourier_bessel
from fdcal.cost.kernels import (
    DEGREES,
    EXTRA_ORDERS,
    NEAR_FIELD_ORDERS,
    SOURCE_DISTANCE,
    circular_dictionary,
    circular_waves,
    diffuse_correlation,
    direction_count,
    directions_needed,
    expansion_about,
    plane_waves,
    wave_directions,
)

K = np.array([1.3, 3.1, 7.4])  # rad/m
STEP = 1e-5  # metres, of central differences


def array(D=2, count=9, seed=0):
    """Positions (N, D), metres, away from the origin."""
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (count, D)) + np.arange(2, 2 + D)


def from_centre(D, damping, **chosen):
    x = array(D, **chosen)
    return x - x.mean(axis=0), K - 1j * damping if damping else K


@pytest.mark.parametrize("near", [False, True])
@pytest.mark.parametrize("dimension", [2, 3])
def test_gains_follow_wavenumbers_size_and_dimension(dimension, near):
    """Each in turn, since trials of a step share them."""
    x = array()
    reach = float(np.linalg.norm(x - x.mean(axis=0), axis=1).max())
    for k, scale in ((K, 1.0), (1.1 * K, 1.0), (K, 1.3), (K, 1.0)):
        _, orders, gains = expansion_about(scale * x, k, dimension, near)
        l, z = np.arange(orders.max() + 1), (k * SOURCE_DISTANCE * scale * reach)[:, None]  # noqa: E741
        sizes = np.hypot(jv(l, z), yv(l, z)) if dimension == 2 else np.hypot(spherical_jn(l, z), spherical_yn(l, z))
        np.testing.assert_allclose(gains, np.clip(sizes, 1.0, 1e100) if near else np.ones_like(sizes), rtol=1e-10)


@pytest.mark.parametrize("D", [2, 3])
def test_the_expansion_is_about_the_positions_given_for_it(D):
    x, about = array(D), 0.7 * array(D, seed=1) + 0.2
    reach = np.linalg.norm(about - about.mean(axis=0), axis=1).max()
    centre, _, gains = expansion_about(x, K, D, True, about)
    assert 0 < np.linalg.norm(centre - about.mean(axis=0)) < 2e-3 * reach
    assert np.all(np.linalg.norm(x - centre, axis=1) > 0)
    own_centre, _, own_gains = expansion_about(about, K, D, True)
    np.testing.assert_array_equal(centre, own_centre)
    shared = min(gains.shape[1], own_gains.shape[1])
    np.testing.assert_array_equal(gains[:, :shared], own_gains[:, :shared], "the extent is that of `about`, too")


@pytest.mark.parametrize("size", [None, 0.3, 2.0])
@pytest.mark.parametrize(("near", "extra"), [(False, EXTRA_ORDERS), (True, NEAR_FIELD_ORDERS)])
def test_the_order_is_k_times_the_farthest_microphone_and_some(near, extra, size):
    """Whatever the size of the array whose centre is taken."""
    x = array()
    centre, orders, _ = expansion_about(x, K - 0.1j, 2, near, None if size is None else size * x)
    farthest = np.linalg.norm(x - centre, axis=1).max()
    np.testing.assert_array_equal(orders, np.ceil(K * farthest) + extra)


@pytest.mark.parametrize("D", [2, 3])
def test_positions_that_are_not_finite_have_no_expansion(D):
    for value in (np.nan, np.inf):
        x = array(D)
        x[3, 1] = value
        with pytest.raises(np.linalg.LinAlgError, match="not finite"), np.errstate(invalid="ignore"):
            expansion_about(x, K, D, False)


def test_circular_waves_of_ample_order_are_a_diffuse_field():
    """Graf's addition theorem: the sum over all orders is J_0(k r) whatever the centre."""
    x = array(count=15)
    centre, orders, gains = expansion_about(x, K, 2, False)
    W, _ = circular_waves(x, centre, K, orders, gains, False)
    assert W.dtype == float
    for k, one in zip(K, W, strict=True):
        np.testing.assert_allclose(one.T @ one, bessel_kernel(x, k), atol=1e-8)


@pytest.mark.parametrize("damping", [0.0, 0.2])
def test_circular_waves_are_the_dictionary_of_the_paper_after_a_unitary_map(damping):
    """Also with gains, and with an order that is lower than the highest: its other columns are zero."""
    x, k = array(), K - 1j * damping if damping else K
    orders, gains = np.array([4, 2, 6]), np.random.default_rng(1).uniform(1, 3, (3, 7))
    W, _ = circular_waves(x, x[0], k, orders, gains, False)  # one microphone stands on the centre
    assert W.shape == (3, 13, len(x))
    for m, L in enumerate(orders):
        wanted = fourier_bessel(x, k[m], int(L), x[0]) * gains[m, np.abs(np.arange(-L, L + 1))]
        np.testing.assert_allclose(W[m].T @ W[m].conj(), wanted @ wanted.conj().T, atol=1e-12)
        np.testing.assert_allclose(
            W[m].T @ W[m], wanted[:, ::-1] * (-1.0) ** np.arange(-L, L + 1) @ wanted.T, atol=1e-12
        )
        used = np.concatenate([np.arange(7) <= L, np.arange(1, 7) <= L])
        assert not W[m, ~used].any() and W[m, used].any(axis=1).all()


@pytest.mark.parametrize("damping", [0.0, 0.2])
def test_slopes_of_circular_waves_are_the_limit_of_differences(damping):
    x, k = array(), K - 1j * damping if damping else K
    orders, gains = np.array([4, 2, 6]), np.random.default_rng(1).uniform(1, 3, (3, 7))
    centre = x.mean(axis=0)
    slopes = circular_waves(x, centre, k, orders, gains, True)[1]
    for along, step in zip(slopes, STEP * np.eye(2), strict=True):
        high, low = (circular_waves(x + way * step, centre, k, orders, gains, False)[0] for way in (1, -1))
        np.testing.assert_allclose(along, (high - low) / (2 * STEP), atol=1e-8)


def test_a_plane_wave_is_a_sum_of_circular_waves_by_jacobi_and_anger():
    """exp(-j z cos t) = J_0(z) + 2 sum_l (-j)^l J_l(z) cos(l t)."""
    x, k, angle, L = array(), K[1], 0.7, 20
    centre, l = x.mean(axis=0), np.arange(1, L + 1)  # noqa: E741
    factor = np.sqrt(2) * (-1j) ** l
    alpha = np.concatenate([[1.0], np.stack([factor * np.cos(l * angle), factor * np.sin(l * angle)], axis=1).ravel()])
    found = circular_dictionary(x, k, L, centre) @ alpha
    np.testing.assert_allclose(found * plane_wave(centre[None], k, angle), plane_wave(x, k, angle), atol=1e-12)


def test_the_first_columns_are_the_dictionary_of_a_lower_order():
    x = array()
    high, low = (circular_dictionary(x, K[2], L, x.mean(axis=0)) for L in (9, 4))
    np.testing.assert_allclose(high[:, :9], low, atol=1e-14)
    assert high.shape == (len(x), 19)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("order", [2, 6, 11, 18])
def test_the_mean_over_the_directions_is_exact_up_to_twice_the_order(dimension, order):
    u, w = wave_directions(dimension, direction_count(dimension, order))
    np.testing.assert_allclose(np.linalg.norm(u, axis=0), 1)
    assert np.all(w > 0) and np.isclose(w.sum(), 1)
    towards = np.array([0.6, 0.8, 0.0])[:dimension]
    for power in range(2, 2 * order, 2):
        half = np.arange(power // 2)
        exact = 1 / (power + 1) if dimension == 3 else np.prod((half + 0.5) / (half + 1))
        assert np.isclose(w @ (towards @ u) ** power, exact)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("order", [2, 5, *(degree // 2 for degree in DEGREES[3:12])])
def test_the_second_half_of_the_directions_is_opposite_to_the_first(dimension, order):
    u, w = wave_directions(dimension, direction_count(dimension, order))
    half = len(w) // 2
    np.testing.assert_allclose(u[:, half:], -u[:, :half], atol=1e-15)
    np.testing.assert_allclose(w[half:], w[:half])


@pytest.mark.parametrize(("dimension", "D"), [(2, 2), (3, 3), (3, 2)])
@pytest.mark.parametrize("size", [0.3, 1.0, 2.5])
def test_the_directions_needed_resolve_a_diffuse_field_over_the_array(dimension, D, size):
    x = size * array(D, 20)
    Q = directions_needed(x, K, dimension)
    W, _ = plane_waves(x - x.mean(axis=0), K, np.ones((len(K), Q)), False, dimension)
    distance = np.linalg.norm(x[:, None] - x, axis=-1)
    for k, one in zip(K, W, strict=True):
        np.testing.assert_allclose(one.T @ one.conj(), diffuse_correlation(k * distance, dimension), atol=2e-4)
    assert Q <= directions_needed(1.5 * x, K, dimension) == directions_needed(x, 1.5 * K, dimension)


@pytest.mark.parametrize("damping", [0.0, 0.3])
@pytest.mark.parametrize(("dimension", "D"), [(2, 2), (3, 3), (3, 2)])
def test_a_plane_wave_has_its_power_and_weight_and_falls_along_its_direction(dimension, D, damping):
    x, k = from_centre(D, damping)
    u, w = wave_directions(dimension, direction_count(dimension, 5))
    powers = np.random.default_rng(1).uniform(0.1, 2, (len(K), len(w)))
    W, _ = plane_waves(x, k, powers, False, dimension)
    phase = np.exp(-1j * np.multiply.outer(k, u[:D].T @ x.T))
    np.testing.assert_allclose(W, np.sqrt(w * powers)[..., None] * phase, rtol=1e-10)


@pytest.mark.parametrize("damping", [0.0, 0.3])
@pytest.mark.parametrize(("dimension", "D"), [(2, 2), (3, 3), (3, 2)])
def test_slopes_of_plane_waves_are_the_limit_of_differences(dimension, D, damping):
    x, k = from_centre(D, damping)
    powers = np.ones((len(K), direction_count(dimension, 5)))
    slopes = plane_waves(x, k, powers, True, dimension)[1]
    assert len(slopes) == D
    for along, step in zip(slopes, STEP * np.eye(D), strict=True):
        high, low = (plane_waves(x + way * step, k, powers, False, dimension)[0] for way in (1, -1))
        np.testing.assert_allclose(along, (high - low) / (2 * STEP), atol=1e-7)
