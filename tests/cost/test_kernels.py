"""Kernels of the likelihood and the waves that they are made of, in blocks on several cores."""

import numpy as np
import pytest
from scipy.special import hankel2, jv, spherical_jn, spherical_yn, yv

from fdcal.acoustics.dictionary import degrees, fourier_bessel, spherical_bessel
from fdcal.cost.kernels import (
    EXTRA_ORDERS,
    NEAR_FIELD_ORDERS,
    SOURCE_DISTANCE,
    diffuse_correlation,
    diffuse_kernel,
    diffuse_matrices,
    direction_count,
    directions_needed,
    expansion_about,
    hermitian_inverses,
    plane_wave_kernel,
    plane_waves,
    series_kernel,
    wave_directions,
    weighted_curvature,
)

K = np.array([1.3, 3.1, 7.4])  # rad/m
ARRAYS = [(2, 2), (3, 3), (3, 2)]  # dimensions of the field and of the array


def array(D=2, seed=0, count=9):
    """Positions (N, D), metres, away from the origin."""
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (count, D)) + np.arange(2, 2 + D)


def apart(x):
    return np.linalg.norm(x[:, None] - x, axis=-1)


def lopsided(x, dimension, seed=3):
    """Powers (M, Q) that differ from direction to direction."""
    return np.random.default_rng(seed).uniform(0.1, 2.0, (len(K), directions_needed(x, K, dimension)))


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_diffuse_field_has_the_covariance_of_bessel_functions_of_order_zero(dimension):
    r = np.array([0.0, 1e-8, 0.01, 0.3, 2.0, 9.0])
    kappa, over = diffuse_kernel(r, K, dimension)
    z = np.multiply.outer(K, r)
    np.testing.assert_allclose(kappa, jv(0, z) if dimension == 2 else spherical_jn(0, z), atol=1e-14)
    np.testing.assert_array_equal(kappa, diffuse_correlation(z, dimension))
    np.testing.assert_allclose(over[:, 0], -(K**2) / dimension, rtol=1e-9, err_msg="kappa = 1 - z^2 / (2 D) at r = 0")
    x = array(dimension)
    matrices, _ = diffuse_matrices(x, K, dimension, True)
    np.testing.assert_allclose(matrices, diffuse_correlation(np.multiply.outer(K, apart(x)), dimension), atol=1e-13)


