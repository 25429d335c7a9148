"""Directions of plane waves that make up a diffuse field over an array: a quadrature of the circle or the sphere.

    kappa(k |x - y|) = sum_q w_q exp(-j k (x - y) . u_q),    sum_q w_q = 1

It is exact for arrays of k R below the order that the number of directions resolves: equally spaced directions in the
plane, Lebedev's rule in space (Lebedev and Laikov, Doklady Mathematics 59, 1999). Both come in opposite pairs: the
second half of the directions is the first half with the opposite sign, so that a wave costs half an exponential.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from ..model.validation import frozen_array

# degrees of the rules that have no negative weight
DEGREES = (3, 5, 7, 9, 11, 15, 17, 19, 21, 23, 29, 31, 35, 41, 47, 53, 59, 65, 71, 77, 83, 89, 95, 101, 107, 113, 119,
           125, 131)  # fmt: skip


def direction_count(dimension: int, order: int) -> int:
    """Return how many directions resolve fields of that order in two or three dimensions."""
    if dimension == 2:
        return 2 * order
    return len(_sphere(next((degree for degree in DEGREES if degree >= 2 * order), DEGREES[-1]))[1])


@cache
def wave_directions(dimension: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return unit vectors (D, Q) and weights (Q,) of sum 1, for a number that `direction_count` returns.

    Direction Q / 2 + q is opposite to direction q.
    """
    if dimension == 2:
        t = 2 * np.pi * np.arange(count) / count
        return frozen_array(np.stack([np.cos(t), np.sin(t)]), float), frozen_array(np.full(count, 1 / count), float)
    return next(rule for rule in map(_sphere, DEGREES) if len(rule[1]) == count)


@cache
def _sphere(degree: int) -> tuple[np.ndarray, np.ndarray]:
    from scipy.integrate import lebedev_rule  # loads scipy.optimize; here, as in `fdcal.cost.noise_model`

    points, weights = lebedev_rule(degree)
    points = points.round(15) + 0.0  # no coordinate of -0 or of rounding size, which would decide below
    first = np.array([u[np.flatnonzero(u)[0]] > 0 for u in points.T])  # one of each opposite pair
    half, weights = points[:, first], weights[first] / weights.sum()
    return frozen_array(np.hstack([half, -half]), float), frozen_array(np.tile(weights, 2), float)
