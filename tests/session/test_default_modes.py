"""Modes that the array found cannot interpolate are left out where their number was left open, and that is said."""

from __future__ import annotations

import numpy as np
import pytest

import fdcal
from fdcal.acoustics.dictionary import array_f_max
from fdcal.model.measurement import Measurement

SPEED, COUNT, WAVES = 343.0, 16, 200


@pytest.fixture(scope="module")
def wide() -> Measurement:
    """A ball of microphones in a diffuse field at frequencies up to a tenth above f_max of Eq. 9, SNR 50 dB."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(COUNT, 3))
    points *= (0.3 * rng.uniform(0.3, 1, COUNT) ** (1 / 3) / np.linalg.norm(points, axis=1))[:, None]
    f = np.linspace(150, 1.1 * array_f_max(points, SPEED, 3), 60)
    directions = rng.normal(size=(len(f), WAVES, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    amplitudes = rng.normal(size=(len(f), WAVES)) + 1j * rng.normal(size=(len(f), WAVES))
    phases = 2 * np.pi * f[:, None, None] / SPEED * (directions @ points.T)
    pressures = np.einsum("mw,mwn->mn", amplitudes, np.exp(1j * phases))
    noise = rng.normal(size=pressures.shape) + 1j * rng.normal(size=pressures.shape)
    return Measurement(
        frequencies=f,
        pressures=pressures + 10 ** (-50 / 20) * np.sqrt(np.mean(np.abs(pressures) ** 2) / 2) * noise,
        sound_speed=SPEED,
        dimension=3,
        array_dimension=3,
        positions=points,
        known=[0, 1, 2, 3, 4],
        known_positions=points[:5],
    )


def test_modes_that_the_array_found_cannot_interpolate_are_left_out_with_a_remark(wide):
    found = fdcal.calibrate(wide)
    assert found.verdict in ("good", "ambiguous") and found.rms_error is not None and found.rms_error < 0.01
    assert len(found.frequencies) < 60 and found.frequencies[-1] < array_f_max(wide.positions, SPEED, 3)
    assert f"{60 - len(found.frequencies)} modes above" in found.verdict_text and "Eq. 9" in found.verdict_text


def test_a_number_of_modes_that_was_asked_for_is_kept(wide):
    found = fdcal.calibrate(wide, modes=60)
    assert (len(found.frequencies), found.verdict) == (60, "undersampled")
