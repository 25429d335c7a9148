"""Sums over modes: every number that is added has been computed."""

import numpy as np

from fdcal.cost import mode_sums


def test_the_blocks_that_are_not_computed_are_zero(monkeypatch):
    """They are added, too, and memory that nobody has written may hold anything."""
    rng, empty = np.random.default_rng(0), np.empty
    g, K = rng.standard_normal((2, 2, 3, 5)), rng.standard_normal((3, 5, 5))

    def filled(shape, *arguments, **named):
        made = empty(shape, *arguments, **named)
        made.fill(np.nan)
        return made

    monkeypatch.setattr(np, "empty", filled)
    H = mode_sums.weighted_curvature(g, lambda m, rows: K[m, rows])
    assert np.isfinite(H).all() and not H[1, 0].any() and H[0, 1].any()
