"""The dictionaries in a plane and in space: Jacobi-Anger, Rayleigh, the diffuse kernel, and special functions."""

import dataclasses

import numpy as np
import pytest
from fields import plane_wave, plane_wave_coefficients
from running import refuses
from scipy.io import loadmat, savemat
from scipy.special import jv, spherical_jn

from fdcal.acoustics import dictionary, plane_waves
from fdcal.acoustics.measure import measure
from fdcal.acoustics.spectrum import laplace_transform
from fdcal.model.scene import load_scene, response_path
from fdcal.model.settings import Search

POINTS = np.random.default_rng(0).uniform(-0.5, 0.5, (40, 2)) + [2.0, 1.0]
CENTRE = np.array([2.1, 0.9])
WAVENUMBERS = [0.5, 5.0, 7.3 - 0.02j]


def test_order_and_highest_frequency_follow_eqs_3_and_9():
    """Section 5: 4950 Hz for array 1, R = 0.35 m, c = 340 m/s. In space the limit is one function per microphone."""
    np.testing.assert_array_equal(dictionary.max_order(np.array([0.5, 5.0, 5.01 - 2j]), 0.8), [1, 4, 5])
    assert dictionary.max_order(5.0, 0.8, offset=2) == 6
    assert dictionary.f_max(65, 0.35, 340.0) == pytest.approx(4950, rel=1e-3)
    assert dictionary.f_max(2, 0.35, 340.0) == pytest.approx(340 / (4 * np.pi * 0.35)), "also for few microphones"
    for order in (1, 3, 7):
        for count, planar in (((order + 1) ** 2, False), ((order + 1) * (order + 2) // 2, True)):
            f = dictionary.f_max(count, 0.7, 343.0, 3, planar=planar)
            assert 2 * np.pi * f / 343.0 * 0.7 == pytest.approx(order)
    square, radius = np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.4], [0.0, 0.4]]) + 3.0, 0.2 * np.sqrt(2)
    assert dictionary.array_f_max(square, 343.0, 2) == pytest.approx(dictionary.f_max(4, radius, 343.0))
    assert dictionary.array_f_max(square, 343.0, 3) == pytest.approx(dictionary.f_max(4, radius, 343.0, 3, planar=True))
    assert dictionary.array_f_max(np.ones((4, 2)), 343.0, 2) == np.inf


def test_lattice_table_is_the_dictionary_of_its_points():
    search, k = Search((1.5, 0.4), (1.0, 0.8), 0.1, 0.7), np.array([0.5, 6.0 - 0.05j])
    orders = dictionary.max_order(k, search.radius, 2)
    lattice = dictionary.LatticeDictionary(search, k, orders)
    assert lattice.points.shape == (11 * 9, 2)
    for centre in (lattice.points[0], lattice.nearest([2.03, 0.77]), lattice.points[-1]):
        mixed = np.concatenate([lattice.points[[3, 50]], [[1.77, 0.66], [0.0, 5.0]]])
        for points, modes, rtol in ((lattice.points, [0, 1], 1e-7), (mixed, [1, 0], 1e-10)):
            for m, W in zip(modes, lattice.dictionary(points, centre, modes), strict=True):
                expected = dictionary.fourier_bessel(points, k[m], orders[m], centre)
                np.testing.assert_allclose(W, expected, rtol=rtol, atol=1e-13)


CENTRE_3D = np.array([2.1, 0.9, 1.2])
POINTS_3D = np.random.default_rng(0).uniform(-0.5, 0.5, (40, 3)) + CENTRE_3D + [0.1, -0.05, 0.02]
PLANE = POINTS_3D[:, :2]
DIRECTION = np.array([0.36, -0.48, 0.8])


def plane_wave_3d(points, k):
    return np.exp(-1j * k * (points @ DIRECTION))


def plane_wave_coefficients_3d(k, order, centre):
    """exp(-j k d.x) = 4 pi sum (-j)^l j_l(k r) Y_lm(x) conj(Y_lm(d)); W at d is sqrt(4 pi) j_l Y_lm(d)."""
    l, _ = dictionary.degrees(order)  # noqa: E741
    Y = dictionary.spherical_bessel(DIRECTION[None], 3.3, order, np.zeros(3))[0] / spherical_jn(l, 3.3)
    return (-1j) ** l * Y.conj() * plane_wave_3d(centre, k)


@pytest.mark.parametrize("k", WAVENUMBERS)
def test_a_plane_wave_is_the_jacobi_anger_and_the_rayleigh_sum(k):
    W = dictionary.fourier_bessel(POINTS, k, 30, CENTRE)
    found = W @ plane_wave_coefficients(k, 0.7, 30, CENTRE)
    np.testing.assert_allclose(found, plane_wave(POINTS, k, 0.7), atol=1e-12)
    found = dictionary.spherical_bessel(POINTS_3D, k, 22, CENTRE_3D) @ plane_wave_coefficients_3d(k, 22, CENTRE_3D)
    np.testing.assert_allclose(found, plane_wave_3d(POINTS_3D, k), atol=1e-12)
    np.testing.assert_allclose(
        dictionary.spherical_bessel(CENTRE_3D[None], k, 4, CENTRE_3D)[0], np.eye(25)[0], atol=1e-15
    )


