"""Whether another array fits the pressures as well as the one found.

A rival is another minimum of the cost: its positions, and by how much its cost is higher.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..cost.likelihood import newton_terms
from ..model.gauge import align, position_errors
from ..model.problem import Problem
from ..solvers.levenberg_marquardt import DAMPING
from ..solvers.position_fit import position_step
from .diagnostics import Diagnostics
from .error_ellipses import one_sigma
from .findings import equally_likely, hardly_determined, only_wavenumber_scales, root_mean_square
from .thresholds import LIMITS
from .uncertainty import pressures_and_field

STEPS = 6  # of the descent from the mirror image into its minimum

Rival = tuple[np.ndarray, float]


def ambiguous(problem: Problem, positions: np.ndarray, figures: Diagnostics, rivals: Sequence[Rival]) -> str:
    """Report that the positions are uncertain, or that a distant rival costs hardly more; "" otherwise.

    Parameters
    ----------
    positions : (N, D) float64, metres
    rivals : positions (N, D), metres, and excess of -log probability density
    """
    size = rms_radius(positions)
    sigma = root_mean_square(one_sigma(figures.covariance))
    if sigma > LIMITS.relative_sigma * size and not only_wavenumber_scales(problem, figures):
        return hardly_determined(sigma)
    for rival, excess in rivals:
        placed = rival if len(problem.known) else align(rival, positions)
        away = root_mean_square(position_errors(placed, positions))
        if excess < LIMITS.rival_cost and away > max(LIMITS.rival_sigmas * sigma, LIMITS.rival_distance * size):
            return equally_likely(away)
    return ""


def rms_radius(positions: np.ndarray) -> float:
    """Return the root mean square distance of positions (N, D), metres, from their centre, metres."""
    return float(np.sqrt(np.mean(np.sum((positions - positions.mean(axis=0)) ** 2, axis=1))))


def mirrored_rivals(
    problem: Problem, positions: np.ndarray, modes: slice, noise: np.ndarray | None, figures: Diagnostics
) -> list[Rival]:
    """Return the mirror image of the array at the line or plane nearest to the known microphones, as a rival.

    Known microphones that lie nearly on one line leave the side undetermined. Where the nearest line or plane misses
    them by more than `VerdictThresholds.mirror_sigmas`, they determine it, and there is no rival. The image is moved
    into the minimum of the cost near it.

    Parameters
    ----------
    positions : (N, D) float64, metres
    modes, noise : as of `fdcal.assessment.verdict.judge`
    """
    known = problem.known
    if len(known) < 2 or not len(problem.free):
        return []
    p, field = pressures_and_field(problem, positions, modes, noise)
    centre = positions[known].mean(axis=0)
    normal = np.linalg.svd(positions[known] - centre)[2][-1]
    distance = np.abs((positions[known] - centre) @ normal).max()
    if distance > LIMITS.mirror_sigmas * one_sigma(figures.covariance).max():
        return []
    image = positions - 2 * np.outer((positions - centre) @ normal, normal)
    image[known] = positions[known]
    D = positions.shape[1]
    basis = np.eye(positions.size)[:, (D * problem.free[:, None] + np.arange(D)).ravel()]
    damping, cost = DAMPING.first, newton_terms(positions, p, field)[0]
    reached = cost
    for _ in range(STEPS):
        trial = position_step(image, p, field, basis, damping)
        image, damping, reached = trial.unknowns, trial.damping, trial.cost
    return [(image, float(reached - cost))]
