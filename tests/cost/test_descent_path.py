"""The path downhill descends at every step, and ends at the local minimum that the map marks in its basin."""

import numpy as np
import pytest

import fdcal
from fdcal.cost.basins import OUTSIDE, basins_of, descent_path
from fdcal.cost.maps import cost_maps, map_positions
from fdcal.model.settings import Search
from fdcal.solvers import load, with_mode_count


@pytest.fixture(scope="module")
def ambiguous():
    """The cost of mode 38 for the microphone sought of Fig. 1, which has several minima, and its lattice."""
    scene = fdcal.load_scene("fig1_square")
    problem = fdcal.load("fig1_square").problem()
    solver = load("descent")
    state = solver.init(problem, with_mode_count(problem, scene.solver), scene.seed)
    return cost_maps(problem, solver, state, 16, (38,), 2)[0], problem.search


def bowls(shape=(12, 21, 33)):
    """A volume with two round holes."""
    z, y, x = np.indices(shape)
    one, other = (x - 8) ** 2 + (y - 8) ** 2 + (z - 5) ** 2, (x - 25) ** 2 + (y - 12) ** 2 + (z - 6) ** 2 + 4
    return np.minimum(one, other).astype(float), Search((1.0, 2.0, 3.0), (3.2, 2.0, 1.1), 0.1, 1.0)


def starts(search, count=40):
    low, size = np.array(search.origin), np.array(search.size)
    return low + size * np.random.default_rng(7).uniform(-0.05, 1.05, (count, len(low)))


@pytest.mark.parametrize("dimension", [2, 3])
def test_every_step_descends_and_the_end_is_the_minimum_of_the_basin(ambiguous, dimension):
    cost, search = ambiguous if dimension == 2 else bowls()
    basins = basins_of(cost)
    ends = map_positions(basins.minima, search)
    reached = set()
    for start in starts(search):
        path = descent_path(cost, search, basins, start)
        inside = np.clip(start, search.origin, np.add(search.origin, search.size))
        np.testing.assert_allclose(path.points[0], inside, atol=1e-9)
        assert np.all(np.diff(path.costs) < 0)
        assert path.basin == basins.at(search, inside)
        if path.basin != OUTSIDE:
            np.testing.assert_allclose(path.points[-1], ends[path.basin], atol=1e-9)
            reached.add(path.basin)
    assert len(reached) > 1


def test_a_path_passes_a_dent_that_is_too_shallow_to_count():
    x = np.arange(60.0)
    cost = np.add.outer((np.arange(21.0) - 10) ** 2, 0.5 * np.abs(x - 45))
    cost[10, 20] -= 0.6  # lower than both neighbours, by a hundredth of the range at most
    search = Search((0.0, 0.0), (5.9, 2.0), 0.1, 1.0)
    basins = basins_of(cost, depth=0.05)
    path = descent_path(cost, search, basins, (1.0, 1.0))
    np.testing.assert_allclose(path.points[-1], (4.5, 1.0), atol=1e-9)
    assert np.all(np.diff(path.costs) < 0)
