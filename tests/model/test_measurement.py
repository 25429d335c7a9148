"""A measurement: the part that a solver sees, its file, and measurements made of arrays."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from fields import measured
from running import refuses

import fdcal
from fdcal.model import measurement as model
from fdcal.model.validation import InputError

SPECTRUM = np.array([[10.0, 20.0, 30.0], [1.0, 4.0, 2.0]])
POSITIONS = np.array([[2.2, 2.0], [2.9, 1.9], [2.5, 2.6], [2.7, 2.3], [2.4, 2.2]])


@pytest.mark.parametrize("exponent", [-1000, -600, 0, 600, 1000])
def test_unit_modes_do_not_depend_on_the_unit(exponent):
    measurement = measured(POSITIONS, (0, 1, 2), highest=100.0)
    pressures = replace(measurement, pressures=measurement.pressures * 2.0**exponent).problem().pressures
    assert np.array_equal(pressures, measurement.problem().pressures)
    assert np.allclose(np.mean(np.abs(pressures) ** 2, axis=1), 1)


def test_noise_follows_the_unit():
    measurement = measured(POSITIONS, (0, 1, 2), highest=100.0, snr_db=20.0)
    scaled = replace(measurement, pressures=measurement.pressures * 8, noise_power=measurement.noise_power * 64)
    assert np.array_equal(scaled.problem().noise_power, measurement.problem().noise_power)
    for factor in (1e-200, 1e200):
        with pytest.raises(InputError, match='weights = "raw"; use another unit'):
            replace(measurement, pressures=measurement.pressures * factor, noise_power=None).problem("raw")
    raw = measurement.problem("raw")
    assert np.array_equal(raw.pressures, measurement.pressures)
    assert np.array_equal(raw.noise_power, measurement.noise_power)


def test_wavenumbers_follow_sound_speed_and_frequencies_and_given_ones_must_be_replaced():
    """Positions follow from wavenumbers only, so that the old wavenumbers would give an array of the old size."""
    measurement = measured(POSITIONS, (0, 1, 2), highest=100.0)
    k, c = measurement.wavenumbers, 1.01 * measurement.sound_speed
    given = replace(measurement, wavenumbers=k * 1.0)
    assert refuses("give wavenumbers, too", replace, given, sound_speed=c).key == "wavenumbers"
    assert np.array_equal(replace(given, sound_speed=c, wavenumbers=k / 1.01).wavenumbers, k / 1.01)
    assert np.array_equal(replace(given, sound_speed=c, wavenumbers=k.copy()).wavenumbers, k)
    derived = replace(given, sound_speed=c, wavenumbers=None)
    for one in (derived, replace(replace(derived, sound_speed=1500.0), frequencies=1.1 * given.frequencies)):
        np.testing.assert_allclose(one.wavenumbers, 2 * np.pi * one.frequencies / one.sound_speed)
    assert np.array_equal(replace(given, known=[0, 1, 2]).wavenumbers, k)


# The .npz file of a measurement: it survives the round trip, and anything else is refused.


@pytest.fixture
def written(tmp_path):
    """Function that writes a measurement of five microphones with some keys changed; None removes a key."""

    def write(**changes):
        path = tmp_path / "measured.npz"
        model.save_measurement(measured(POSITIONS, (0, 1, 2), highest=100.0), path)
        with np.load(path) as archive:
            table = {**archive, **changes}
        np.savez(path, **{key: value for key, value in table.items() if value is not None})
        return path

    return write


def test_a_measurement_survives_the_round_trip(written):
    given, back = measured(POSITIONS, (0, 1, 2), highest=100.0), model.load_measurement(written())
    for name in ("frequencies", "pressures", "wavenumbers", "positions", "known", "known_positions"):
        assert np.array_equal(getattr(given, name), getattr(back, name))
        assert getattr(given, name).dtype == getattr(back, name).dtype
    assert (given.search, given.names, given.sound_speed) == (back.search, back.names, back.sound_speed)
    assert model.load_measurement(written(remark=np.array([None]))).spectrum is None  # an unknown key is ignored
    back = model.load_measurement(written(known=[2, 0, 1], known_positions=POSITIONS[[2, 0, 1]]))
    assert back.known.tolist() == [0, 1, 2] and np.array_equal(back.known_positions, POSITIONS[:3]), "in any order"
    assert np.array_equal(model.load_measurement(written(spectrum=SPECTRUM)).spectrum, SPECTRUM)


@pytest.mark.parametrize("key", model.REQUIRED)
def test_a_missing_required_key_is_named(written, key):
    refuses(rf'has no "{key}"; a measurement needs', lambda: model.load_measurement(written(**{key: None})))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"known": [0.9, 1.0, 2.7]}, ["known is real (float64)", "whole numbers"]),
        ({"known": [True, False, True]}, ["known is true or false", "whole numbers"]),
        ({"pressures": np.array([[True, False]])}, ["pressures is true or false", "complex numbers"]),
        ({"names": np.arange(5)}, ["names is int64", "texts"]),
        ({"known": [0, 1, 2, 3, 4], "known_positions": POSITIONS}, ["known", "none is left to be found"]),
        ({"known": [0, 1, 1]}, ["known = [0, 1, 1]", "at most once"]),
        ({"known_positions": POSITIONS[:2]}, ["known_positions has shape (2, 2)", "(3, 2)"]),
        ({"known_positions": None, "positions": None}, ["known_positions is missing"]),
        ({"sound_speed": -343.0}, ["sound_speed = -343 m/s", "above zero"]),
        ({"dimension": 2.5}, ['dimension = "2.5" is unknown', "use one of 2, 3"]),
        ({"array_dimension": 0}, ["array_dimension", "0"]),
        ({"names": ["a", "b", "c", "d", "d"]}, ["names must be 5 different texts"]),
        ({"search_step": 0.01 + 1j}, ["search_step is complex", "real numbers"]),
        ({"known": np.array([None, 1])}, ['"known" is damaged or not a plain array']),
        *(
            ({"spectrum": wrong}, ["spectrum"])
            for wrong in (SPECTRUM[:, ::-1], -SPECTRUM, SPECTRUM[:1], SPECTRUM[:, :1], SPECTRUM * np.nan)
        ),
        ({"version": 2}, ["is not of version 1; write it again"]),
    ],
)
def test_a_value_of_another_kind_is_refused_with_its_key(written, changes, words):
    with pytest.raises(InputError) as caught:
        model.load_measurement(written(**changes))
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize("changes", [{"known_positions": POSITIONS[:2]}, {"known": [0, 99, 2]}, {"names": ["a"]}])
def test_a_value_that_does_not_fit_is_refused_where_a_microphone_is_left_out(written, changes):
    refuses(next(iter(changes)), lambda: model.load_measurement(written(**changes), ["3"]))


def test_the_other_time_sign_is_refused(written):
    with np.load(written()) as archive:
        other = archive["wavenumbers"].conj()
    refuses(r"wavenumbers\[0\].*exp\(\+j w t\).*conjugate", lambda: model.load_measurement(written(wavenumbers=other)))
    assert model.load_measurement(written(wavenumbers=other.real)).wavenumbers.dtype == complex


# Measurements are made from arrays, and positions are added to them.


RNG = np.random.default_rng(1)
FREQUENCIES = np.array([100.0, 150.0, 210.0])
PRESSURES = RNG.normal(size=(3, 5)) + 1j * RNG.normal(size=(3, 5))
PLACES = RNG.normal(size=(5, 3))


def test_arrays_are_taken_as_they_are():
    m = fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES, positions=PLACES, known=["1", 4], sound_speed=345.0)
    np.testing.assert_array_equal(m.pressures, PRESSURES)
    np.testing.assert_array_equal(m.known_positions, PLACES[[1, 4]])
    assert (m.dimension, m.array_dimension, m.sound_speed) == (3, 3, 345.0)
    from_arrays = partial(fdcal.Measurement.from_arrays, FREQUENCIES, PRESSURES)
    assert len(from_arrays(known=None).known) == 0
    np.testing.assert_array_equal(from_arrays(time_convention="exp(-jwt)").pressures, PRESSURES.conj())
    flat = from_arrays(known={n: PLACES[n, :2] for n in (0, 2, 3)})
    assert (flat.dimension, flat.array_dimension) == (3, 2), "an array in a plane of a room, by its coordinates"
    named = from_arrays(names=list("abcde"), known={"d": PLACES[3], "a": PLACES[0]})
    assert named.known.tolist() == [0, 3] and np.array_equal(named.known_positions, PLACES[[0, 3]])
    refuses("pressures has rows of different lengths", fdcal.Measurement.from_arrays, [100, 150], [[1j, 2], [3]])
    for wrong, words in (
        ({"time_convention": "exp(+iwt)"}, "time_convention"),
        ({"positions": [[0, 0], [1]]}, "different lengths"),
        ({"known": {"0": (0, 0, 0), "1": (1, 0)}}, "known has shape"),
        ({"names": list("abcde"), "known": {"f": PLACES[0]}}, "is not the name of a microphone"),
    ):
        refuses(words, from_arrays, **wrong)


NAMED = fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES, names=list("abcde"))
NUMBERED = fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES)


def test_positions_are_found_by_name_or_in_their_order_and_are_as_many_as_the_microphones():
    reversed_names = model.MicrophonePositions(tuple("xedcba"), np.vstack([[9.0, 9, 9], PLACES[::-1]]))
    numbered = model.MicrophonePositions(tuple(f"Point {n}" for n in range(5)), PLACES)
    one_more = model.MicrophonePositions(tuple(f"Point {n}" for n in range(6)), np.vstack([PLACES, PLACES[:1] + 1]))
    kept = fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES[:, [0, 2, 4]], names=["0", "2", "4"])
    np.testing.assert_array_equal(model.with_positions(NAMED, reversed_names).positions, PLACES)
    np.testing.assert_array_equal(model.with_positions(NUMBERED, numbered).positions, PLACES)
    np.testing.assert_array_equal(model.with_positions(kept, numbered, "13").positions, PLACES[[0, 2, 4]])
    rest = fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES[:, 1:], names=list("1234"))
    from_one = model.MicrophonePositions(tuple("12345"), PLACES)  # its row "1" is that of channel 0, which is left out
    np.testing.assert_array_equal(model.with_positions(rest, from_one, "0").positions, PLACES[1:])
    for measurement in (NAMED, NUMBERED):
        refuses("6 positions are given for 5 microphones", model.with_positions, measurement, one_more)
    flat = fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES, dimension=2)
    refuses("but z differs", lambda: model.with_positions(flat, model.MicrophonePositions(tuple("01234"), PLACES)))
    level = model.MicrophonePositions(tuple("01234"), np.column_stack([PLACES[:, :2], np.full(5, 1.2)]))
    np.testing.assert_array_equal(model.with_positions(flat, level).positions, PLACES[:, :2])


def test_joined_takes_keep_their_spectra_and_their_wavenumbers_follow_the_sound_speed():
    plain = fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES, sound_speed=343.0)
    spectra = [np.stack([axis := np.linspace(90, 220, count), level * axis]) for count, level in ((14, 1), (27, 2))]
    each = [replace(plain, pressures=np.roll(PRESSURES, n, axis=1), spectrum=s) for n, s in enumerate(spectra, 1)]
    joined = fdcal.Measurement.from_takes(each)
    assert joined.spectrum.shape == (3, 27), "on the finest frequency grid"
    for level, one in enumerate((joined.of_take(0), joined.of_take(1)), 1):
        np.testing.assert_allclose(one.spectrum[1], level * one.spectrum[0])
        np.testing.assert_allclose(replace(one, sound_speed=350.0).wavenumbers, 2 * np.pi * one.frequencies / 350.0)
    assert fdcal.Measurement.from_takes([each[0], plain]).spectrum is None
    refuses("spectrum needs ascending", lambda: replace(joined, spectrum=np.ones((4, 5)) * np.arange(5)))
