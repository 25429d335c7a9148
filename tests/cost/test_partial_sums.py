"""Partial sums over modes are the maps of those modes; low modes are broad, high ones ambiguous."""

import numpy as np
import pytest
from fields import measured

from fdcal import solvers
from fdcal.cost.basins import local_minima
from fdcal.cost.maps import ambiguous_mode, cost_maps, partial_sums, refined
from fdcal.cost.reference_cost import ORDER_OFFSET
from fdcal.model.settings import SolverSettings

MICROPHONE = 9


@pytest.fixture(scope="module")
def problem():
    positions = np.random.default_rng(4).uniform([2.2, 1.9], [3.0, 2.7], (24, 2))
    return measured(positions, np.arange(4), modes=14).problem("unit")


@pytest.fixture(scope="module", params=["descent", "joint"])
def name(request):
    return request.param


@pytest.fixture(scope="module")
def solver(name):
    return solvers.load(name)


@pytest.fixture(scope="module")
def state(problem, name, solver):
    settings = solvers.with_mode_count(problem, SolverSettings(name=name, modes=8, first_modes=3))
    return solver.init(problem, settings, 0)


@pytest.mark.parametrize("order_offset", [ORDER_OFFSET, None])
@pytest.mark.parametrize("modes", [(1, 2, 3, 4), (6, 5, 4), (3,)])
def test_each_partial_sum_is_the_map_of_its_modes(problem, solver, state, modes, order_offset):
    fine = refined(problem.search, 60)
    sums = list(partial_sums(problem, solver, state, MICROPHONE, modes, order_offset, fine))
    assert [one.modes for one in sums] == [modes[: i + 1] for i in range(len(modes))]
    for one in sums:
        maps = cost_maps(problem, solver, state, MICROPHONE, one.modes, order_offset, fine)
        np.testing.assert_allclose(one.cost, maps.sum(axis=0), rtol=1e-9, atol=1e-12 * np.ptp(one.cost))
        np.testing.assert_array_equal(one.minima, local_minima(one.cost))


def test_the_order_in_which_modes_are_added_does_not_change_their_sum(problem, solver, state):
    *_, up = partial_sums(problem, solver, state, MICROPHONE, (1, 2, 3, 4, 5), ORDER_OFFSET)
    *_, down = partial_sums(problem, solver, state, MICROPHONE, (5, 4, 3, 2, 1), ORDER_OFFSET)
    np.testing.assert_allclose(up.cost, down.cost, rtol=1e-9)


def test_no_mode_has_more_minima_than_the_ambiguous_one(problem, solver, state):
    modes = range(1, 15)
    most = ambiguous_mode(problem, solver, state, MICROPHONE, modes, ORDER_OFFSET)
    counts = {}
    for mode in modes:
        (alone,) = partial_sums(problem, solver, state, MICROPHONE, (mode,), ORDER_OFFSET)
        counts[mode] = len(alone.minima)
    assert counts[most] == max(counts.values()) > 1
