"""Delays and high-passes of all channels: they are found, and cost nothing where there are none."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from solving import rms, solved
from test_robust import COUNT, KNOWN, MODES
from test_robust import measured as unfiltered

from fdcal.model.measurement import Measurement

SPEED = 343.0  # m/s
FREE = np.setdiff1d(np.arange(COUNT), KNOWN)
CORNER_TO_HZ = SPEED / (2 * np.pi)


def measured(delays: Any = 0.0, corners=None, lowest=0, count=MODES) -> Measurement:
    """A measurement in a rigid room at 50 dB by channels with delays, s, and first-order high-passes, Hz."""

    def filtered(p, f):
        p = p * np.exp(-2j * np.pi * np.outer(f, delays * np.ones(COUNT)))
        return p if corners is None else p / (1 - 1j * corners / f[:, None])

    return unfiltered(lambda p, _, f: filtered(p, f), snr=50.0, modes=slice(lowest, lowest + count))


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
    assert errors[0] < 1.3 * errors[1] + 5e-4 and errors[1] < 0.004


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
