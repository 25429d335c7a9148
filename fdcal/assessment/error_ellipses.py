"""One sigma and error ellipses of the covariances of positions."""

from __future__ import annotations

import numpy as np


def one_sigma(blocks: np.ndarray) -> np.ndarray:
    """Return the square root of the trace of each covariance.

    Parameters
    ----------
    blocks : (N, D, D) float64, metres^2

    Returns
    -------
    (N,) float64, metres; 0 for a known microphone
    """
    return np.sqrt(np.maximum(np.trace(blocks, axis1=1, axis2=2), 0.0))


def ellipse_axes(blocks: np.ndarray, sigmas: float = 1.0) -> np.ndarray:
    """Return the half axes of the error ellipses or ellipsoids.

    Parameters
    ----------
    blocks : (N, D, D) float64, metres^2, covariances
    sigmas : length of a half axis in standard deviations. The ellipse that covers a share q of a plane's Gaussian has
        sqrt(-2 log(1 - q)): 2.45 for 95 %.

    Returns
    -------
    (N, D, D) float64, metres; row a of an entry is the vector of half axis a, shortest first
    """
    values, vectors = np.linalg.eigh(blocks)
    return sigmas * np.sqrt(np.maximum(values, 0.0))[:, :, None] * vectors.swapaxes(1, 2)