@pytest.mark.parametrize("k", WAVENUMBERS)
def test_on_a_plane_the_odd_functions_vanish(k):
    W = dictionary.spherical_bessel(np.column_stack([PLANE, np.full(len(PLANE), CENTRE_3D[2])]), k, 7, CENTRE_3D)
    l, m = dictionary.degrees(7)  # noqa: E741
    even = (l + m) % 2 == 0
    np.testing.assert_allclose(dictionary.spherical_bessel(PLANE, k, 7, CENTRE_3D[:2]), W[:, even], atol=1e-14)
    np.testing.assert_allclose(W[:, ~even], 0.0, atol=1e-14)
    np.testing.assert_array_equal(np.stack(dictionary.degrees(7, planar=True)), np.stack([l, m])[:, even])


ARGUMENTS = [0.0, 1e-9, 0.03, 0.1999, 0.2001, 1.0, 4.7, 23.0, 60.0]


def test_sine_over_z_and_its_slope_are_the_spherical_bessel_functions():
    z = np.concatenate([[0.0], np.geomspace(1e-9, 1e3, 4001), np.pi / 4 * np.arange(1, 400)])
    value, slope = dictionary.sinc(z)
    np.testing.assert_allclose(value, spherical_jn(0, z), rtol=0, atol=4e-15)
    np.testing.assert_allclose(slope * z, -spherical_jn(1, z), rtol=0, atol=2e-14)
    assert (value[0], slope[0]) == (1.0, pytest.approx(-1 / 3))
    assert dictionary.sinc(z[:6].reshape(2, 3))[1].shape == (2, 3)
    assert np.isnan(dictionary.sinc(np.array([np.nan, 1.0]))[0][0])


def test_sine_over_z_of_a_complex_square_does_not_depend_on_the_root():
    size = np.concatenate([np.geomspace(1e-5, 30, 301), np.linspace(0.0199, 0.0201, 21)])
    z = np.multiply.outer(size, np.exp(1j * np.linspace(-np.pi, np.pi, 17))).ravel()
    growth = np.exp(np.abs(z.imag))
    value, slope = dictionary.complex_sinc(z * z)
    assert np.max(np.abs(value - spherical_jn(0, z)) / growth) < 2e-14
    assert np.max(np.abs(slope * z + spherical_jn(1, z)) / growth) < 1e-12, "SciPy loses digits near 0"
    value, slope = dictionary.complex_sinc(np.array([0.0, -4.0]))
    assert value == pytest.approx([1.0, np.sinh(2) / 2]), "the square of a damped wave may be negative"
    assert slope == pytest.approx([-1 / 3, -(np.cosh(2) - np.sinh(2) / 2) / 4])


@pytest.mark.parametrize("spherical", [False, True])
@pytest.mark.parametrize("damping", [0.0, 0.3])
@pytest.mark.parametrize("top", [0, 1, 6, 40, 150])
def test_bessel_functions_of_all_orders_equal_those_of_scipy(spherical, damping, top):
    z = np.array([z for z in ARGUMENTS[spherical:] if z <= top + 25])  # the orders in use reach beyond the argument
    z = (z - 1j * damping if damping else z)[None]
    found, orders = dictionary.bessel(z, top, spherical=spherical), np.arange(top + 1)[:, None, None]
    assert found.dtype == z.dtype
    np.testing.assert_allclose(found, (spherical_jn if spherical else jv)(orders, z), rtol=1e-10, atol=1e-14)


# The field of a measured room is the sum of its plane waves; files that are not a response are refused.


C, FS = 343.0, 8000.0
PLACES = np.random.default_rng(0).uniform(-0.5, 0.5, (7, 3))
FREQUENCIES = np.array([37.0, 210.0, 640.0])


