"""Prominence of local minima: the climb out of each to a lower one, found here by raising the water level by level."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import label

from fdcal.cost.basins import merged_basins, prominent_minima


def climbs(cost):
    """Prominence of every local minimum of a map or volume of different costs, by its flat index."""
    flat, around = cost.ravel(), np.ones((3,) * cost.ndim)
    found = {}
    for level in np.sort(flat):
        pools, _ = label(cost <= level, around)
        for pool in np.unique(pools[pools > 0]):
            places = np.flatnonzero(pools.ravel() == pool)
            lowest = places[flat[places].argmin()]
            found.setdefault(lowest, np.inf)
            for minimum in set(found) & set(places.tolist()) - {lowest}:  # whose pool has run over into a lower one
                found[minimum] = min(found[minimum], level - flat[minimum])
    return found


@pytest.mark.parametrize("shape", [(9, 13), (1, 20), (2, 2), (4, 5, 6)])
@settings(deadline=None, max_examples=8)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_minima_are_those_whose_climb_exceeds_the_depth(shape, seed):
    cost = np.random.default_rng(seed).permutation(np.prod(shape)).reshape(shape) / np.prod(shape)
    expected = climbs(cost)
    for depth in (0.0, 0.1, 0.3, 2.0):
        found = prominent_minima(cost, depth)
        assert set(found.tolist()) == {minimum for minimum, climb in expected.items() if climb > depth}
        assert (np.diff(cost.ravel()[found]) > 0).all(), "the lowest first"


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_a_minimum_that_ends_joins_a_lower_one_and_the_chain_ends_at_one_that_survives(seed):
    rng = np.random.default_rng(seed)
    cost = rng.integers(0, 6, (8, 11)).astype(float)  # with many equal costs
    minima, heirs = merged_basins(cost, 1.0)
    flat = cost.ravel()
    order = {int(point): rank for rank, point in enumerate(np.argsort(flat, kind="stable"))}
    ended = np.flatnonzero(heirs != np.arange(cost.size))
    assert all(order[heirs[point]] < order[point] for point in ended)
    for point in ended:
        while heirs[point] != point:
            point = heirs[point]
        assert point in minima
    assert minima[0] == flat.argmin() and not set(minima) & set(ended)
