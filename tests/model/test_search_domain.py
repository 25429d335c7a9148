"""A search domain made for a measurement that has none: it holds the array with room to spare, in any dimension."""

from __future__ import annotations

import numpy as np
import pytest

from fdcal.model.settings import CELLS, search_round


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("size", [0.03, 0.7, 4.0])
def test_it_holds_the_array_and_a_margin(dimension, size):
    rng = np.random.default_rng(0)
    positions = 3 + size * rng.uniform(size=(30, dimension))
    search = search_round(positions)
    low, high = np.array(search.origin), np.add(search.origin, search.size)
    extent = float(np.ptp(positions, axis=0).max())
    assert (positions.min(axis=0) - low > 0.2 * extent).all() and (high - positions.max(axis=0) > 0.2 * extent).all()
    assert max(search.shape) <= CELLS[dimension] + 2
    farthest = np.linalg.norm(positions - (low + high) / 2, axis=1).max()
    assert farthest < search.radius <= np.linalg.norm(search.size) / 2 + 1e-9


def test_it_moves_and_grows_with_the_array():
    rng = np.random.default_rng(1)
    positions = rng.uniform(size=(20, 2))
    one, moved, larger = search_round(positions), search_round(positions + 7.0), search_round(10 * positions)
    np.testing.assert_allclose(np.subtract(moved.origin, one.origin), 7.0)
    assert moved.size == pytest.approx(one.size) and moved.radius == pytest.approx(one.radius)
    assert larger.step == pytest.approx(10 * one.step) and larger.radius == pytest.approx(10 * one.radius)


def test_one_place_has_a_domain_too():
    search = search_round([[1.0, 2.0]])
    assert min(search.size) >= 0.1 and search.radius > 0
