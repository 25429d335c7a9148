"""Measurements of arrays and of objects of pyfar; positions that somebody gives."""

from __future__ import annotations

import dataclasses

import numpy as np
import pyfar
import pytest

import fdcal
from fdcal.model.given_positions import MicrophonePositions, with_positions

RNG = np.random.default_rng(1)
FREQUENCIES = np.array([100.0, 150.0, 210.0])
PRESSURES = RNG.normal(size=(3, 5)) + 1j * RNG.normal(size=(3, 5))
POSITIONS = RNG.normal(size=(5, 3))


def test_arrays_are_taken_as_they_are():
    m = fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES, positions=POSITIONS, known=["1", 4], sound_speed=345.0)
    np.testing.assert_array_equal(m.pressures, PRESSURES)
    np.testing.assert_array_equal(m.known_positions, POSITIONS[[1, 4]])
    assert (m.dimension, m.array_dimension, m.sound_speed) == (3, 3, 345.0)
    assert len(fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES, known=None).known) == 0


def test_the_other_time_convention_is_conjugated():
    m = fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES, time_convention="exp(-jwt)")
    np.testing.assert_array_equal(m.pressures, PRESSURES.conj())
    with pytest.raises(fdcal.InputError, match="time_convention"):
        fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES, time_convention="exp(+iwt)")


def test_an_array_in_a_plane_of_a_room_is_told_by_its_coordinates():
    m = fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES, known={n: POSITIONS[n, :2] for n in (0, 2, 3)})
    assert (m.dimension, m.array_dimension) == (3, 2)


def test_known_positions_belong_to_their_names_in_any_order():
    names = list("abcde")
    m = fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES, names=names, known={"d": POSITIONS[3], "a": POSITIONS[0]})
    assert m.known.tolist() == [0, 3]
    np.testing.assert_array_equal(m.known_positions, POSITIONS[[0, 3]])
    with pytest.raises(fdcal.InputError, match="names no microphone"):
        fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES, names=names, known={"f": POSITIONS[0]})


def test_frequency_data_of_pyfar_are_taken_as_they_are():
    data = pyfar.FrequencyData(PRESSURES.T, FREQUENCIES)
    coordinates = pyfar.Coordinates(*POSITIONS.T)
    m = fdcal.Measurement.from_pyfar(data, coordinates, known=[0, 1, 2], sound_speed=340.0)
    np.testing.assert_array_equal(m.pressures, PRESSURES)
    np.testing.assert_array_equal(m.frequencies, FREQUENCIES)
    np.testing.assert_allclose(m.positions, POSITIONS, atol=1e-12)
    assert m.sound_speed == 340.0


def test_a_signal_of_pyfar_is_imported_as_a_recording_is(tmp_path):
    rate, t = 2000, np.arange(4000) / 2000
    tones = np.array([60.0, 101.0, 143.0, 187.0])
    ringing = RNG.normal(size=(6, 4)) @ (np.exp(-6 * t) * np.cos(2 * np.pi * tones[:, None] * t))
    m = fdcal.Measurement.from_pyfar(pyfar.Signal(ringing, rate), array_radius=0.3, kind="impulse")
    assert m.count == 6
    for tone in tones:
        assert np.abs(m.frequencies - tone).min() < 2

    import soundfile

    soundfile.write(tmp_path / "r.wav", ringing.T / 10, rate, subtype="DOUBLE")
    recorded = fdcal.load(tmp_path / "r.wav", array_radius=0.3, kind="impulse")
    np.testing.assert_allclose(recorded.frequencies, m.frequencies)
    np.testing.assert_allclose(10 * recorded.pressures, m.pressures, rtol=1e-6)


def test_another_object_is_refused():
    with pytest.raises(fdcal.InputError, match="FrequencyData"):
        fdcal.Measurement.from_pyfar(PRESSURES)


NAMED = fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES, names=list("abcde"))
NUMBERED = fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES)


def test_positions_are_found_by_name_whatever_their_order():
    placed = MicrophonePositions(tuple("xedcba"), np.vstack([[9.0, 9, 9], POSITIONS[::-1]]))
    np.testing.assert_array_equal(with_positions(NAMED, placed).positions, POSITIONS)


def test_with_other_names_the_order_counts():
    placed = MicrophonePositions(tuple(f"Point {n}" for n in range(5)), POSITIONS)
    np.testing.assert_array_equal(with_positions(NUMBERED, placed).positions, POSITIONS)


def test_channels_left_out_keep_their_rows():
    kept = fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES[:, [0, 2, 4]], names=["0", "2", "4"])
    placed = MicrophonePositions(tuple(f"Point {n}" for n in range(5)), POSITIONS)
    np.testing.assert_array_equal(with_positions(kept, placed, excluded=2).positions, POSITIONS[[0, 2, 4]])


def test_another_number_of_positions_is_refused():
    placed = MicrophonePositions(tuple(f"Point {n}" for n in range(6)), np.vstack([POSITIONS, POSITIONS[:1] + 1]))
    for measurement in (NAMED, NUMBERED):
        with pytest.raises(fdcal.InputError, match="6 positions are given for 5 microphones"):
            with_positions(measurement, placed)


def test_heights_are_refused_for_an_array_in_the_plane():
    flat = fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES, dimension=2)
    placed = MicrophonePositions(tuple("01234"), POSITIONS)
    with pytest.raises(fdcal.InputError, match="heights"):
        with_positions(flat, placed)
    level = MicrophonePositions(tuple("01234"), np.column_stack([POSITIONS[:, :2], np.full(5, 1.2)]))
    np.testing.assert_array_equal(with_positions(flat, level).positions, POSITIONS[:, :2])


def test_joined_takes_keep_their_spectra():
    f = [np.linspace(90, 220, count) for count in (14, 27)]
    plain = fdcal.Measurement.from_arrays(FREQUENCIES, PRESSURES, sound_speed=343.0)
    spectra = [np.stack([axis, level * axis]) for axis, level in zip(f, (1, 2), strict=True)]
    each = [dataclasses.replace(plain, spectrum=spectrum) for spectrum in spectra]
    joined = fdcal.Measurement.from_takes(each)
    assert joined.spectrum.shape == (3, 27), "over the frequencies of the finest"
    for number, level in enumerate((1, 2)):
        axis, power = joined.of_take(number).spectrum
        np.testing.assert_allclose(power, level * axis)
    assert fdcal.Measurement.from_takes([each[0], plain]).spectrum is None
    with pytest.raises(fdcal.InputError, match="spectrum has 4 rows"):
        dataclasses.replace(joined, spectrum=np.ones((4, 5)) * np.arange(5))
