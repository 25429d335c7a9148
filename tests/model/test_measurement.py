"""A measurement: what a solver sees of it, in any unit of pressure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fields import measured

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
