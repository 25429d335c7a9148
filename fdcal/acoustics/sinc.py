"""sin(z) / z, the correlation of a diffuse field in three dimensions, and its derivative, for many z together."""

from __future__ import annotations

import numpy as np

SMALL = 0.02  # below it the derivative is computed by its series; the error is below 1e-12 on both sides


def sinc(z) -> tuple[np.ndarray, np.ndarray]:
    """Return sin(z) / z and its derivative over z.

    Parameters
    ----------
    z : array of float64
        Not negative, dimensionless.

    Returns
    -------
    two float64 arrays of the shape of `z`
    """
    z = np.asarray(z, float)
    half = np.tan(z / 2)  # one function for sine and cosine; of it NumPy computes many values at once
    weight = 2 / (1 + half * half)
    small = z < SMALL
    apart = np.where(small, 1.0, z)
    kappa = half * weight / apart
    slope = (weight - 1 - kappa) / (apart * apart)
    if small.any():
        square = z[small] ** 2
        kappa[small] = 1 - square / 6 * (1 - square / 20 * (1 - square / 42))
        slope[small] = square / 30 * (1 - square / 28) - 1 / 3
    return kappa, slope
