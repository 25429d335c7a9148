"""Pressures of a point source in a rigid rectangle, closed form. Time sign exp(+jwt)."""

import numpy as np


def rectangle_field(points, source, size, wavenumbers, terms: int = 500) -> np.ndarray:
    """Return the pressures of a unit point source in a rigid rectangle.

    The sum over the modes of one axis is exact in the other axis. Each point takes the axis along which it is nearer
    to the source, so that the terms decay exponentially in the other one.

    Parameters
    ----------
    points : (N, 2) float64, metres
    source, size : (2,) float64, metres
    wavenumbers : (M,) complex128, rad/m
    terms : int
        Number of modes in the sum.

    Returns
    -------
    (M, N) complex128
    """
    x, y = np.asarray(points, float).T
    along_x = np.abs(y - source[1]) >= np.abs(x - source[0])
    pressures = np.empty((len(wavenumbers), len(x)), complex)
    for row, k in zip(pressures, wavenumbers, strict=True):
        for chosen, a, b, axis in ((along_x, x, y, 0), (~along_x, y, x, 1)):
            if chosen.any():
                other = 1 - axis
                row[chosen] = _axis_sum(
                    a[chosen], source[axis], size[axis], b[chosen], source[other], size[other], k, terms
                )
    return pressures


def _axis_sum(x, x_source, x_size, y, y_source, y_size, k, terms: int) -> np.ndarray:
    """Sum over the modes along x of cos(x) cos(x_source), exact in y."""
    m = np.arange(terms)
    weight = np.where(m == 0, 1.0, 2.0) / x_size
    g = np.sqrt(k**2 - (m * np.pi / x_size) ** 2 + 0j)
    g = np.where(g.imag > 0, -g, g)
    low, high = np.minimum(y, y_source)[:, None], np.maximum(y, y_source)[:, None]

    def decay(length):
        return np.exp(-1j * g * length)

    # cos(g low) cos(g (y_size - high)) / (g sin(g y_size)), the growing exponentials cancelled
    numerator = (1 + decay(2 * low)) * (1 + decay(2 * (y_size - high))) * decay(high - low) / 4
    green = -numerator / (g * (1 - decay(2 * y_size)) / 2j)
    shapes = np.cos(np.outer(x, m) * np.pi / x_size) * np.cos(m * np.pi * x_source / x_size)
    return (weight * shapes * green).sum(axis=1)
