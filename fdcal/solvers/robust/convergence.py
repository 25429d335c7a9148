"""Whether the solver is at its minimum: the Newton step that is left, against one sigma of each coordinate.

    H d = -g,   sigma_i^2 = (H^-1)_ii

g and H belong to the whole objective, priors included, at the end of the run. A limit in metres or nats cannot serve
all measurements: a micrometre is far for one, and a millimetre near for another.
"""

from __future__ import annotations

import numpy as np

from ...model.gauge import align
from ...model.problem import Problem
from . import assumptions
from .channel_fit import reduced
from .settings import OUTLIERS, RULES
from .state import State

LEAST_EIGENVALUE = 1e-13  # of the scaled Gauss-Newton matrix, dimensionless


def remaining_step(problem: Problem, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Return the Newton step that is left, and one sigma of every coordinate.

    Parameters
    ----------
    problem : Problem
        With modes of unit power (`fdcal.solvers.robust.unit_power`).
    state : State

    Returns
    -------
    step, sigma : (N, D) float64, metres

    Raises
    ------
    numpy.linalg.LinAlgError
        A covariance is not positive definite.
    """
    goal = assumptions.objective(problem, state, assumptions.used_modes(problem, state, 0))
    here, free = assumptions.unknowns(state), assumptions.free_unknowns(problem, state, None)
    g, H = reduced(here, goal.evaluate(here), free, not len(problem.known))
    inverse = scaled_inverse(H)
    count = state.positions.size  # the coordinates come first
    step, variance = -(inverse @ g)[:count], np.diag(inverse)[:count]
    return step.reshape(state.positions.shape), np.sqrt(variance).reshape(state.positions.shape)


def scaled_inverse(H: np.ndarray) -> np.ndarray:
    """Return the inverse of a positive semidefinite matrix (F, F) whose parameters may have different units."""
    scale = 1 / np.sqrt(np.diag(H))
    values, vectors = np.linalg.eigh(H * np.outer(scale, scale))
    return scale[:, None] * ((vectors / np.maximum(values, LEAST_EIGENVALUE)) @ vectors.T) * scale


def is_converged(problem: Problem, state: State) -> bool:
    """Return whether no healthy channel is farther from the minimum than a small part of its sigma.

    Where there are given positions, a step of the array as a whole does not count: `attempts.anchored` has moved the
    array onto them, since they say more of it than the pressures do.
    """
    try:
        step, sigma = remaining_step(problem, state)
    except np.linalg.LinAlgError:
        return False
    x, healthy = state.positions, state.model.channel_noise < OUTLIERS.suspicious
    if len(problem.known) and problem.frame is None and np.any(healthy):
        step = align(x + step, x, healthy) - x
    return bool(np.all(np.abs(step[healthy]) < RULES.converged_sigmas * sigma[healthy]))
