"""Laws of the Fourier-Bessel dictionary."""

import numpy as np
import pytest
from fields import bessel_kernel, plane_wave, plane_wave_coefficients
from scipy.special import jv

from fdcal.acoustics.dictionary import array_f_max, f_max, fourier_bessel, max_order
from fdcal.acoustics.lattice_dictionary import LatticeDictionary, bessel_orders
from fdcal.model.settings import Search

POINTS = np.random.default_rng(0).uniform(-0.5, 0.5, (40, 2)) + [2.0, 1.0]
CENTRE = np.array([2.1, 0.9])
WAVENUMBERS = [0.5, 5.0, 7.3 - 0.02j]


@pytest.mark.parametrize("k", WAVENUMBERS)
def test_plane_wave_is_the_jacobi_anger_sum(k):
    W = fourier_bessel(POINTS, k, 30, CENTRE)
    expected = plane_wave(POINTS, k, 0.7)
    np.testing.assert_allclose(W @ plane_wave_coefficients(k, 0.7, 30, CENTRE), expected, atol=1e-12)


@pytest.mark.parametrize("k", WAVENUMBERS)
def test_each_atom_solves_helmholtz(k):
    h, L = 1e-3, 5
    fields = [fourier_bessel(POINTS + d, k, L, CENTRE) for d in ([0, 0], [h, 0], [-h, 0], [0, h], [0, -h])]
    laplacian = (sum(fields[1:]) - 4 * fields[0]) / h**2
    np.testing.assert_allclose(laplacian, -(k**2) * fields[0], atol=abs(k) ** 4 * h**2)


def test_gram_matrix_is_the_diffuse_field_kernel_whatever_the_centre():
    """Graf's addition theorem: W W^H tends to J_0(k d) for real k."""
    for centre in (CENTRE, [1.8, 1.3]):
        W = fourier_bessel(POINTS, 7.0, 40, centre)
        np.testing.assert_allclose(W @ W.conj().T, bessel_kernel(POINTS, 7.0), atol=1e-12)


def test_order_follows_eq_3():
    np.testing.assert_array_equal(max_order(np.array([0.5, 5.0, 5.01 - 2j]), 0.8), [1, 4, 5])
    assert max_order(5.0, 0.8, offset=2) == 6


def test_f_max_is_the_papers():
    """Section 5: 4950 Hz for array 1, R = 0.35 m, c = 340 m/s."""
    assert f_max(65, 0.35, 340.0) == pytest.approx(4950, rel=1e-3)
    assert f_max(2, 0.35, 340.0) == pytest.approx(340 / (4 * np.pi * 0.35)), "few microphones follow the same rule"


def test_f_max_in_space_is_the_order_with_as_many_functions_as_microphones():
    k_of = lambda f: 2 * np.pi * f / 343.0  # noqa: E731
    for order in (1, 3, 7):
        assert k_of(f_max((order + 1) ** 2, 0.7, 343.0, 3)) * 0.7 == pytest.approx(order)
        assert k_of(f_max((order + 1) * (order + 2) // 2, 0.7, 343.0, 3, planar=True)) * 0.7 == pytest.approx(order)


def test_f_max_of_an_array_takes_its_radius_about_the_centre_of_mass():
    square = np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.4], [0.0, 0.4]]) + 3.0
    radius = 0.2 * np.sqrt(2)
    assert array_f_max(square, 343.0, 2) == pytest.approx(f_max(4, radius, 343.0))
    assert array_f_max(square, 343.0, 3) == pytest.approx(f_max(4, radius, 343.0, 3, planar=True))
    assert array_f_max(np.ones((4, 2)), 343.0, 2) == np.inf


@pytest.mark.parametrize("order", [0, 1, 7, 30])
def test_downward_recurrence_agrees_with_the_library(order):
    z = np.concatenate([[0.0, 1e-8, 1e-3], np.linspace(0.01, 40, 200) * (1 - 0.01j)])
    np.testing.assert_allclose(bessel_orders(z, order), jv(np.arange(order + 1), z[:, None]), rtol=1e-9, atol=1e-14)


def test_lattice_table_is_the_dictionary_of_its_points():
    search = Search((1.5, 0.4), (1.0, 0.8), 0.1, 0.7)
    k = np.array([0.5, 6.0 - 0.05j])
    orders = max_order(k, search.radius, 2)
    lattice = LatticeDictionary(search, k, orders)
    assert lattice.points.shape == (11 * 9, 2)
    for centre in (lattice.points[0], lattice.nearest([2.03, 0.77]), lattice.points[-1]):
        for m, W in enumerate(lattice.dictionary(lattice.points, centre, [0, 1])):
            np.testing.assert_allclose(W, fourier_bessel(lattice.points, k[m], orders[m], centre), atol=1e-13)
        mixed = np.concatenate([lattice.points[[3, 50]], [[1.77, 0.66], [0.0, 5.0]]])
        for m, W in zip([1, 0], lattice.dictionary(mixed, centre, [1, 0]), strict=True):
            np.testing.assert_allclose(W, fourier_bessel(mixed, k[m], orders[m], centre), rtol=1e-10, atol=1e-13)
