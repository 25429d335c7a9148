"""Faults that a scene states are in its measurement, and only there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fdcal.acoustics.measure import cached_measurement
from fdcal.model.scene_file import load_scene
from fdcal.model.settings import Faults
from fdcal.model.validation import InputError


def test_faults_spoil_their_channels_alone():
    scene = load_scene("tiny")
    clean = cached_measurement(scene).pressures
    faulty = cached_measurement(replace(scene, faults=Faults((9,), (3,)))).pressures
    others = np.setdiff1d(np.arange(16), [3, 9])
    assert np.array_equal(faulty[:, others], clean[:, others])
    assert np.array_equal(faulty[:, 9], -clean[:, 9])
    share = np.mean(np.abs(faulty[:, 3]) ** 2) / np.mean(np.abs(clean[:, others]) ** 2)
    assert 0 < share < 1e-5


def test_gains_scatter_as_stated_and_are_drawn_by_the_seed():
    faults = Faults(gain_db=1.0, phase_deg=5.0)
    gains = faults.gains(4000, 3)
    assert np.std(20 * np.log10(np.abs(gains))) == pytest.approx(1.0, rel=0.05)
    assert np.std(np.degrees(np.angle(gains))) == pytest.approx(5.0, rel=0.05)
    assert np.array_equal(gains, faults.gains(4000, 3)) and not np.array_equal(gains, faults.gains(4000, 4))
    assert np.array_equal(Faults().gains(5, 0), np.ones(5))


@pytest.mark.parametrize(
    ("key", "value"),
    [("faults.dead", "[16]"), ("faults.inverted", "[-1]"), ("faults.gain_db", "-1.0"), ("faults.phase_deg", "nan")],
)
def test_faults_that_cannot_be_are_refused(edited, key, value):
    with pytest.raises(InputError, match=key):
        load_scene(edited({key: value}))


def test_a_channel_has_one_fault():
    with pytest.raises(InputError, match=r"faults\.dead both name microphone 3"):
        Faults(inverted=(3,), dead=(3,))
