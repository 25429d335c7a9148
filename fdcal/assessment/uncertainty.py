"""The uncertainty of each position, from what a solver reports of its minimum (`PositionSpread`).

    P   inverse of the Gauss-Newton matrix of cost and priors: the covariance of a field that is as assumed
    Q   P H P, H the part of the data in that matrix: of P, what is the error of the data
    r   dispersion, of the data over Q, which blocks of frequencies and takes show by their disagreement
    C   P + max(0, 3 (r - 1) / 4) Q + d d^T,   d the Newton step that is left

P supposes the noise found, the field's directions found, and the priors of gains, given positions and sound speed. Few
waves make a room less random than that, and r measures it; it is known from about ten blocks alone, so that three
quarters of the excess count, and no r narrows what the model claims. What the priors state is not widened. Nothing else
is added, so that sigma depends on the end alone and falls with the noise that the data show.

One sigma of a position is the root of the trace of C: the root mean square distance from its true place. That of a
coordinate is the root of an element of its diagonal.

All of this belongs to the minimum. How far the optima of several restarts lie apart belongs to the search:

    w_e = exp(-score_e) / sum_f exp(-score_f),   spread of microphone n = sqrt(sum_e w_e |d_en|^2)

d_en is the distance of microphone n between optimum e and the likeliest one.
"""

import numpy as np
from scipy.special import chdtri

from ..model.gauge import align
from ..solvers.estimate import Estimate, scale_sigma


def covariance_of(estimate: Estimate) -> np.ndarray:
    """Return the covariance of each position (N, D, D), metres^2, with the step that is left."""
    step = estimate.spread.step
    return _blocks(estimate, estimate.spread.covariance) + step[:, :, None] * step[:, None, :]


def curvature_of(estimate: Estimate) -> np.ndarray:
    """Return the covariance of each position where the modes agree as the model says : (N, D, D) float64, metres^2."""
    return _blocks(estimate, estimate.spread.newton)


def _blocks(estimate: Estimate, covariance: np.ndarray) -> np.ndarray:
    """The blocks (N, D, D) of the positions in a covariance (N D, N D)."""
    N, D = estimate.positions.shape
    return np.einsum("nanb->nab", covariance.reshape(N, D, N, D))


def scale_sigma_of(estimate: Estimate, healthy: np.ndarray) -> float:
    """Return one sigma of the least certain stretching or shearing of the array as a whole, relative."""
    return scale_sigma(estimate.positions, estimate.spread.covariance, healthy)


def search_spread_of(estimate: Estimate, healthy: np.ndarray) -> np.ndarray:
    """Return how far the optima of the search lie apart, weighted by their likelihood : (N,) float64, metres.

    `healthy` (N,) microphones determine the motion onto each other of arrays that nothing holds as a whole.
    """
    tried = estimate.tried
    if not tried:
        return np.zeros(len(estimate.positions))
    weights = np.exp(-np.array([one.score - tried[0].score for one in tried]))
    best, away = tried[0].positions, []
    for one in tried:
        placed = one.positions if one.same_frame else align(one.positions, best, healthy)
        away.append(np.linalg.norm(placed - best, axis=1))
    return np.sqrt(weights @ np.array(away) ** 2 / weights.sum())


def root_mean_square(values: np.ndarray) -> float:
    """Return the root mean square of some values; 0 of none."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0


def one_sigma(blocks: np.ndarray) -> np.ndarray:
    """Return the root of the trace of each covariance (N, D, D), metres^2 : (N,) metres, 0 for a known microphone."""
    return np.sqrt(np.maximum(np.trace(blocks, axis1=1, axis2=2), 0.0))


def confidence_factor(probability: float, dimension: int) -> float:
    """Return the half axes, in standard deviations, of the ellipse that holds a fraction of a D-dimensional Gaussian.

    The square of the Mahalanobis distance is chi-square distributed with D degrees of freedom.
    """
    return float(np.sqrt(chdtri(dimension, 1 - probability)))


def ellipse_axes(blocks: np.ndarray, factor: float = 1.0) -> np.ndarray:
    """Return the half axes (N, D, D), metres, in rows, shortest first, of ellipses of `factor` standard deviations."""
    values, vectors = np.linalg.eigh(blocks)
    return factor * np.sqrt(np.maximum(values, 0.0))[:, :, None] * vectors.swapaxes(1, 2)
