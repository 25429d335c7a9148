"""The field of a measured room: plane waves, exactly; files that are no response are refused."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from fdcal.acoustics.measure import measure
from fdcal.acoustics.plane_waves import MAX_FREQUENCY, plane_wave_pressures, plane_wave_responses
from fdcal.acoustics.spectrum import laplace_transform
from fdcal.model.room import response_folder, response_names, response_path
from fdcal.model.scene_file import load_scene
from fdcal.model.sdm_response import SdmResponse, load_sdm_response
from fdcal.model.validation import InputError, StorageError

C, FS = 343.0, 8000.0
PLACES = np.random.default_rng(0).uniform(-0.5, 0.5, (7, 3))
FREQUENCIES = np.array([37.0, 210.0, 640.0])


def waves(count: int, seed: int = 1) -> SdmResponse:
    """Waves from random directions, one each sample."""
    rng = np.random.default_rng(seed)
    directions = rng.standard_normal((count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return SdmResponse(rng.standard_normal(count), directions, np.arange(count) / FS, FS)


def test_one_plane_wave_has_one_magnitude_and_the_gradient_of_its_direction():
    wave = waves(1)
    p = plane_wave_pressures(wave, PLACES, FREQUENCIES, C)
    assert np.allclose(np.abs(p), np.abs(wave.amplitudes))
    h = 1e-4
    for axis, step in enumerate(h * np.eye(3)):
        there, back = (plane_wave_pressures(wave, PLACES + sign * step, FREQUENCIES, C) for sign in (1, -1))
        gradient = (there - back) / (2 * h)
        k = 2 * np.pi * FREQUENCIES / C
        assert np.allclose(gradient / p, 1j * k[:, None] * wave.directions[0, axis], rtol=1e-5, atol=1e-6)


def test_a_wave_reaches_the_side_that_it_comes_from_first():
    wave = SdmResponse(np.ones(1), np.array([[0.0, 1.0, 0.0]]), np.zeros(1), FS)
    towards, away = plane_wave_responses(wave, [[0.0, 0.4, 0.0], [0.0, -0.4, 0.0]], C)
    assert np.argmax(away) - np.argmax(towards) == pytest.approx(0.8 / C * FS, abs=1)


def test_the_field_solves_helmholtz_to_second_order():
    response = waves(40)

    def fault(h):
        p = plane_wave_pressures(response, PLACES, FREQUENCIES, C)
        sums = sum(
            plane_wave_pressures(response, PLACES + d, FREQUENCIES, C)
            for d in h * np.concatenate([np.eye(3), -np.eye(3)])
        )
        k = 2 * np.pi * FREQUENCIES[:, None] / C
        return np.linalg.norm((sums - 6 * p) / h**2 + k**2 * p)

    assert fault(0.02) / fault(0.01) == pytest.approx(4.0, rel=0.02)


def test_a_shift_of_the_origin_multiplies_each_wave_by_its_phase():
    response, shift = waves(40), np.array([0.3, -0.2, 0.5])
    moved = plane_wave_pressures(response, PLACES + shift, FREQUENCIES, C)
    delayed = dataclasses.replace(response, times=response.times - response.directions @ shift / C)
    assert np.allclose(moved, plane_wave_pressures(delayed, PLACES, FREQUENCIES, C))


def test_a_later_response_changes_the_phase_alone():
    response = waves(40)
    later = dataclasses.replace(response, times=response.times + 0.01)
    before, after = (plane_wave_pressures(each, PLACES, FREQUENCIES, C) for each in (response, later))
    assert np.allclose(after, before * np.exp(-2j * np.pi * FREQUENCIES * 0.01)[:, None])


@pytest.mark.parametrize(("share", "accuracy"), [(1 / 20, 1e-6), (MAX_FREQUENCY, 1e-2)])
def test_rendered_responses_have_the_pressures_as_their_transform(share, accuracy):
    response, f = waves(200), np.array([share * FS])
    expected = plane_wave_pressures(response, PLACES, f, C)
    found = laplace_transform(plane_wave_responses(response, PLACES, C), FS, 0.0, f)
    common = np.vdot(found, expected) / np.vdot(found, found)  # the responses begin at another time
    assert abs(common) == pytest.approx(1, abs=accuracy)
    assert np.linalg.norm(common * found - expected) < accuracy * np.linalg.norm(expected)


def test_the_time_before_a_rendered_response_is_a_whole_number_of_samples():
    """The same for all microphones: the reference at the origin begins at one sample."""
    rows = plane_wave_responses(waves(1), np.concatenate([PLACES, np.zeros((1, 3))]), C)
    assert np.count_nonzero(np.abs(rows[-1]) > 1e-12) == 1


def test_the_listening_lab_begins_with_its_direct_sound():
    assert "listening_lab" in response_names()
    path = response_path("listening_lab")
    response, stored = load_sdm_response(path), loadmat(path)["p"].ravel()
    assert np.allclose(np.linalg.norm(response.directions, axis=1), 1)
    assert np.array_equal(response.amplitudes, stored[-len(response.amplitudes) :])
    assert abs(response.amplitudes[0]) > 0.1 * np.abs(stored).max()
    assert response.times[0] == pytest.approx((6000 - len(response.amplitudes)) / 48000)


def test_the_licence_is_beside_the_response():
    notice = (response_folder() / "LICENSE.md").read_text(encoding="utf-8")
    assert "Chalmers University of Technology" in notice and "MIT License" in notice


def write(path, **changes):
    """A copy of the listening lab with other variables; None removes one."""
    table = {key: value for key, value in loadmat(response_path("listening_lab")).items() if key[0] != "_"}
    savemat(path, {key: value for key, value in (table | changes).items() if value is not None})
    return path


@pytest.mark.parametrize("samples", [-24, -100, -3000])
def test_a_response_that_wraps_round_is_refused(tmp_path, samples):
    rolled = {
        key: np.roll(loadmat(response_path("listening_lab"))[key], samples) for key in ("p", "azi_rad", "ele_rad")
    }
    with pytest.raises(InputError, match=r"wraps round.*shift it"):
        load_sdm_response(write(tmp_path / "wrapped.mat", **rolled))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"p": None}, 'no "p"'),
        ({"fs": None}, 'no "fs"'),
        ({"p": np.zeros(6000)}, "silent"),
        ({"p": np.full(6000, np.nan)}, "p.* is not a finite number"),
        ({"azi_rad": np.zeros(10)}, "azi_rad has 10 samples and p has 6000"),
        ({"fs": [48000.0, 44100.0]}, "no sampling rate"),
        ({"fs": 0.0}, "no sampling rate"),
        ({"fs": np.arange(6000.0)}, "no sampling rate"),
        ({"p": np.r_[np.zeros(5995), np.ones(5)]}, "wraps round"),
        ({"p": "loud"}, '"p" is no array of real numbers'),
    ],
)
def test_a_file_that_is_no_response_is_refused(tmp_path, changes, words):
    with pytest.raises(InputError) as caught:
        load_sdm_response(write(tmp_path / "bad.mat", **changes))
    assert re.search(words, str(caught.value)) and len(str(caught.value)) < 1000 + len(str(tmp_path))


def test_a_damaged_file_is_refused(tmp_path):
    path = tmp_path / "damaged.mat"
    path.write_bytes(response_path("listening_lab").read_bytes()[:5000])
    with pytest.raises(InputError, match=r"damaged\.mat"):
        load_sdm_response(path)
    path.write_bytes(b"no MATLAB file")
    with pytest.raises(InputError, match=r"damaged\.mat"):
        load_sdm_response(path)
    with pytest.raises(StorageError, match="cannot read"):
        load_sdm_response(tmp_path / "missing.mat")


def test_a_scene_in_a_measured_room_has_the_pressures_of_its_response():
    scene = load_scene("listening_lab")
    quiet = dataclasses.replace(scene, measurement=dataclasses.replace(scene.measurement, snr_db=np.inf))
    measurement, response = measure(quiet), load_sdm_response(response_path("listening_lab"))
    f = measurement.frequencies
    assert (len(f), measurement.count, measurement.dimension) == (95, 64, 3)
    assert np.allclose(np.diff(f), scene.measurement.resolution) and f[-1] <= scene.measurement.highest
    assert np.allclose(measurement.wavenumbers, 2 * np.pi * f / 343)
    expected = plane_wave_pressures(response, measurement.positions, f[::10], 343.0)
    assert np.allclose(measurement.pressures[::10], expected)
