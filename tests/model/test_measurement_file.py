"""The .npz file of a measurement: it survives the round trip, and anything else is refused."""

from __future__ import annotations

import numpy as np
import pytest
from fields import measured

from fdcal.model.measurement_file import REQUIRED, load_measurement, save_measurement
from fdcal.model.validation import InputError

POSITIONS = np.array([[2.2, 2.0], [2.9, 1.9], [2.5, 2.6], [2.7, 2.3], [2.4, 2.2]])


@pytest.fixture
def written(tmp_path):
    """Function that writes a measurement of five microphones with some keys changed, None taking one out."""

    def write(**changes):
        path = tmp_path / "measured.npz"
        save_measurement(measured(POSITIONS, (0, 1, 2), highest=100.0), path)
        with np.load(path) as archive:
            table = {**archive, **changes}
        np.savez(path, **{key: value for key, value in table.items() if value is not None})
        return path

    return write


def test_a_measurement_survives_the_round_trip(written):
    given, back = measured(POSITIONS, (0, 1, 2), highest=100.0), load_measurement(written())
    for name in ("frequencies", "pressures", "wavenumbers", "positions", "known", "known_positions"):
        assert np.array_equal(getattr(given, name), getattr(back, name))
        assert getattr(given, name).dtype == getattr(back, name).dtype
    assert (given.search, given.names, given.sound_speed) == (back.search, back.names, back.sound_speed)


def test_a_spectrum_comes_back_and_a_wrong_one_is_refused(written):
    spectrum = np.array([[10.0, 20.0, 30.0], [1.0, 4.0, 2.0]])
    assert np.array_equal(load_measurement(written(spectrum=spectrum)).spectrum, spectrum)
    assert load_measurement(written()).spectrum is None
    for wrong in (spectrum[:, ::-1], -spectrum, spectrum[:1], spectrum[:, :1], spectrum * np.nan):
        with pytest.raises(InputError, match="spectrum"):
            load_measurement(written(spectrum=wrong))


def test_known_microphones_in_any_order_keep_their_positions(written):
    back = load_measurement(written(known=[2, 0, 1], known_positions=POSITIONS[[2, 0, 1]]))
    assert back.known.tolist() == [0, 1, 2]
    assert np.array_equal(back.known_positions, POSITIONS[:3])


@pytest.mark.parametrize("key", REQUIRED)
def test_a_required_key_is_asked_for(written, key):
    with pytest.raises(InputError, match=rf'has no "{key}"; a measurement needs'):
        load_measurement(written(**{key: None}))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"known": [0.9, 1.0, 2.7]}, ["known is real (float64)", "whole numbers"]),
        ({"known": [True, False, True]}, ["known is true or false", "whole numbers"]),
        ({"known": [[0, 1, 2]]}, ["known has shape (1, 3)", "(any,)"]),
        ({"known": [0, 1, 2, 3, 4], "known_positions": POSITIONS}, ["known", "leaves no microphone to be found"]),
        ({"known": [0, 1, 1]}, ["known = [0, 1, 1]", "at most once"]),
        ({"known_positions": POSITIONS[:3] + 1j}, ["known_positions is complex", "real numbers"]),
        ({"known_positions": POSITIONS[:3, None]}, ["known_positions has shape (3, 1, 2)", "(3, 2)"]),
        ({"known_positions": POSITIONS[:2]}, ["known_positions has shape (2, 2)", "(3, 2)"]),
        ({"known_positions": None, "positions": None}, ["known_positions is missing"]),
        ({"positions": POSITIONS.astype(str)}, ["positions is text", "real numbers"]),
        ({"positions": POSITIONS * np.inf}, ["positions[0, 0] is not a finite number"]),
        ({"frequencies": np.array([30j, 40j])}, ["frequencies is complex", "real numbers"]),
        ({"pressures": np.array([[True, False]])}, ["pressures is true or false", "complex numbers"]),
        ({"pressures": np.array([[1 + 0j, 2]])}, ["pressures has shape (1, 2)", "complex numbers"]),
        ({"sound_speed": [343.0]}, ["sound_speed has shape (1,)", "one of real numbers"]),
        ({"sound_speed": -343.0}, ["sound_speed = -343 m/s", "above zero"]),
        ({"dimension": 2.5}, ["dimension is real", "whole numbers"]),
        ({"array_dimension": 0}, ["array_dimension", "0"]),
        ({"names": np.arange(5)}, ["names is int64", "texts"]),
        ({"names": ["a", "b", "c", "d", "d"]}, ["names must be 5 different texts"]),
        ({"noise_power": [1.0]}, ["noise_power has shape (1,)"]),
        ({"search_step": 0.01 + 1j}, ["search_step is complex", "real numbers"]),
        ({"search_origin": [[0.0, 0.0]]}, ["search_origin has shape (1, 2)"]),
        ({"radius": "wide"}, ["radius is text"]),
        ({"known": np.array([None, 1])}, ['"known" is damaged or not a plain array']),
    ],
)
def test_a_value_of_another_kind_is_refused_with_its_key(written, changes, words):
    with pytest.raises(InputError) as caught:
        load_measurement(written(**changes))
    for word in words:
        assert word in str(caught.value)


def test_the_other_time_sign_is_refused(written):
    with np.load(written()) as archive:
        other = archive["wavenumbers"].conj()
    with pytest.raises(InputError, match=r"wavenumbers\[0\].*exp\(\+j w t\).*conjugate"):
        load_measurement(written(wavenumbers=other))
    assert load_measurement(written(wavenumbers=other.real)).wavenumbers.dtype == complex


def test_unknown_keys_are_ignored(written):
    load_measurement(written(remark=np.array([None])))