def waves(count: int, seed: int = 1) -> plane_waves.SdmResponse:
    """Return waves from random directions, one for each sample."""
    rng = np.random.default_rng(seed)
    directions = rng.standard_normal((count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return plane_waves.SdmResponse(rng.standard_normal(count), directions, np.arange(count) / FS, FS)


def test_a_wave_reaches_the_side_that_it_comes_from_first():
    wave = plane_waves.SdmResponse(np.ones(1), np.array([[0.0, 1.0, 0.0]]), np.zeros(1), FS)
    towards, away = plane_waves.plane_wave_responses(wave, [[0.0, 0.4, 0.0], [0.0, -0.4, 0.0]], C)
    assert np.argmax(away) - np.argmax(towards) == pytest.approx(0.8 / C * FS, abs=1)


def test_a_shift_of_the_origin_multiplies_each_wave_by_its_phase():
    response, shift = waves(40), np.array([0.3, -0.2, 0.5])
    moved = plane_waves.plane_wave_pressures(response, PLACES + shift, FREQUENCIES, C)
    delayed = dataclasses.replace(response, times=response.times - response.directions @ shift / C)
    assert np.allclose(moved, plane_waves.plane_wave_pressures(delayed, PLACES, FREQUENCIES, C))


@pytest.mark.parametrize(("share", "accuracy"), [(1 / 20, 1e-6), (plane_waves.MAX_FREQUENCY, 1e-2)])
def test_rendered_responses_have_the_pressures_as_their_transform(share, accuracy):
    response, f = waves(200), np.array([share * FS])
    expected = plane_waves.plane_wave_pressures(response, PLACES, f, C)
    found = laplace_transform(plane_waves.plane_wave_responses(response, PLACES, C), FS, 0.0, f)
    common = np.vdot(found, expected) / np.vdot(found, found)  # the responses begin at another time
    assert abs(common) == pytest.approx(1, abs=accuracy)
    assert np.linalg.norm(common * found - expected) < accuracy * np.linalg.norm(expected)


WHOLE = {key: value for key, value in loadmat(response_path("listening_lab")).items() if key[0] != "_"}
ROLLED = [{key: np.roll(WHOLE[key], n) for key in ("p", "azi_rad", "ele_rad")} for n in (-24, -3000)]


@pytest.mark.parametrize(("changes", "words"), [
    *((rolled, r"wraps round.*shift it") for rolled in ROLLED),
    *(({key: None}, f'no "{key}"') for key in ("p", "fs")), ({"p": np.zeros(6000)}, "silent"),
    ({"p": np.full(6000, np.nan)}, "p.* is not a finite number"),
    *(({key: [1.0, 2.0]}, f"{key} has shape .2,.") for key in ("fs", "azi_rad")),
    ({"fs": 0.0}, "fs = 0 Hz is out of range"), ({"p": "loud"}, "p has 1 samples; give 20"),
])  # fmt: skip
def test_a_file_that_is_not_a_response_is_refused(tmp_path, changes, words):
    savemat(tmp_path / "bad.mat", {key: value for key, value in (WHOLE | changes).items() if value is not None})
    assert len(str(refuses(words, plane_waves.load_sdm_response, tmp_path / "bad.mat"))) < 1000 + len(str(tmp_path))


def test_a_response_that_is_cut_off_or_missing_is_named(tmp_path):
    for content in (response_path("listening_lab").read_bytes()[:5000], b"no MATLAB file"):
        (tmp_path / "bad.mat").write_bytes(content)
        refuses(r"bad\.mat", plane_waves.load_sdm_response, tmp_path / "bad.mat")
    refuses(r"missing\.mat", plane_waves.load_sdm_response, tmp_path / "missing.mat")


def test_a_scene_in_a_measured_room_has_the_pressures_of_its_response():
    scene = load_scene("listening_lab")
    quiet = dataclasses.replace(scene, measurement=dataclasses.replace(scene.measurement, snr_db=np.inf))
    measurement, response = measure(quiet), plane_waves.load_sdm_response(response_path("listening_lab"))
    f = measurement.frequencies
    assert (len(f), measurement.count, measurement.dimension) == (95, 64, 3)
    assert np.allclose(np.diff(f), scene.measurement.resolution) and f[-1] <= scene.measurement.highest
    assert np.allclose(measurement.wavenumbers, 2 * np.pi * f / 343)
    expected = plane_waves.plane_wave_pressures(response, measurement.positions, f[::10], 343.0)
    assert np.allclose(measurement.pressures[::10], expected)


# A separate process reads damaged files of a response.


@pytest.fixture
def response_file(tmp_path):
    path, rng = tmp_path / "response.mat", np.random.default_rng(0)
    angles = {"azi_rad": rng.uniform(-3, 3, 200), "ele_rad": rng.uniform(-1.5, 1.5, 200)}
    savemat(path, {"p": rng.normal(size=200) * np.exp(-np.arange(200) / 20), **angles, "fs": 48000.0})
    return path


def test_an_element_of_an_unknown_type_is_refused(response_file, apart):
    """SciPy's compiled reader uses the type as an index, and some values crash its process."""
    data = bytearray(response_file.read_bytes())
    tag = data.index(b"azi_rad") + 8  # the values have this tag
    assert data[tag] == 9, "double"
    data[tag] = 255
    response_file.write_bytes(data)
    refuses(r"response\.mat", plane_waves.load_sdm_response, response_file)


def test_variables_of_any_kind_may_stand_beside_a_response(response_file):
    table = {key: value for key, value in loadmat(response_file).items() if key[0] != "_"}
    expected = plane_waves.load_sdm_response(response_file).amplitudes
    others = {"text": "a room", "list": np.array([1, "b"], dtype=object), "parts": {"a": 1.0}, "z": np.array([1j])}
    savemat(response_file, {**others, **table}, do_compression=True, oned_as="column")
    assert np.array_equal(plane_waves.load_sdm_response(response_file).amplitudes, expected)
    savemat(response_file, table | {"p": np.full(200, 1.0 + 1j)})
    refuses("p is complex", plane_waves.load_sdm_response, response_file)
