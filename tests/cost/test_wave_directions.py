"""Directions of plane waves: a quadrature of the circle and of the sphere."""

import numpy as np
import pytest

from fdcal.cost.wave_directions import direction_count, wave_directions


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("order", [2, 6, 11, 18])
def test_the_mean_over_the_directions_is_exact_up_to_twice_the_order(dimension, order):
    u, w = wave_directions(dimension, direction_count(dimension, order))
    np.testing.assert_allclose(np.linalg.norm(u, axis=0), 1)
    assert np.all(w > 0) and np.isclose(w.sum(), 1)
    towards = np.array([0.6, 0.8, 0.0])[:dimension]
    for power in range(2, 2 * order, 2):
        exact = (
            1 / (power + 1) if dimension == 3 else np.prod((np.arange(power // 2) + 0.5) / (np.arange(power // 2) + 1))
        )
        assert np.isclose(w @ (towards @ u) ** power, exact)
