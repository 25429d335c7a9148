"""Local minima count by their prominence, and a path downhill ends at the minimum of its basin."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from solving import simulated_square

from fdcal.cost.basins import OUTSIDE, basins_of, descent_path, merged_basins
from fdcal.cost.maps import cost_maps, map_positions, minima_of
from fdcal.model.scene import load_scene
from fdcal.model.settings import Search
from fdcal.solvers import load, with_mode_count

STEP = 0.01
SEARCH = Search(origin=(0.0, 0.0), size=(1.2, 0.9), step=STEP, radius=1.0)


def lattice(search=SEARCH):
    return np.meshgrid(*(o + search.step * np.arange(n) for o, n in zip(search.origin, search.shape, strict=True)))


def waves(rng):
    """The cost of a sum of waves in a bowl, as a function of places (P, 2), metres."""
    k, phase = rng.normal(0.0, 5.0, (6, 2)), rng.uniform(0, 2 * np.pi, 6)
    middle = np.array([0.6, 0.45])

    def cost(places):
        return np.sin(places @ k.T + phase).sum(axis=-1) + 4 * ((places - middle) ** 2).sum(axis=-1)

    return cost


def test_a_ripple_does_not_count_and_a_minimum_does():
    valley = np.abs(np.arange(-30, 31))[:, None] * 10.0 + np.zeros((61, 81))
    ripple = valley + np.where(np.arange(81) % 4 == 0, -0.05, 0.0)
    assert len(basins_of(ripple).minima) == 0, "ripples along a valley are no minima"
    ripple[30, 50] -= 30
    np.testing.assert_array_equal(basins_of(ripple).minima, [[30, 50]])


def test_minima_below_the_end_of_the_scale_rank_equally_and_a_chain_of_them_is_one():
    x, y = lattice()
    left, right = ((x - at) ** 2 + (y - 0.45) ** 2 for at in (0.3, 0.9))
    ring = np.abs(np.hypot(x - 0.6, y - 0.45) - 0.3) ** 2 + 1e-7  # on a lattice, the ring is a chain of small minima
    holes = minima_of(np.minimum(left + 1e-9, right + 1e-6), SEARCH)
    assert holes.count == 2 and len(holes.lowest) == 2 and not len(holes.others), "60 dB and 90 dB below the highest"
    assert holes.end == pytest.approx(1e-4 * float(np.minimum(left, right).max()), rel=1e-3)
    assert minima_of(ring, SEARCH).count == 1
    shallow = minima_of(np.minimum(left + 1e-3, right + 1e-2), SEARCH)
    assert shallow.count == 2 and len(shallow.others) == 1 and shallow.end is None
    np.testing.assert_allclose([*shallow.lowest, *shallow.others], [[0.3, 0.45], [0.9, 0.45]], atol=1e-9)


def prominences(cost):
    """Prominence of every local minimum of a map or volume of different costs, by its flat index."""
    flat, around = cost.ravel(), np.ones((3,) * cost.ndim)
    found = {}
    for level in np.sort(flat):
        pools, _ = ndimage.label(cost <= level, around)
        for pool in np.unique(pools[pools > 0]):
            places = np.flatnonzero(pools.ravel() == pool)
            lowest = places[flat[places].argmin()]
            found.setdefault(lowest, np.inf)
            # The pools of these minima overflow into that of a lower one.
            for minimum in set(found) & set(places.tolist()) - {lowest}:
                found[minimum] = min(found[minimum], level - flat[minimum])
    return found


@pytest.mark.parametrize("shape", [(9, 13), (1, 20), (2, 2), (4, 5, 6)])
@settings(deadline=None, max_examples=8)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_minima_are_those_whose_prominence_exceeds_the_depth(shape, seed):
    cost = np.random.default_rng(seed).permutation(np.prod(shape)).reshape(shape) / np.prod(shape)
    expected = prominences(cost)
    for depth in (0.0, 0.1, 0.3, 2.0):
        found = merged_basins(cost, depth)[0]
        assert set(found.tolist()) == {minimum for minimum, climb in expected.items() if climb > depth}
        assert (np.diff(cost.ravel()[found]) > 0).all(), "the lowest first"


def test_every_minimum_lies_in_the_basin_of_its_number():
    for seed in range(6):
        x, y = lattice()
        basins = basins_of(waves(np.random.default_rng(seed))(np.stack([x, y], axis=-1)))
        np.testing.assert_array_equal(basins.labels[tuple(basins.minima.T)], np.arange(len(basins.minima)))


def test_descent_down_a_slope_leaves_the_map():
    x, y = lattice()
    slope = basins_of(x + 0.3 * y)
    assert (slope.labels == OUTSIDE).all() and not len(slope.minima)
    assert len(basins_of(np.ones((20, 30))).minima) == 0, "a level cost has no minimum"


# The path downhill descends at every step, and ends at the local minimum that the map marks in its basin.


@pytest.fixture(scope="module")
def ambiguous():
    """The cost of mode 38 for the microphone sought of Fig. 1, which has several minima, and its lattice."""
    problem, scene, solver = simulated_square().problem(), load_scene("fig1_square"), load("descent")
    state = solver.init(problem, with_mode_count(problem, scene.solver), scene.seed)
    return cost_maps(problem, solver, state, 16, (38,), 2)[0], problem.search


def bowls(shape=(12, 21, 33)):
    """A volume with two round minima."""
    z, y, x = np.indices(shape)
    one, other = (x - 8) ** 2 + (y - 8) ** 2 + (z - 5) ** 2, (x - 25) ** 2 + (y - 12) ** 2 + (z - 6) ** 2 + 4
    return np.minimum(one, other).astype(float), Search((1.0, 2.0, 3.0), (3.2, 2.0, 1.1), 0.1, 1.0)


def places_in(search, count=40):
    low, size = np.array(search.origin), np.array(search.size)
    return low + size * np.random.default_rng(7).uniform(-0.05, 1.05, (count, len(low)))


@pytest.mark.parametrize("dimension", [2, 3])
def test_every_step_descends_and_the_end_is_the_minimum_of_the_basin(ambiguous, dimension):
    cost, search = ambiguous if dimension == 2 else bowls()
    basins = basins_of(cost)
    ends, reached = map_positions(basins.minima, search), set()
    for start in places_in(search):
        path = descent_path(cost, search, basins, start)
        inside = np.clip(start, search.origin, np.add(search.origin, search.size))
        np.testing.assert_allclose(path.points[0], inside, atol=1e-9)
        assert np.all(np.diff(path.costs) < 0) and path.basin == basins.at(search, inside)
        if path.basin != OUTSIDE:
            np.testing.assert_allclose(path.points[-1], ends[path.basin], atol=1e-9)
            reached.add(path.basin)
    assert len(reached) > 1


def test_a_path_passes_a_dent_that_is_too_shallow_to_count():
    cost = np.add.outer((np.arange(21.0) - 10) ** 2, 0.5 * np.abs(np.arange(60.0) - 14))
    cost[10, 39] -= 0.6  # lower than both neighbours by at most a hundredth of the range
    search = Search((0.0, 0.0), (5.9, 2.0), 0.1, 1.0)
    path = descent_path(cost, search, basins_of(cost, depth=0.05), (3.9, 1.0))
    np.testing.assert_allclose(path.points[-1], (1.4, 1.0), atol=1e-9)
    assert np.all(np.diff(path.costs) < 0) and np.abs(np.diff(path.points, axis=0)).max() < 0.3, "no jump"
