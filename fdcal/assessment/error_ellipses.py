"""One sigma and error ellipses of the covariances of positions."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri


def one_sigma(blocks: np.ndarray) -> np.ndarray:
    """Return the root of the trace of each covariance (N, D, D), metres^2 : (N,) metres, 0 for a known microphone."""
    return np.sqrt(np.maximum(np.trace(blocks, axis1=1, axis2=2), 0.0))


def confidence_factor(probability: float, dimension: int) -> float:
    """Return the half axes, in standard deviations, of the ellipse that holds a share of a D-dimensional Gaussian.

    The square of the Mahalanobis distance is chi-square distributed with D degrees of freedom.

    Examples
    --------
    >>> [round(confidence_factor(0.95, dimension), 4) for dimension in (1, 2, 3)]
    [1.96, 2.4477, 2.7955]
    """
    return float(np.sqrt(chdtri(dimension, 1 - probability)))


def ellipse_axes(blocks: np.ndarray, factor: float = 1.0) -> np.ndarray:
    """Return the half axes (N, D, D), metres, of the ellipses of covariances (N, D, D), metres^2.

    Row a of an entry is the vector of half axis a, shortest first, `factor` standard deviations long.
    """
    values, vectors = np.linalg.eigh(blocks)
    return factor * np.sqrt(np.maximum(values, 0.0))[:, :, None] * vectors.swapaxes(1, 2)
