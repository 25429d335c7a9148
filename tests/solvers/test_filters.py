"""Delays and high-passes of all channels: they are found, and cost nothing where there are none."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fields import rigid_room, room_frequencies
from solving import rms, solved

from fdcal.model.measurement import Measurement

SIZE, SOURCE, SPEED = (5.2, 4.1), (4.8, 3.7), 343.0  # metres, metres, m/s
COUNT, MODES, KNOWN = 24, 40, np.array([0, 5, 11, 17])
FREE = np.setdiff1d(np.arange(COUNT), KNOWN)
CORNER_TO_HZ = SPEED / (2 * np.pi)


def measured(delays: Any = 0.0, corners=None, lowest=0, count=MODES) -> Measurement:
    """A measurement in a rigid room at 50 dB by channels with delays, s, and first-order high-passes, Hz."""
    rng = np.random.default_rng(4)
    radius, angle = 0.5 * np.sqrt(rng.random(COUNT)), 2 * np.pi * rng.random(COUNT)
    x = np.array([1.7, 1.5]) + np.c_[radius * np.cos(angle), radius * np.sin(angle)]
    f = np.array(room_frequencies(500.0, size=SIZE))[lowest : lowest + count]
    k = 2 * np.pi * f / SPEED - 0.02j
    p = rigid_room(x, SOURCE, k, SIZE) * np.exp(-2j * np.pi * np.outer(f, delays * np.ones(COUNT)))
    p = p if corners is None else p / (1 - 1j * corners / f[:, None])
    p = p / np.sqrt(np.mean(np.abs(p) ** 2, axis=1))[:, None]
    noise = rng.normal(size=(2, *p.shape)) * np.sqrt(1e-5 / 2)
    return Measurement(
        frequencies=f,
        pressures=p + noise[0] + 1j * noise[1],
        sound_speed=SPEED,
        positions=x,
        known=KNOWN,
        known_positions=x[KNOWN],
        wavenumbers=k,
    )


def drawn() -> tuple[np.ndarray, np.ndarray]:
    """Delays of 0.05 ms (standard deviation) and corners of 20 to 60 Hz."""
    rng = np.random.default_rng(7)
    return 5e-5 * rng.standard_normal(COUNT), rng.uniform(20, 60, COUNT)


@pytest.fixture(scope="module")
def matched():
    return solved(measured())


def test_matched_channels_have_no_filters_and_lose_nothing(matched):
    model, fixed = matched.state.model, solved(measured(), gains="fixed")
    assert not np.any(model.filters) and model.delay_sigma == model.corner_sigma == 0
    truth = measured().positions
    errors = [rms(end.assessment.positions, truth, FREE) for end in (matched, fixed)]
    assert errors[0] < 1.3 * errors[1] + 5e-4


@pytest.mark.parametrize("which", ["corners", "both"])
def test_filters_of_all_channels_come_back_and_the_positions_are_as_exact_as_without(matched, which):
    delays, corners = drawn()
    delays = delays if which != "corners" else 0 * delays
    end = solved(measured(delays, corners if which != "delays" else None))
    truth = measured().positions
    assert rms(end.assessment.positions, truth, FREE) < 1.5 * rms(matched.assessment.positions, truth, FREE) + 5e-4
    assert end.assessment.verdict == "good" and not end.faulty
    found, sigma = end.estimate.channels.filters, end.estimate.channels.filter_sigma
    error = found[:, 0] - SPEED * delays
    error = error - np.median(error)  # a delay that all share belongs to the source
    assert np.mean(np.abs(error) < 3 * sigma[:, 0] + 2e-4) > 0.9
    if which != "delays":  # a corner that all share is hardly seen
        error = found[:, 1] - corners / CORNER_TO_HZ
        error = error - np.median(error)
        assert np.mean(np.abs(error) < 3 * sigma[:, 1] + 0.02) > 0.9


def test_a_narrow_band_does_not_take_a_phase_for_a_delay():
    """Phases of the channels over less than an octave: whatever they are called, the positions stay."""
    plain = measured(lowest=24, count=16)
    phases = 0.1 * np.random.default_rng(3).standard_normal(COUNT)
    turned = solved(replace(plain, pressures=plain.pressures * np.exp(1j * phases)))
    errors = [rms(end.assessment.positions, plain.positions, FREE) for end in (turned, solved(plain))]
    assert errors[0] < 1.5 * errors[1] + 1e-3


def test_matched_by_statement_channels_keep_no_filters():
    delays, corners = drawn()
    model = solved(measured(delays, corners), gains="fixed").state.model
    assert not np.any(model.filters) and model.delay_sigma == 0
