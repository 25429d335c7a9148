"""Levenberg-Marquardt steps of positions, channels and sound speed together, on the cost of `objective`.

The parameters of a microphone are its D coordinates, metres, its log gain, nepers, its phase, radians, and where a
channel has a filter a delay, metres, and a corner, rad/m: P = D + 2 or D + 4. The last unknown is the sound speed's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...cost.channel_likelihood import Terms
from ...model.gauge import rigid_motions
from ..levenberg_marquardt import DAMPING, NewtonTerms, damped_step
from .objective import Evaluation, Objective, Unknowns


@dataclass(frozen=True)
class ChannelStep:
    """Result of one step.

    Attributes
    ----------
    unknowns : Unknowns
    cost : float, infinite where a covariance is singular
    fall : float, by how much the cost has fallen
    damping : float, of the next step
    moved : float, metres, greatest change of a coordinate
    terms : Terms at the point from which the step was taken; None where a covariance is singular
    free : see `free_basis`
    matrix : (F, F) float64, Gauss-Newton matrix in the free directions; None with `terms`
    """

    unknowns: Unknowns
    cost: float
    fall: float
    damping: float
    moved: float
    free: np.ndarray
    terms: Terms | None = None
    matrix: np.ndarray | None = None


def free_basis(unknowns: Unknowns, deformations, gains: bool, filters, speed: bool) -> np.ndarray:
    """Return the directions in which the unknowns may move.

    Parameters
    ----------
    unknowns : Unknowns
    deformations : (N D, F) float64 or None
        Directions of the positions; None lets every microphone move.
    gains : bool
        Whether the gains are free.
    filters : (N, 2) bool
        Which delays and corners are free, where the unknowns have them and the gains are free.
    speed : bool
        Whether the sound speed is free.

    Returns
    -------
    (N P + 1, F) float64, or (F,) int64: the indices of the free unknowns, where every microphone moves
    """
    N, D = unknowns.positions.shape
    size = unknowns.vector.size
    index = np.arange(size - 1).reshape(N, -1)
    freed = [index[:, D : D + 2].T.ravel()] if gains else []
    if gains and unknowns.channels.shape[1] > 2:
        freed.append(index[:, D + 2 :][filters])
    rest = np.concatenate([*freed, [size - 1] if speed else []]).astype(np.int64)
    if deformations is None:
        return np.concatenate([index[:, :D].ravel(), rest])
    basis = np.zeros((size, deformations.shape[1] + len(rest)))
    basis[index[:, :D].ravel(), : deformations.shape[1]] = deformations
    basis[rest, deformations.shape[1] + np.arange(len(rest))] = 1.0
    return basis


def channel_step(
    unknowns: Unknowns, objective: Objective, free: np.ndarray, damping: float, furthest: float, blind: bool
) -> ChannelStep:
    """Return one damped Gauss-Newton step.

    Parameters
    ----------
    unknowns : Unknowns
    objective : Objective
    free : see `free_basis`
    damping, furthest : as of `fdcal.solvers.levenberg_marquardt.damped_step`
    blind : bool
        Whether no position is given, so that nothing holds the array as a whole.
    """
    try:
        here = objective.evaluate(unknowns)
    except np.linalg.LinAlgError:
        return ChannelStep(unknowns, np.inf, 0.0, DAMPING.first, 0.0, free)
    g, H = reduced(unknowns, here, free, blind)
    before = unknowns.vector
    step = damped_step(
        before,
        NewtonTerms(here.cost, g, H),
        lambda tried: _cost(objective, unknowns.at(tried)),
        lambda y: before + _expand(free, y, before.size),
        lambda tried: float(np.abs(unknowns.at(tried).positions - unknowns.positions).max()),
        damping,
        furthest,
    )
    return ChannelStep(unknowns.at(step.unknowns), step.cost, step.fall, step.damping, step.moved, free, here.terms, H)


def reduced(unknowns: Unknowns, here: Evaluation, free: np.ndarray, blind: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradient (F,) and the Gauss-Newton matrix (F, F) in the free directions.

    A blind array is held as a whole, and so is the gain that all channels share: the power of the field takes it up.
    """
    x = unknowns.positions
    N, D = x.shape
    g, H = here.gradient, here.matrix.copy()
    index = np.arange(len(g) - 1).reshape(N, -1)
    diagonal = np.diag(H)[:-1].reshape(N, -1)
    level = np.mean(diagonal[:, D : D + 2]) / N
    if blind:
        motions = np.linalg.qr(rigid_motions(x))[0]
        placed = index[:, :D].ravel()
        H[np.ix_(placed, placed)] += np.mean(diagonal[:, :D]) * (motions @ motions.T)
    for column in (D, D + 1):
        H[np.ix_(index[:, column], index[:, column])] += level
    if free.ndim == 1:
        return g[free], H[np.ix_(free, free)]
    return free.T @ g, free.T @ H @ free


def _expand(free: np.ndarray, y: np.ndarray, size: int) -> np.ndarray:
    if free.ndim == 2:
        return free @ y
    whole = np.zeros(size)
    whole[free] = y
    return whole


def _cost(objective: Objective, unknowns: Unknowns) -> float:
    try:
        return objective.evaluate(unknowns, 0).cost
    except np.linalg.LinAlgError:  # two microphones at the same place without noise
        return np.inf
