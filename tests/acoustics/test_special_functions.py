"""The Bessel functions and sin(z) / z that are computed for whole arrays, against SciPy's."""

import numpy as np
import pytest
from scipy.special import jv, spherical_jn

from fdcal.acoustics.special_functions import bessel, complex_sinc, sinc

ARGUMENTS = [0.0, 1e-9, 0.03, 0.1999, 0.2001, 1.0, 4.7, 23.0, 60.0]


def test_sine_over_z_and_its_slope_are_the_spherical_bessel_functions():
    z = np.concatenate([[0.0], np.geomspace(1e-9, 1e3, 4001), np.pi / 4 * np.arange(1, 400)])
    value, slope = sinc(z)
    np.testing.assert_allclose(value, spherical_jn(0, z), rtol=0, atol=4e-15)
    np.testing.assert_allclose(slope * z, -spherical_jn(1, z), rtol=0, atol=2e-14)
    assert (value[0], slope[0]) == (1.0, pytest.approx(-1 / 3))
    assert sinc(z[:6].reshape(2, 3))[1].shape == (2, 3)
    assert np.isnan(sinc(np.array([np.nan, 1.0]))[0][0])


def test_sine_over_z_of_a_complex_square_does_not_depend_on_the_root():
    size = np.concatenate([np.geomspace(1e-5, 30, 301), np.linspace(0.0199, 0.0201, 21)])
    z = np.multiply.outer(size, np.exp(1j * np.linspace(-np.pi, np.pi, 17))).ravel()
    growth = np.exp(np.abs(z.imag))
    value, slope = complex_sinc(z * z)
    assert np.max(np.abs(value - spherical_jn(0, z)) / growth) < 2e-14
    assert np.max(np.abs(slope * z + spherical_jn(1, z)) / growth) < 1e-12, "SciPy loses digits near 0"
    value, slope = complex_sinc(np.array([0.0, -4.0]))
    assert value == pytest.approx([1.0, np.sinh(2) / 2]), "the square of a damped wave may be negative"
    assert slope == pytest.approx([-1 / 3, -(np.cosh(2) - np.sinh(2) / 2) / 4])


@pytest.mark.parametrize("damping", [0.0, 0.5])
@pytest.mark.parametrize("top", [1, 6, 40, 150])
def test_bessel_functions_of_all_orders_are_scipy_s(damping, top):
    z = np.array([z for z in ARGUMENTS if z <= top + 25])  # the orders in use always reach beyond the argument
    z = z - 1j * damping if damping else z
    J = bessel(z, top)
    assert J.dtype == z.dtype
    np.testing.assert_allclose(J, jv(np.arange(top + 1)[:, None], z), rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize("top", [0, 1, 6, 40, 150])
def test_spherical_bessel_functions_are_scipy_s(top):
    z = np.array([complex(z, -loss) for z in ARGUMENTS[1:] if z <= top + 25 for loss in (0.0, 0.3)])
    j = bessel(z.reshape(2, -1), top, spherical=True)
    expected = spherical_jn(np.arange(top + 1)[:, None, None], z.reshape(2, -1))
    np.testing.assert_allclose(j, expected, rtol=1e-9, atol=1e-13)
