"""Levenberg-Marquardt steps of positions and channel gains together, on the cost of `objective`.

The parameters of a microphone are its D coordinates, metres, its log gain, nepers, and its phase, radians: P = D + 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...cost.channel_likelihood import Terms
from ...model.gauge import rigid_motions
from ..levenberg_marquardt import DAMPING, NewtonTerms, damped_step
from .objective import Objective


@dataclass(frozen=True)
class ChannelStep:
    """Result of one step.

    Attributes
    ----------
    positions : (N, D) float64, metres
    gains : (N, 2) float64, nepers and radians
    cost : float, infinite where a covariance is singular
    fall : float, by how much the cost has fallen
    damping : float, of the next step
    moved : float, metres, greatest change of a coordinate
    terms : Terms at the point from which the step was taken; None where a covariance is singular
    free : see `free_basis`
    matrix : (F, F) float64, Gauss-Newton matrix in the free directions; None with `terms`
    """

    positions: np.ndarray
    gains: np.ndarray
    cost: float
    fall: float
    damping: float
    moved: float
    free: np.ndarray
    terms: Terms | None = None
    matrix: np.ndarray | None = None


def free_basis(positions, deformations, gains: bool) -> np.ndarray:
    """Return the directions in which the parameters may move.

    Parameters
    ----------
    positions : (N, D) float64, metres
    deformations : (N D, F) float64 or None
        Directions of the positions; None lets every microphone move.
    gains : bool
        Whether the gains are free.

    Returns
    -------
    (N P, F) float64, or (F,) int64: the indices of the free parameters, where every microphone moves
    """
    N, D = positions.shape
    index = np.arange(N * (D + 2)).reshape(N, D + 2)
    freed = index[:, D:].T.ravel() if gains else np.zeros(0, np.int64)
    if deformations is None:
        return np.concatenate([index[:, :D].ravel(), freed])
    basis = np.zeros((N * (D + 2), deformations.shape[1] + len(freed)))
    basis[index[:, :D].ravel(), : deformations.shape[1]] = deformations
    basis[freed, deformations.shape[1] + np.arange(len(freed))] = 1.0
    return basis


def channel_step(
    positions, gains, objective: Objective, free: np.ndarray, damping: float, furthest: float, blind: bool
) -> ChannelStep:
    """Return one damped Gauss-Newton step of positions and gains.

    Parameters
    ----------
    positions : (N, D) float64, metres
    gains : (N, 2) float64, nepers and radians
    objective : Objective
    free : see `free_basis`
    damping, furthest : as of `fdcal.solvers.levenberg_marquardt.damped_step`
    blind : bool
        Whether no position is given, so that nothing holds the array as a whole.
    """
    N, D = positions.shape
    try:
        cost, terms = objective.evaluate(positions, gains)
    except np.linalg.LinAlgError:
        return ChannelStep(positions, gains, np.inf, 0.0, DAMPING.first, 0.0, free)
    g, H = reduced(positions, terms, free, blind)
    before = np.column_stack([positions, gains])
    step = damped_step(
        before,
        NewtonTerms(cost, g, H),
        lambda tried: _cost(objective, tried[:, :D], tried[:, D:]),
        lambda y: before + _expand(free, y, before.size).reshape(N, D + 2),
        lambda tried: float(np.abs(tried[:, :D] - positions).max()),
        damping,
        furthest,
    )
    x, g_new = step.unknowns[:, :D], step.unknowns[:, D:]
    return ChannelStep(x, g_new, step.cost, step.fall, step.damping, step.moved, free, terms, H)


def reduced(positions, terms: Terms, free: np.ndarray, blind: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradient (F,) and the Gauss-Newton matrix (F, F) in the free directions.

    A blind array is held as a whole, and so is the gain that all channels share: the power of the field takes it up.
    """
    N, D = positions.shape
    P = D + 2
    gradient, curvature = terms.newton()
    g, H = gradient.ravel(), curvature.reshape(N * P, N * P).copy()
    diagonal = np.diag(H).reshape(N, P)
    level = np.mean(diagonal[:, D:]) / N
    if blind:
        motions = np.zeros((N, P, D * (D + 1) // 2))
        motions[:, :D] = np.linalg.qr(rigid_motions(positions))[0].reshape(N, D, -1)
        motions = motions.reshape(N * P, -1)
        H += np.mean(diagonal[:, :D]) * (motions @ motions.T)
    for column in (D, D + 1):
        H[column::P, column::P] += level
    if free.ndim == 1:
        return g[free], H[np.ix_(free, free)]
    return free.T @ g, free.T @ H @ free


def _expand(free: np.ndarray, y: np.ndarray, size: int) -> np.ndarray:
    if free.ndim == 2:
        return free @ y
    whole = np.zeros(size)
    whole[free] = y
    return whole


def _cost(objective: Objective, positions, gains) -> float:
    try:
        return objective.evaluate(positions, gains, 0)[0]
    except np.linalg.LinAlgError:  # two microphones at the same place without noise
        return np.inf
