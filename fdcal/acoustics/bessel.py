"""Bessel functions of all orders for arrays of real or complex arguments.

The recurrences run downward, from orders beyond the argument where the functions are negligible (Miller): upward they
lose all digits.
"""

from __future__ import annotations

import numpy as np

SMALL = 0.2  # below it the power series is used: the recurrence would overflow within a few orders
SPARE = 24  # orders beyond the argument and the highest order wanted, at which the recurrence begins
FIRST, LARGE = 1e-290, 1e250  # the recurrence begins with one and is divided by the other where it has grown beyond it
INTERVAL = 8  # orders between two looks at the size of the values


def bessel(z, top: int) -> np.ndarray:
    """Return J_0 to J_top of every argument, normalised by J_0 + 2 (J_2 + J_4 + ...) = 1.

    Parameters
    ----------
    z : float64 or complex128, any shape, dimensionless
    top : int, the highest order

    Returns
    -------
    (top + 1, ...) array of the type of `z`

    Examples
    --------
    >>> bessel(np.array([0.0, 1.0]), 1).round(4)
    array([[1.    , 0.7652],
           [0.    , 0.4401]])
    """
    z = np.asarray(z)
    small, apart, start = _apart(z, top)
    J = _downward(apart, start, 0)
    J[: top + 1] /= J[0] + 2 * J[2::2].sum(axis=0)
    J[: top + 1, small] = _series(z[small], top, 0.0)
    return J[: top + 1]


def spherical_bessel_functions(z, top: int) -> np.ndarray:
    """Return j_0 to j_top of every argument, normalised by j_0 or j_1, whichever is larger.

    Parameters
    ----------
    z : float64 or complex128, any shape, dimensionless
    top : int, the highest order

    Returns
    -------
    (top + 1, ...) array of the type of `z`
    """
    z = np.asarray(z)
    small, apart, start = _apart(z, top)
    j = _downward(apart, start, 1)
    zero = np.sin(apart) / apart
    one = (zero - np.cos(apart)) / apart
    j[: top + 1] *= np.where(np.abs(zero) > np.abs(one), zero / j[0], one / j[1])
    j[: top + 1, small] = _series(z[small], top, 0.5)
    return j[: top + 1]


def _apart(z: np.ndarray, top: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Where arguments are small, the arguments with 1 in their place, and the order to begin with."""
    size = np.abs(z)
    small = size < SMALL
    return small, np.where(small, 1.0, z), top + int(size.max(initial=0.0)) + SPARE


def _downward(z: np.ndarray, start: int, odd: int) -> np.ndarray:
    """Multiples of the functions of orders 0 to `start`, another multiple for each argument : (start + 1, ...).

    The recurrence is f_(l-1) = (2 l + odd) f_l / z - f_(l+1); `odd` is 0 for J_l, 1 for j_l.
    """
    f, inverse = np.empty((start + 1, *z.shape), z.dtype), 1.0 / z
    f[start] = FIRST
    np.multiply(inverse, (2 * start + odd) * FIRST, out=f[start - 1])
    for l in range(start - 1, 0, -1):  # noqa: E741
        below = np.multiply(inverse, 2 * l + odd, out=f[l - 1])
        below *= f[l]
        below -= f[l + 1]
        if l % INTERVAL == 0:
            large = np.abs(below) > LARGE
            if large.any():
                f[l - 1 :] *= np.where(large, 1 / LARGE, 1.0)
    return f


def _series(z: np.ndarray, top: int, shift: float) -> np.ndarray:
    """The first terms of the power series, for small z : (top + 1, P); `shift` is 0 for J_l, 1/2 for j_l."""
    half, l = z / 2, np.arange(top + 1)[:, None] + shift  # noqa: E741
    lead = np.ones((top + 1, len(z)), z.dtype)
    np.cumprod(half / l[1:], axis=0, out=lead[1:])
    term, total, square = np.ones_like(lead), np.ones_like(lead), half * half
    for t in range(1, 7):
        term *= -square / (t * (t + l))
        total += term
    return lead * total
