"""Levenberg-Marquardt on the likelihood, with the positions confined to x0 + basis y."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..likelihood import DiffuseField, likelihood, newton_terms

FIRST_DAMPING = 1e-3
MOST_DAMPING = 1e8
LEAST_DAMPING = 1e-9


@dataclass(frozen=True)
class Trial:
    """Result of one damped step: positions (N, D), metres, cost, damping for the next, longest move, metres."""

    positions: np.ndarray
    cost: float
    damping: float
    moved: float


def damped_step(positions, pressures, field: DiffuseField, basis: np.ndarray, damping: float) -> Trial:
    """One Gauss-Newton step, damped as much as it takes for the cost to fall; where nothing helps, no step.

    basis : (N D, F) float64, directions in which the positions may move; None lets all move
    """
    N, D = positions.shape
    cost, gradient, curvature = newton_terms(positions, pressures, field)
    g, H = gradient.ravel(), curvature.reshape(N * D, N * D)
    if basis is not None:
        g, H = basis.T @ g, basis.T @ H @ basis
    scale = np.maximum(np.diag(H), 1e-12 * np.diag(H).max())
    while damping < MOST_DAMPING:
        y = -np.linalg.solve(H + damping * np.diag(scale), g)
        tried = positions + (y if basis is None else basis @ y).reshape(N, D)
        lower = _cost(tried, pressures, field)
        if lower < cost:
            return Trial(tried, lower, max(damping / 10, LEAST_DAMPING), float(np.abs(tried - positions).max()))
        damping = max(damping, FIRST_DAMPING) * 6
    return Trial(positions, cost, FIRST_DAMPING, 0.0)


def minimise(positions, pressures, field, basis, iterations: int, tolerance: float = 1e-3) -> tuple[np.ndarray, float]:
    """Damped steps until none moves a microphone by `tolerance` metres : positions (N, D) and cost."""
    trial = Trial(positions, np.inf, FIRST_DAMPING, np.inf)
    for _ in range(iterations):
        trial = damped_step(trial.positions, pressures, field, basis, trial.damping)
        if trial.moved < tolerance:
            break
    return trial.positions, trial.cost


def _cost(positions, pressures, field: DiffuseField) -> float:
    try:
        return float(likelihood(positions, pressures, field).sum())
    except np.linalg.LinAlgError:  # two microphones in one place without noise
        return np.inf
