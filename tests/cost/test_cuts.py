"""A cut is Eq. 7 along a line: that of the maps, and at the estimate that of the page."""

import numpy as np
import pytest
from fields import measured

from fdcal.cost.channel_correction import ChannelCorrection
from fdcal.cost.maps import eq7_cut, eq7_maps
from fdcal.cost.reference_cost import ReferenceCost
from fdcal.model.validation import InputError

MICROPHONE = 9


@pytest.fixture(scope="module")
def measurement():
    positions = np.random.default_rng(4).uniform([2.2, 1.9], [3.0, 2.7], (24, 2))
    return measured(positions, np.arange(4), modes=14)


@pytest.fixture(scope="module")
def problem(measurement):
    return measurement.problem("unit")


@pytest.fixture(scope="module")
def positions(measurement):
    return measurement.positions + np.random.default_rng(5).normal(0, 0.01, measurement.positions.shape)


@pytest.mark.parametrize("modes", [(1,), (2, 5, 9), tuple(range(1, 13))])
def test_a_cut_along_a_row_of_the_lattice_is_that_row_of_the_maps(problem, positions, modes):
    search, row = problem.search, 11
    maps = eq7_maps(problem, positions, MICROPHONE, modes, 2)
    x = search.origin[0] + search.step * np.arange(search.shape[0])
    points = np.column_stack([x, np.full(len(x), search.origin[1] + row * search.step)])
    cut = eq7_cut(problem, positions, MICROPHONE, modes, 2, points)
    np.testing.assert_allclose(cut, maps[:, row], rtol=1e-6, atol=1e-12)


def test_the_sum_at_the_estimate_is_the_cost_of_the_page(problem, positions):
    reference_cost = ReferenceCost(problem)
    modes, here = tuple(range(1, reference_cost.count + 1)), positions[MICROPHONE][None]
    cut = eq7_cut(problem, positions, MICROPHONE, modes, reference_cost.order_offset, here)
    assert 10 * np.log10(cut.sum()) == pytest.approx(reference_cost(positions), abs=1e-6)


def test_a_cut_read_backwards_is_the_same(problem, positions):
    points = np.linspace([2.1, 1.8], [3.1, 2.8], 30)
    there = eq7_cut(problem, positions, MICROPHONE, (1, 4), 2, points)
    np.testing.assert_allclose(there, eq7_cut(problem, positions, MICROPHONE, (1, 4), 2, points[::-1])[:, ::-1])


def test_from_the_truth_the_cut_of_noise_free_modes_is_lowest_at_the_true_position(problem, measurement):
    truth = measurement.positions[MICROPHONE]
    points = truth + np.linspace(-0.3, 0.3, 61)[:, None] * [0.8, -0.6]
    cut = eq7_cut(problem, measurement.positions, MICROPHONE, range(1, 9), 4, points).sum(axis=0)
    assert abs(int(cut.argmin()) - 30) <= 1


def test_a_mode_that_the_microphones_cannot_carry_is_refused(problem, positions):
    with pytest.raises(InputError, match="order"):
        eq7_cut(problem, positions, MICROPHONE, (14,), 12, positions[:1])


def test_gains_and_noise_that_the_solver_estimates_count(problem, positions):
    gains = np.exp(1j * np.linspace(0, 1, len(positions)))
    channels = ChannelCorrection(gains, np.linspace(1, 2, len(positions)))
    search = problem.search
    maps = eq7_maps(problem, positions, MICROPHONE, (1, 2), 2, None, channels)
    x = search.origin[0] + search.step * np.arange(search.shape[0])
    points = np.column_stack([x, np.full(len(x), search.origin[1])])
    cut = eq7_cut(problem, positions, MICROPHONE, (1, 2), 2, points, channels)
    np.testing.assert_allclose(cut, maps[:, 0], rtol=1e-6, atol=1e-12)
    assert not np.allclose(cut, eq7_cut(problem, positions, MICROPHONE, (1, 2), 2, points))
