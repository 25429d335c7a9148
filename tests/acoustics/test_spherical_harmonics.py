"""Laws of the spherical dictionary, in space and in a plane of it."""

import numpy as np
import pytest
from scipy.special import spherical_jn

from fdcal.acoustics.dictionary import degrees, fourier_bessel, max_order, spherical_bessel

CENTRE = np.array([2.1, 0.9, 1.2])
POINTS = np.random.default_rng(0).uniform(-0.5, 0.5, (40, 3)) + CENTRE + [0.1, -0.05, 0.02]
PLANE = POINTS[:, :2]
WAVENUMBERS = [0.5, 5.0, 7.3 - 0.02j]
DIRECTION = np.array([0.36, -0.48, 0.8])


def plane_wave(points, k, direction=DIRECTION):
    return np.exp(-1j * k * (points @ direction))


def plane_wave_coefficients(k, order, centre):
    """exp(-j k d.x) = 4 pi sum (-j)^l j_l(k r) Y_lm(x) conj(Y_lm(d)); W at d is sqrt(4 pi) j_l Y_lm(d)."""
    l, _ = degrees(order)  # noqa: E741
    Y = spherical_bessel(DIRECTION[None], 3.3, order, np.zeros(3))[0] / spherical_jn(l, 3.3)
    return (-1j) ** l * Y.conj() * plane_wave(centre, k)


@pytest.mark.parametrize("k", WAVENUMBERS)
def test_a_plane_wave_is_rayleighs_sum(k):
    W = spherical_bessel(POINTS, k, 22, CENTRE)
    np.testing.assert_allclose(W @ plane_wave_coefficients(k, 22, CENTRE), plane_wave(POINTS, k), atol=1e-12)


@pytest.mark.parametrize("k", WAVENUMBERS)
def test_each_atom_solves_helmholtz_to_second_order(k):
    """The error of the finite differences falls with the square of their step."""

    def fault(h):
        sums = -6 * spherical_bessel(POINTS, k, 5, CENTRE)
        for d in h * np.concatenate([np.eye(3), -np.eye(3)]):
            sums = sums + spherical_bessel(POINTS + d, k, 5, CENTRE)
        return np.abs(sums / h**2 + k**2 * spherical_bessel(POINTS, k, 5, CENTRE)).max(axis=0)

    coarse, fine = fault(0.1), fault(0.05)
    assert coarse.max() > 1e-4 * abs(k) ** 4, "nothing was measured"
    np.testing.assert_allclose(coarse / fine, 4.0, rtol=0.08)


def test_at_the_centre_all_functions_but_the_first_are_zero():
    W = spherical_bessel(CENTRE[None], 5.0 - 0.1j, 4, CENTRE)[0]
    np.testing.assert_allclose(W, np.eye(25)[0], atol=1e-15)


@pytest.mark.parametrize("centre", [CENTRE, CENTRE + [-0.2, 0.1, 0.25]], ids=["middle", "aside"])
@pytest.mark.parametrize("D", [2, 3])
def test_gram_matrix_is_the_diffuse_field_kernel_whatever_the_centre(centre, D):
    """The addition theorem: W W^H tends to sin(k d) / (k d) for real k, in space and on a plane."""
    points = POINTS[:, :D]
    W = spherical_bessel(points, 7.0, 26, centre[:D])
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    np.testing.assert_allclose(W @ W.conj().T, np.sinc(7.0 * distance / np.pi), atol=1e-12)


@pytest.mark.parametrize("k", WAVENUMBERS)
def test_on_a_plane_the_even_functions_are_all_there_is(k):
    flat = np.column_stack([PLANE, np.full(len(PLANE), CENTRE[2])])
    W = spherical_bessel(flat, k, 7, CENTRE)
    l, m = degrees(7)  # noqa: E741
    even = (l + m) % 2 == 0
    np.testing.assert_allclose(spherical_bessel(PLANE, k, 7, CENTRE[:2]), W[:, even], atol=1e-14)
    np.testing.assert_allclose(W[:, ~even], 0.0, atol=1e-14)
    np.testing.assert_array_equal(np.stack(degrees(7, planar=True)), np.stack([l, m])[:, even])


def test_planar_functions_span_the_field_on_a_plane_and_those_of_a_plate_do_not():
    k, R = 4.0, 0.8
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.5, 0.5, (300, 2))
    directions = rng.standard_normal((12, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    field = sum(plane_wave(np.column_stack([points, np.zeros(300)]), k, d) for d in directions)

    def left(W):
        return np.linalg.norm(field - W @ np.linalg.lstsq(W, field)[0]) / np.linalg.norm(field)

    L = int(max_order(k, R))
    errors = [left(spherical_bessel(points, k, L + more, (0.0, 0.0))) for more in (0, 2, 4, 6)]
    assert errors[0] < 0.05 and errors[-1] < 1e-6 and np.all(np.diff(np.log10(errors)) < -1)
    assert left(fourier_bessel(points, k, L + 8, (0.0, 0.0))) > 0.05


@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize("L", [0, 1, 5])
def test_number_of_functions(L, planar):
    l, m = degrees(L, planar)  # noqa: E741
    assert len(set(zip(l.tolist(), m.tolist(), strict=True))) == ((L + 1) * (L + 2) // 2 if planar else (L + 1) ** 2)
    assert l.max() == L and np.all(np.abs(m) <= l)
    W = spherical_bessel(POINTS[:, : 2 if planar else 3], 3.0, L, CENTRE[: 2 if planar else 3])
    assert W.shape == (40, len(l))
