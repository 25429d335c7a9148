"""Covariances of sound fields: each is that of its waves, and its slope the limit of differences."""

import numpy as np
import pytest
from scipy.special import hankel2, jv, spherical_jn

from fdcal.acoustics.dictionary import degrees, fourier_bessel, spherical_bessel
from fdcal.cost.kernels import (
    diffuse_correlation,
    diffuse_kernel,
    diffuse_matrices,
    directions_needed,
    expansion_about,
    plane_wave_covariance,
    plane_wave_kernel,
    plane_waves,
    series_kernel,
)

K = np.array([1.3, 3.1, 7.4])  # rad/m
ARRAYS = [(2, 2), (3, 3), (3, 2)]  # dimensions of the field and of the array
STEP = 1e-5  # metres, of central differences


def array(D, seed=0, count=9):
    """Positions (N, D), metres, away from the origin."""
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (count, D)) + np.arange(2, 2 + D)


def apart(x):
    return np.linalg.norm(x[:, None] - x, axis=-1)


def lopsided(x, dimension, seed=3):
    """Powers (M, Q) that differ from direction to direction."""
    return np.random.default_rng(seed).uniform(0.1, 2.0, (len(K), directions_needed(x, K, dimension)))


def assert_slope(kernel, x, slope, atol):
    """`slope` (D, M, N, N) is the derivative of `kernel(x)` (M, N, N) by the first microphone of each pair."""
    for i, a in np.ndindex(x.shape):
        step = np.zeros_like(x)
        step[i, a] = STEP
        expected = (kernel(x + step) - kernel(x - step))[:, i] / (2 * STEP)
        found = slope[a][:, i].astype(complex)
        found[:, i] = 2 * found[:, i].real  # both microphones of that element move
        np.testing.assert_allclose(found, expected, rtol=0, atol=atol)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_diffuse_field_has_the_covariance_of_bessel_functions_of_order_zero(dimension):
    r = np.array([0.0, 1e-8, 0.01, 0.3, 2.0, 9.0])
    kappa, over = diffuse_kernel(r, K, dimension)
    z = np.multiply.outer(K, r)
    np.testing.assert_allclose(kappa, jv(0, z) if dimension == 2 else spherical_jn(0, z), atol=1e-14)
    np.testing.assert_array_equal(kappa, diffuse_correlation(z, dimension))
    np.testing.assert_allclose(over[:, 0], -(K**2) / dimension, rtol=1e-9, err_msg="kappa = 1 - z^2 / (2 D) at r = 0")
    far = r[3:]
    high, low = (diffuse_kernel(far + way * STEP, K, dimension)[0] for way in (1, -1))
    np.testing.assert_allclose(over[:, 3:] * far, (high - low) / (2 * STEP), atol=1e-8)
    assert diffuse_kernel(r, K, dimension, False)[1] is None


@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_the_matrices_of_a_diffuse_field_are_its_kernel_between_all_pairs(dimension, D):
    x = array(D)
    matrices, S = diffuse_matrices(x, K, dimension, True)
    np.testing.assert_allclose(matrices, diffuse_correlation(np.multiply.outer(K, apart(x)), dimension), atol=1e-13)
    slope = np.moveaxis(S[..., None] * (x[:, None] - x), -1, 0)
    assert_slope(lambda y: diffuse_matrices(y, K, dimension, False)[0], x, slope, 1e-8)
    with pytest.raises(np.linalg.LinAlgError, match="not finite"):
        diffuse_matrices(np.full_like(x, np.nan), K, dimension, False)


@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_the_series_of_a_real_wavenumber_is_a_diffuse_field(dimension, D):
    x = array(D)
    matrices, slope = series_kernel(x, None, K, dimension)
    expected, S = diffuse_matrices(x, K, dimension, True)
    np.testing.assert_allclose(matrices, expected, atol=1e-8)
    np.testing.assert_allclose(slope, np.moveaxis(S[..., None] * (x[:, None] - x), -1, 0), atol=1e-6)