@pytest.mark.parametrize("near", [False, True])
@pytest.mark.parametrize("damping", [0.0, 0.05, 1.0])
@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_the_series_is_the_covariance_of_the_dictionary_with_its_gains(dimension, D, damping, near):
    x, k = array(D, seed=6), K - 1j * damping
    about = 1.1 * x - 0.2
    centre, orders, gains = expansion_about(x, k, dimension, near, about)
    found, _ = series_kernel(x, about, k, dimension, near)
    for m, L in enumerate(orders if near or dimension == 2 else [40] * len(K)):  # closed form: all orders
        if dimension == 2:
            W = fourier_bessel(x, k[m], int(L), centre) * gains[m, np.abs(np.arange(-L, L + 1))]
        else:
            of_column = degrees(int(L), D == 2)[0]
            W = spherical_bessel(x, complex(k[m]), int(L), centre) * (gains[m, of_column] if near else 1.0)
        expected = W @ W.conj().T
        np.testing.assert_allclose(found[m], expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("damping", [0.0, 0.2])
@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_the_covariance_of_plane_waves_is_theirs(dimension, D, damping):
    """Also of undamped waves, which are added in opposite pairs, and of some of the modes alone."""
    x, about, k = array(D), array(D, seed=1), K - 1j * damping if damping else K
    powers = lopsided(x, dimension)
    found, slope = plane_wave_kernel(x, about, k, powers, True, dimension)
    W, _ = plane_waves(x - about.mean(axis=0), k, powers, False, dimension)
    np.testing.assert_allclose(found, W.swapaxes(1, 2) @ W.conj(), atol=1e-10 * np.abs(found).max())
    some = plane_wave_kernel(x, about, k, powers, True, dimension, slice(1, 3))
    np.testing.assert_allclose(some[0], found[1:], rtol=1e-12)
    np.testing.assert_allclose(some[1], slope[:, 1:], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_source_close_to_the_array_is_a_likely_draw_of_the_near_field_alone(dimension):
    """At 1.7 R, beyond the nearest source that the gains allow for: p^H K^-1 p of a draw is about N."""
    rng, count = np.random.default_rng(0), 60
    x = rng.normal(size=(count, dimension))
    x *= 0.5 * (rng.uniform(size=count) ** (1 / dimension) / np.linalg.norm(x, axis=1))[:, None]
    reach = np.linalg.norm(x - x.mean(axis=0), axis=1).max()
    z = np.multiply.outer(K, np.linalg.norm(x - x.mean(axis=0) - 1.7 * reach * np.eye(dimension)[0], axis=1))
    p = hankel2(0, z) if dimension == 2 else np.exp(-1j * z) / z
    p /= np.sqrt(np.mean(np.abs(p) ** 2, axis=1, keepdims=True))

    def misfit(near):
        matrices = series_kernel(x, None, K, dimension, near, False)[0] + 1e-9 * np.eye(count)
        return np.einsum("mi,mi->m", p.conj(), np.linalg.solve(matrices, p[..., None])[..., 0]).real

    assert np.all(misfit(True) < 2 * count)
    assert misfit(False)[0] > 1000 * count


# Sums and factorisations of many modes at once are those of one mode after the other.


@pytest.mark.parametrize("kind", [float, complex])
def test_a_matrix_that_is_not_positive_definite_is_refused_by_its_mode(kind):
    C = np.tile(np.eye(5, dtype=kind), (7, 1, 1))
    C[4] *= -1
    with pytest.raises(np.linalg.LinAlgError, match="mode 4"):
        hermitian_inverses(C)


def test_the_blocks_that_are_not_computed_are_zero(monkeypatch):
    """They are added, too, and memory that nobody has written may hold anything."""
    rng, empty = np.random.default_rng(0), np.empty
    g, matrices = rng.standard_normal((2, 2, 3, 5)), rng.standard_normal((3, 5, 5))

    def filled(shape, *arguments, **named):
        made = empty(shape, *arguments, **named)
        made.fill(np.nan)
        return made

    monkeypatch.setattr(np, "empty", filled)
    H = weighted_curvature(g, lambda m, rows: matrices[m, rows])
    assert np.isfinite(H).all() and not H[1, 0].any() and H[0, 1].any()


# Circular and plane waves over an array: what they add up to, their slopes, how many are needed.


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


@pytest.mark.parametrize("size", [None, 0.3, 2.0])
@pytest.mark.parametrize(("near", "extra"), [(False, EXTRA_ORDERS), (True, NEAR_FIELD_ORDERS)])
def test_the_order_is_k_times_the_farthest_microphone_and_some(near, extra, size):
    """Whatever the size of the array whose centre is taken."""
    x = array()
    centre, orders, _ = expansion_about(x, K - 0.1j, 2, near, None if size is None else size * x)
    farthest = np.linalg.norm(x - centre, axis=1).max()
    np.testing.assert_array_equal(orders, np.ceil(K * farthest) + extra)


@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
@pytest.mark.parametrize("size", [0.3, 1.0, 2.5])
def test_the_directions_needed_resolve_a_diffuse_field_over_the_array(dimension, D, size):
    x = size * array(D, count=20)
    Q = directions_needed(x, K, dimension)
    W, _ = plane_waves(x - x.mean(axis=0), K, np.ones((len(K), Q)), False, dimension)
    distance = np.linalg.norm(x[:, None] - x, axis=-1)
    for k, one in zip(K, W, strict=True):
        np.testing.assert_allclose(one.T @ one.conj(), diffuse_correlation(k * distance, dimension), atol=2e-4)
    assert Q <= directions_needed(1.5 * x, K, dimension) == directions_needed(x, 1.5 * K, dimension)


@pytest.mark.parametrize("damping", [0.0, 0.3])
@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_a_plane_wave_has_its_power_and_weight_and_falls_along_its_direction(dimension, D, damping):
    x, k = array(D) - array(D).mean(axis=0), K - 1j * damping if damping else K
    u, w = wave_directions(dimension, direction_count(dimension, 5))
    powers = np.random.default_rng(1).uniform(0.1, 2, (len(K), len(w)))
    W, _ = plane_waves(x, k, powers, False, dimension)
    phase = np.exp(-1j * np.multiply.outer(k, u[:D].T @ x.T))
    np.testing.assert_allclose(W, np.sqrt(w * powers)[..., None] * phase, rtol=1e-10)
