"""One damped Gauss-Newton step of positions and gains together (Levenberg-Marquardt)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ...cost.channel_likelihood import Terms
from ...model.gauge import rigid_motions
from .objective import Objective

FIRST_DAMPING, MOST_DAMPING, LEAST_DAMPING = 1e-3, 1e6, 1e-9
LEAST_FALL = 1e-12  # of the cost, as a part of it: less is lost in rounding


@dataclass(frozen=True)
class Step:
    """Result of one step: positions, gains, cost, by how much it fell, damping for the next, longest move, metres.

    terms, matrix: of the point from which the step was taken; matrix (F, F) in the coordinates `free`
    """

    positions: np.ndarray
    gains: np.ndarray
    cost: float
    fall: float
    damping: float
    moved: float
    terms: Terms | None
    free: np.ndarray | None
    matrix: np.ndarray | None


def free_basis(positions, deformations, gains: bool) -> np.ndarray:
    """Return the directions (N P, F) in which the parameters may move, P = D + 2, or the indices of free parameters.

    deformations : (N D, F) float64 or None, directions of the positions; None lets all move
    """
    N, D = positions.shape
    index = np.arange(N * (D + 2)).reshape(N, D + 2)
    columns = [index[:, D]] * gains + [index[:, D + 1]] * gains
    if deformations is None:
        return np.concatenate([index[:, :D].ravel(), *columns]) if columns else index[:, :D].ravel()
    freed = np.concatenate(columns) if columns else np.zeros(0, int)
    basis = np.zeros((N * (D + 2), deformations.shape[1] + len(freed)))
    basis[index[:, :D].ravel(), : deformations.shape[1]] = deformations
    basis[freed, deformations.shape[1] + np.arange(len(freed))] = 1.0
    return basis


def damped_step(positions, gains, objective: Objective, free, damping: float, furthest: float, blind: bool) -> Step:
    """One step, damped as much as it takes for the cost to fall; where nothing helps, none.

    free : as of `free_basis`; furthest : metres, more damping where a microphone would move further
    blind : whether nothing holds the array as a whole
    """
    N, D = positions.shape
    try:
        cost, terms = objective.evaluate(positions, gains)
    except np.linalg.LinAlgError:
        return Step(positions, gains, np.inf, 0.0, FIRST_DAMPING, 0.0, None, None, None)
    g, H = reduced(positions, terms, free, blind)
    scale = np.maximum(np.diag(H), 1e-12 * np.diag(H).max())
    while damping < MOST_DAMPING:
        y = _solve(H, damping * scale, -g)
        delta = _expand(free, y, N * (D + 2)).reshape(N, D + 2)
        tried, turned = positions + delta[:, :D], gains + delta[:, D:]
        moved = float(np.abs(delta[:, :D]).max())
        lower = _cost(objective, tried, turned) if moved <= furthest else np.inf
        if lower < cost:
            return Step(tried, turned, lower, cost - lower, max(damping / 10, LEAST_DAMPING), moved, terms, free, H)
        if -(g @ y) < LEAST_FALL * abs(cost):
            break
        damping = max(damping, FIRST_DAMPING) * 6
    return Step(positions, gains, cost, 0.0, FIRST_DAMPING, 0.0, terms, free, H)


def reduced(positions, terms: Terms, free, blind: bool):
    """Gradient (F,) and Gauss-Newton matrix (F, F) in the free directions; a blind array is held as a whole."""
    N, D = positions.shape
    P = D + 2
    g, H = terms.gradient.ravel(), terms.curvature.reshape(N * P, N * P)
    if blind:
        R = np.zeros((N, P, D * (D + 1) // 2))
        R[:, :D] = np.linalg.qr(rigid_motions(positions))[0].reshape(N, D, -1)
        R = R.reshape(N * P, -1)
        H = H + np.mean(np.diag(H).reshape(N, P)[:, :D]) * (R @ R.T)
    else:
        H = H.copy()
    level = np.mean(np.diag(H).reshape(N, P)[:, D:]) / N
    for column in (D, D + 1):  # the power of the field takes up a gain that is common to all
        H[column::P, column::P] += level
    if free.ndim == 1:
        return g[free], H[np.ix_(free, free)]
    return free.T @ g, free.T @ H @ free


def _expand(free, y, size: int) -> np.ndarray:
    if free.ndim == 2:
        return free @ y
    whole = np.zeros(size)
    whole[free] = y
    return whole


def _cost(objective: Objective, positions, gains) -> float:
    try:
        return objective.evaluate(positions, gains, 0)[0]
    except np.linalg.LinAlgError:  # two microphones in one place without noise
        return np.inf


def _solve(H, damping, g) -> np.ndarray:
    damped = H.copy()
    damped[np.diag_indices(len(H))] += damping
    try:
        return cho_solve(cho_factor(damped, check_finite=False, overwrite_a=True), g, check_finite=False)
    except np.linalg.LinAlgError:
        damped[np.diag_indices(len(H))] += damping + 1e-9 * np.diag(H).max()
        return np.linalg.lstsq(damped, g, rcond=None)[0]