@pytest.mark.parametrize("near", [False, True])
@pytest.mark.parametrize("damping", [0.0, 0.05, 1.0])
@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_the_series_is_the_covariance_of_the_dictionary_with_its_gains(dimension, D, damping, near):
    x, k = array(D, seed=6), K - 1j * damping
    about = 1.1 * x - 0.2
    centre, orders, gains = expansion_about(x, k, dimension, near, about)
    found, slope = series_kernel(x, about, k, dimension, near)
    for m, L in enumerate(orders if near or dimension == 2 else [40] * len(K)):  # closed form: all orders
        if dimension == 2:
            W = fourier_bessel(x, k[m], int(L), centre) * gains[m, np.abs(np.arange(-L, L + 1))]
        else:
            of_column = degrees(int(L), D == 2)[0]
            W = spherical_bessel(x, complex(k[m]), int(L), centre) * (gains[m, of_column] if near else 1.0)
        expected = W @ W.conj().T
        np.testing.assert_allclose(found[m], expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    kernel = lambda y: series_kernel(y, about, k, dimension, near, False)[0]  # noqa: E731
    assert_slope(kernel, x, slope, 1e-8 * np.abs(slope).max())


@pytest.mark.parametrize("damping", [0.0, 0.05])
@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_waves_of_equal_power_from_everywhere_are_the_series(dimension, D, damping):
    x, k = array(D), K - 1j * damping if damping else K
    centre = expansion_about(x, k, dimension, False)[0]
    about = x + (centre - x.mean(axis=0))
    ones = np.ones((len(K), directions_needed(x, 2 * K, dimension)))
    found = plane_wave_kernel(x, about, k, ones, True, dimension)
    expected = series_kernel(x, None, k, dimension, False)
    np.testing.assert_allclose(found[0], expected[0], atol=1e-8)
    np.testing.assert_allclose(found[1], expected[1], atol=1e-6)


@pytest.mark.parametrize("damping", [0.0, 0.2])
@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_the_covariance_of_plane_waves_is_theirs_and_its_slope_the_limit_of_differences(dimension, D, damping):
    """Also of undamped waves, which are added in opposite pairs, and of some of the modes alone."""
    x, about, k = array(D), array(D, seed=1), K - 1j * damping if damping else K
    powers = lopsided(x, dimension)
    found, slope = plane_wave_kernel(x, about, k, powers, True, dimension)
    W, _ = plane_waves(x - about.mean(axis=0), k, powers, False, dimension)
    np.testing.assert_allclose(found, W.swapaxes(1, 2) @ W.conj(), atol=1e-10 * np.abs(found).max())
    kernel = lambda y: plane_wave_kernel(y, about, k, powers, False, dimension)[0]  # noqa: E731
    assert_slope(kernel, x, slope, 1e-7 * np.abs(slope).max())
    some = plane_wave_kernel(x, about, k, powers, True, dimension, slice(1, 3))
    np.testing.assert_allclose(some[0], found[1:], rtol=1e-12)
    np.testing.assert_allclose(some[1], slope[:, 1:], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("damping", [0.0, 0.2])
@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_products_with_the_slope_of_plane_waves_need_no_slope(dimension, D, damping):
    """Those of some modes, with any vectors and Hermitian matrices."""
    x, about, k, rng = array(D), array(D, seed=1), K - 1j * damping if damping else K, np.random.default_rng(2)
    powers, modes = lopsided(x, dimension), slice(1, 3)
    u = rng.normal(size=(2, len(x), 2)).view(complex)[..., 0]
    P = rng.normal(size=(2, len(x), len(x), 2)).view(complex)[..., 0]
    P = P + np.conj(P.swapaxes(1, 2))
    matrices, slope = plane_wave_kernel(x, about, k, powers, True, dimension, modes)
    found, products = plane_wave_covariance(x, about, k, powers, dimension, modes)
    g, traced = products(u, P)
    np.testing.assert_allclose(found, matrices, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(g, np.einsum("amij,mj->ami", slope, u), rtol=1e-9, atol=1e-10 * np.abs(g).max())
    expected = np.einsum("amij,mij->ami", slope, np.conj(P)).real
    np.testing.assert_allclose(traced, expected, rtol=1e-9, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_every_covariance_is_hermitian_and_not_negative(dimension, D):
    x = array(D)
    for found in (
        diffuse_matrices(x, K, dimension, False)[0],
        series_kernel(x, None, K - 0.1j, dimension, True, False)[0],
        plane_wave_kernel(x, x, K - 0.1j, lopsided(x, dimension), False, dimension)[0],
        plane_wave_kernel(x, x, K, lopsided(x, dimension), False, dimension)[0],
    ):
        np.testing.assert_allclose(found, np.conj(found.swapaxes(1, 2)), atol=1e-10 * np.abs(found).max())
        assert np.linalg.eigvalsh(found).min() > -1e-9 * np.abs(found).max()


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
