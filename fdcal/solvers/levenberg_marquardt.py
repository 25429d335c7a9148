"""Levenberg-Marquardt on the cost of `fdcal.cost.likelihood`, with the positions confined to x0 + basis y."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ..cost.likelihood import DiffuseField, newton_terms, total_cost
from ..model.gauge import rigid_motions

FIRST_DAMPING = 1e-3
MOST_DAMPING = 1e6
LEAST_DAMPING = 1e-9
LEAST_FALL = 1e-12  # of the cost, as a part of it: less is lost in rounding


@dataclass(frozen=True)
class Trial:
    """Result of one damped step: positions (N, D), metres, cost, by how much it fell, damping for the next, longest
    move, metres."""

    positions: np.ndarray
    cost: float
    fall: float
    damping: float
    moved: float


def damped_step(
    positions, pressures, field: DiffuseField, basis, damping: float, furthest=np.inf, shortest=0.0
) -> Trial:
    """One Gauss-Newton step, damped as much as it takes for the cost to fall; where nothing helps, no step.

    basis : (N D, F) float64, directions in which the positions may move, perhaps none; None lets all move
    furthest : metres; a step that moves a microphone further is damped more, for it may leave a basin for a distant one
    shortest : metres; one that moves none as far, and lets the cost rise, is the last that is tried
    """
    N, D = positions.shape
    if basis is not None and not basis.shape[1]:
        return Trial(positions, total_cost(positions, pressures, field), 0.0, FIRST_DAMPING, 0.0)
    try:
        cost, gradient, curvature = newton_terms(positions, pressures, field)
    except np.linalg.LinAlgError:  # nowhere to go from here
        return Trial(positions, np.inf, 0.0, FIRST_DAMPING, 0.0)
    g, H = gradient.ravel(), curvature.reshape(N * D, N * D)
    if basis is None:
        R = np.linalg.qr(rigid_motions(positions))[0]
        H = H + np.diag(H).mean() * (R @ R.T)  # the cost does not hold the array as a whole, which would drift
    else:
        g, H = basis.T @ g, basis.T @ H @ basis
    scale = np.maximum(np.diag(H), 1e-12 * np.diag(H).max())
    while damping < MOST_DAMPING:
        y = _solve(H + damping * np.diag(scale), -g)
        tried = positions + (y if basis is None else basis @ y).reshape(N, D)
        moved = float(np.abs(tried - positions).max())
        lower = finite_cost(tried, pressures, field) if moved <= furthest else np.inf
        if lower < cost:
            return Trial(tried, lower, cost - lower, max(damping / 10, LEAST_DAMPING), moved)
        if moved < shortest or -(g @ y) < LEAST_FALL * abs(cost):  # all that this step promises
            break
        damping = max(damping, FIRST_DAMPING) * 6
    return Trial(positions, cost, 0.0, FIRST_DAMPING, 0.0)


def minimise(positions, pressures, field, basis, iterations: int, tolerance: float) -> np.ndarray:
    """Damped steps until none moves a microphone by `tolerance` metres, or -log likelihood falls by 1 : (N, D).

    No step is longer than half the array: a huge array has a field of orders without number.
    """
    furthest = float(np.ptp(positions, axis=0).max()) / 2
    trial = Trial(positions, np.inf, np.inf, FIRST_DAMPING, np.inf)
    for _ in range(iterations):
        trial = damped_step(trial.positions, pressures, field, basis, trial.damping, furthest)
        if trial.moved < tolerance or trial.fall < 1.0:
            break
    return trial.positions


def _solve(H: np.ndarray, g: np.ndarray) -> np.ndarray:
    try:
        return cho_solve(cho_factor(H, check_finite=False), g, check_finite=False)
    except np.linalg.LinAlgError:  # rounding has made it indefinite: the gauge is free and the damping is low
        return np.linalg.lstsq(H, g, rcond=None)[0]


def finite_cost(positions, pressures, field: DiffuseField) -> float:
    """`fdcal.cost.likelihood.total_cost`, infinite where it cannot be computed."""
    try:
        return total_cost(positions, pressures, field)
    except np.linalg.LinAlgError:  # two microphones in one place without noise
        return np.inf
