"""Levenberg-Marquardt steps of the positions on the cost of `fdcal.cost.likelihood`, in a subspace x0 + basis y."""

from __future__ import annotations

import numpy as np

from ..cost.likelihood import DiffuseField, newton_terms, total_cost
from ..model.gauge import rigid_motions
from .levenberg_marquardt import DAMPING, NewtonTerms, Step, damped_step


def position_step(
    positions: np.ndarray,
    pressures: np.ndarray,
    field: DiffuseField,
    basis: np.ndarray | None,
    damping: float,
    furthest: float = np.inf,
    shortest: float = 0.0,
) -> Step:
    """Return one damped Gauss-Newton step of the positions.

    Parameters
    ----------
    positions : (N, D) float64, metres
    pressures : (M, N) complex128
    field : DiffuseField
    basis : (N D, F) float64 or None
        Directions in which the positions may move, perhaps none; None lets all microphones move.
    damping, furthest, shortest : as of `fdcal.solvers.levenberg_marquardt.damped_step`

    Returns
    -------
    Step, whose `unknowns` are positions (N, D), metres; its cost is infinite if the covariance is singular
    """
    N, D = positions.shape
    if basis is not None and not basis.shape[1]:
        return Step(positions, total_cost(positions, pressures, field), 0.0, DAMPING.first, 0.0)
    try:
        cost, gradient, curvature = newton_terms(positions, pressures, field)
    except np.linalg.LinAlgError:
        return Step(positions, np.inf, 0.0, DAMPING.first, 0.0)
    g, H = gradient.ravel(), curvature.reshape(N * D, N * D)
    if basis is None:
        R = np.linalg.qr(rigid_motions(positions))[0]
        H = H + np.diag(H).mean() * (R @ R.T)  # the cost does not fix the array as a whole, which would drift
    else:
        g, H = basis.T @ g, basis.T @ H @ basis
    return damped_step(
        positions,
        NewtonTerms(cost, g, H),
        lambda tried: finite_cost(tried, pressures, field),
        lambda y: positions + (y if basis is None else basis @ y).reshape(N, D),
        lambda tried: float(np.abs(tried - positions).max()),
        damping,
        furthest,
        shortest,
    )


def minimise(
    positions: np.ndarray, pressures: np.ndarray, field: DiffuseField, basis: np.ndarray, steps: int, tolerance: float
) -> np.ndarray:
    """Return the positions after damped steps, until the cost falls by less than 1 or nothing moves.

    Parameters
    ----------
    positions : (N, D) float64, metres
    pressures : (M, N) complex128
    field : DiffuseField
    basis : (N D, F) float64, directions in which the positions may move
    steps : int, at most
    tolerance : metres, greatest change of a coordinate in the last step

    Returns
    -------
    (N, D) float64, metres
    """
    furthest = float(np.ptp(positions, axis=0).max()) / 2  # a huge array would need expansions of a huge order
    step = Step(positions, np.inf, np.inf, DAMPING.first, np.inf)
    for _ in range(steps):
        step = position_step(step.unknowns, pressures, field, basis, step.damping, furthest)
        if step.moved < tolerance or step.fall < 1.0:
            break
    return step.unknowns


def finite_cost(positions: np.ndarray, pressures: np.ndarray, field: DiffuseField) -> float:
    """Return `fdcal.cost.likelihood.total_cost`; infinity if the covariance is singular."""
    try:
        return total_cost(positions, pressures, field)
    except np.linalg.LinAlgError:  # two microphones at the same place without noise
        return np.inf
