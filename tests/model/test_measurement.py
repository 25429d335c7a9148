"""A measurement: what a solver sees of it, in any unit of pressure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fields import measured

from fdcal.model.measurement import Measurement
from fdcal.model.validation import InputError

POSITIONS = np.array([[2.2, 2.0], [2.9, 1.9], [2.5, 2.6], [2.7, 2.3], [2.4, 2.2]])


@pytest.mark.parametrize("exponent", [-1000, -600, 0, 600, 1000])
def test_unit_modes_do_not_depend_on_the_unit(exponent):
    measurement = measured(POSITIONS, (0, 1, 2), highest=100.0)
    scaled = replace(measurement, pressures=measurement.pressures * 2.0**exponent)
    pressures = scaled.problem().pressures
    assert np.array_equal(pressures, measurement.problem().pressures)
    assert np.allclose(np.mean(np.abs(pressures) ** 2, axis=1), 1)


def test_noise_follows_the_unit():
    measurement = measured(POSITIONS, (0, 1, 2), highest=100.0, snr_db=20.0)
    scaled = replace(measurement, pressures=measurement.pressures * 8, noise_power=measurement.noise_power * 64)
    assert np.array_equal(scaled.problem().noise_power, measurement.problem().noise_power)
    raw = measurement.problem("raw")
    assert np.array_equal(raw.pressures, measurement.pressures)
    assert np.array_equal(raw.noise_power, measurement.noise_power)


@pytest.mark.parametrize("factor", [1e-200, 1e200])
def test_raw_pressures_beyond_floats_are_refused(factor):
    measurement = measured(POSITIONS, (0, 1, 2), highest=100.0)
    with pytest.raises(InputError, match='weights = "raw"; use another unit'):
        replace(measurement, pressures=measurement.pressures * factor).problem("raw")


def test_derived_wavenumbers_follow_the_sound_speed_and_the_frequencies():
    pressures = np.exp(1j * np.arange(12.0)).reshape(3, 4)
    one = Measurement([100.0, 150.0, 210.0], pressures, sound_speed=343.0)
    other = replace(replace(one, sound_speed=1500.0), frequencies=[110.0, 160.0, 220.0])
    np.testing.assert_allclose(other.wavenumbers, 2 * np.pi * other.frequencies / 1500)
    np.testing.assert_allclose(one.wavenumbers, 2 * np.pi * one.frequencies / 343)


def test_given_wavenumbers_do_not_stay_behind_when_the_sound_speed_changes():
    """Positions follow from wavenumbers alone: those of the old sound speed give an array of the old size."""
    measurement = measured(POSITIONS, (0, 1, 2), highest=100.0)
    k, c = measurement.wavenumbers, 1.01 * measurement.sound_speed
    given = replace(measurement, wavenumbers=k * 1.0)
    with pytest.raises(InputError, match="give wavenumbers, too") as caught:
        replace(given, sound_speed=c)
    assert caught.value.key == "wavenumbers"
    assert np.array_equal(replace(given, sound_speed=c, wavenumbers=k / 1.01).wavenumbers, k / 1.01)
    assert np.array_equal(replace(given, sound_speed=c, wavenumbers=k.copy()).wavenumbers, k)
    np.testing.assert_allclose(
        replace(given, sound_speed=c, wavenumbers=None).wavenumbers, 2 * np.pi * given.frequencies / c
    )
    assert np.array_equal(replace(given, known=[0, 1, 2]).wavenumbers, k)
