"""Kernels of the likelihood and the waves that they are made of, in blocks on several cores."""

import numpy as np
import pytest
from scipy.special import jv, spherical_jn

from fdcal.acoustics.dictionary import dictionary
from fdcal.cost import kernels
from fdcal.cost.likelihood import FieldModel, field_covariance

K = np.array([1.3, 3.1, 7.4])  # rad/m
ARRAYS = [(2, 2), (3, 3), (3, 2)]  # dimensions of the field and of the array


def array(D=2, seed=0, count=9):
    """Positions (N, D), metres, away from the origin."""
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (count, D)) + np.arange(2, 2 + D)


def apart(x):
    return np.linalg.norm(x[:, None] - x, axis=-1)


def lopsided(x, dimension, seed=3):
    """Powers (M, Q) that differ from direction to direction."""
    return np.random.default_rng(seed).uniform(0.1, 2.0, (len(K), kernels.directions_needed(x, K, dimension)))


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_diffuse_field_has_the_covariance_of_bessel_functions_of_order_zero(dimension):
    r = np.array([0.0, 1e-8, 0.01, 0.3, 2.0, 9.0])
    kappa, over = kernels.diffuse_kernel(r, K, dimension)
    z = np.multiply.outer(K, r)
    np.testing.assert_allclose(kappa, jv(0, z) if dimension == 2 else spherical_jn(0, z), atol=1e-14)
    np.testing.assert_array_equal(kappa, kernels.diffuse_correlation(z, dimension))
    np.testing.assert_allclose(over[:, 0], -(K**2) / dimension, rtol=1e-9, err_msg="kappa = 1 - z^2 / (2 D) at r = 0")
    x = array(dimension)
    matrices, _ = kernels.diffuse_matrices(x, K, dimension, True)
    np.testing.assert_allclose(
        matrices, kernels.diffuse_correlation(np.multiply.outer(K, apart(x)), dimension), atol=1e-13
    )


@pytest.mark.parametrize("damping", [0.0, 0.05, 1.0])
@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_the_covariance_of_a_damped_isotropic_field_is_that_of_the_dictionary(dimension, D, damping):
    """Eq. 4 with an ample order; in the plane a sum of plane waves, in space a closed form."""
    x, k = array(D, seed=6), K - 1j * damping
    about = 1.1 * x - 0.2
    field = FieldModel(k, np.ones(3), np.zeros(3), np.ones(len(x)), dimension, about)
    found, _ = field_covariance(x, field, slice(None), False)
    for m in range(len(K)):
        W = dictionary(x, complex(k[m]), 40, about.mean(axis=0), dimension)
        expected = W @ W.conj().T
        np.testing.assert_allclose(found[m], expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("damping", [0.0, 0.2])
@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_the_covariance_of_plane_waves_is_theirs(dimension, D, damping):
    """Also of undamped waves, which are added in opposite pairs, and of some of the modes alone."""
    x, k = array(D) - array(D).mean(axis=0), K - 1j * damping if damping else K
    powers = lopsided(x, dimension)
    found, _ = kernels.plane_wave_covariance(x, k, powers, dimension, slice(None))
    W = kernels.plane_waves(x, k, powers, dimension)
    np.testing.assert_allclose(found, W.swapaxes(1, 2) @ W.conj(), atol=1e-10 * np.abs(found).max())
    some, _ = kernels.plane_wave_covariance(x, k, powers, dimension, slice(1, 3))
    np.testing.assert_allclose(some, found[1:], rtol=1e-12)


# Sums and factorisations of many modes at once are those of one mode after the other.


# Plane waves over an array: what they add up to, their slopes, how many are needed.


@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
@pytest.mark.parametrize("size", [0.3, 1.0, 2.5])
def test_the_directions_needed_resolve_a_diffuse_field_over_the_array(dimension, D, size):
    x = size * array(D, count=20)
    Q = kernels.directions_needed(x, K, dimension)
    W = kernels.plane_waves(x - x.mean(axis=0), K, np.ones((len(K), Q)), dimension)
    distance = np.linalg.norm(x[:, None] - x, axis=-1)
    for k, one in zip(K, W, strict=True):
        np.testing.assert_allclose(one.T @ one.conj(), kernels.diffuse_correlation(k * distance, dimension), atol=2e-4)
    assert Q <= kernels.directions_needed(1.5 * x, K, dimension) == kernels.directions_needed(x, 1.5 * K, dimension)


@pytest.mark.parametrize("damping", [0.0, 0.3])
@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_a_plane_wave_has_its_power_and_weight_and_falls_along_its_direction(dimension, D, damping):
    x, k = array(D) - array(D).mean(axis=0), K - 1j * damping if damping else K
    u, w = kernels.wave_directions(dimension, kernels.direction_count(dimension, 5))
    powers = np.random.default_rng(1).uniform(0.1, 2, (len(K), len(w)))
    W = kernels.plane_waves(x, k, powers, dimension)
    phase = np.exp(-1j * np.multiply.outer(k, u[:D].T @ x.T))
    np.testing.assert_allclose(W, np.sqrt(w * powers)[..., None] * phase, rtol=1e-10)


@pytest.mark.parametrize("kind", [float, complex])
def test_a_matrix_that_is_not_positive_definite_is_refused_by_its_mode(kind):
    C = np.tile(np.eye(5, dtype=kind), (7, 1, 1))
    C[4] *= -1
    with pytest.raises(np.linalg.LinAlgError, match="mode 4"):
        kernels.hermitian_inverses(C)
