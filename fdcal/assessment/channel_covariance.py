"""Uncertainty of the positions with gains, phases and given positions marginalised over.

    H      Gauss-Newton matrix of cost and priors over everything that is free
    g_m    gradient of mode m; J = sum over groups of neighbouring modes of (sum g_m)(sum g_m)^T
    P      H^-1, and where the modes disagree more than the model says, enlarged to H^-1 J H^-1 (Huber 1967)

Without given positions, P is of the array without its rigid motions; in the frame of the least gauge, of the array
moved into that frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..cost.channel_likelihood import Terms, channel_terms
from ..model.gauge import GaugeFrame, rigid_motions
from ..model.problem import Problem
from ..solvers.robust import assumptions
from ..solvers.robust.channel_fit import reduced
from ..solvers.robust.convergence import scaled_inverse
from ..solvers.robust.objective import Objective, add_priors
from ..solvers.robust.settings import RULES, SCHEDULE
from ..solvers.robust.state import State


@dataclass(frozen=True)
class Grouping:
    """How neighbouring modes are grouped, whose gradients are not independent.

    Attributes
    ----------
    neighbours : modes in a group
    groups : fewest groups there must be; the groups are smaller where there are fewer modes
    """

    neighbours: int = 8
    groups: int = 6


GROUPING = Grouping()


@dataclass(frozen=True)
class Uncertainty:
    """The uncertainty of positions and gains.

    Attributes
    ----------
    covariance : (N, D, D) float64, metres^2
    curvature : (N, D, D) float64, metres^2, the same by H alone, where the modes agree as the model says
    gains : (N, 2) float64, one sigma of log gain, nepers, and phase, radians
    stretch_sigma : float, one sigma of the least certain stretching or shearing of the array as a whole, relative
    terms : Terms, the cost where the solver ended
    goal : Objective, whose minimum that is
    """

    covariance: np.ndarray
    curvature: np.ndarray
    gains: np.ndarray
    stretch_sigma: float
    terms: Terms
    goal: Objective


def uncertainty(problem: Problem, state: State, weaker: float = 1.0) -> Uncertainty:
    """Return the covariance of positions and gains where the solver ended.

    Parameters
    ----------
    problem : Problem
        With modes of unit power (`fdcal.solvers.robust.unit_power`).
    state : State
    weaker : float
        Factor on the power of the field in H alone, which weakens the prior of an isotropic field: what then becomes
        uncertain rests on that prior and not on the wave equation.
    """
    progress = replace(state.progress, row=len(SCHEDULE) - 1)
    state = replace(state, progress=progress, shape=state.positions)
    used = assumptions.used_modes(problem, state, 0)
    goal = assumptions.objective(problem, state, used)
    goal = replace(goal, field=replace(goal.field, noise=_undeflated(problem, state, goal.field)))
    terms = channel_terms(state.positions, state.gains, goal.pressures, goal.field, 3)
    slopes = np.asarray(terms.slopes)  # derivatives = 3 computes them
    if weaker != 1.0:
        loose = replace(goal.field, power=weaker * goal.field.power)
        terms = channel_terms(state.positions, state.gains, goal.pressures, loose)
    add_priors(state.positions, state.gains, goal.priors, terms)
    N, D = state.positions.shape
    P = D + 2
    index = np.arange(N * P).reshape(N, P)
    free = index.ravel() if goal.priors.gain_sigma > 0 else index[:, :D].ravel()
    H = reduced(state.positions, terms, free, not len(problem.known))[1]
    inverse = scaled_inverse(H)
    flat = slopes.reshape(len(slopes), -1)[:, free]
    influences = [-(part @ inverse) for part in (_about_zero(flat), _about_zero(_grouped(flat)))]
    where = np.searchsorted(free, index[:, :D].ravel())
    gauge = _gauge(problem, state.positions)
    newton = gauge @ inverse[np.ix_(where, where)] @ gauge.T
    moves = [v[:, where] @ gauge.T for v in influences]
    blocks = np.einsum("nanb->nab", newton.reshape(N, D, N, D))
    return Uncertainty(
        _enlarged(blocks, moves),
        blocks,
        _gain_sigma(inverse, free, index, D),
        _stretch_sigma(newton, moves, state),
        terms,
        goal,
    )


def _undeflated(problem: Problem, state: State, field) -> np.ndarray:
    """The noise without what the near kernel's stage takes off it; never below what the kernel explains."""
    return field.noise * (RULES.near_deflation if state.model.kernel == "near" else 1.0)


def _grouped(slopes) -> np.ndarray:
    count = max(1, len(slopes) // max(1, min(GROUPING.neighbours, len(slopes) // GROUPING.groups)))
    return np.array([part.sum(axis=0) for part in np.array_split(slopes, count)])


def _about_zero(influences) -> np.ndarray:
    return (influences - influences.mean(axis=0)) * np.sqrt(len(influences) / max(len(influences) - 1, 1))


def _gauge(problem: Problem, positions) -> np.ndarray:
    """Projection (N D, N D) that takes rigid motions off: onto the frame, or onto no motion in the mean."""
    size = positions.size
    if len(problem.known):
        return np.eye(size)
    R = rigid_motions(positions)
    if problem.frame is None:
        Q = np.linalg.qr(R)[0]
        return np.eye(size) - Q @ Q.T
    fixed = _frame_rows(problem.frame, positions)
    return np.eye(size) - R @ np.linalg.solve(fixed @ R, fixed)


def _frame_rows(frame: GaugeFrame, positions) -> np.ndarray:
    """Linear functions of the positions (F, N D) that the frame fixes: the first point, then what is across."""
    N, D = positions.shape
    first = positions[frame.microphones[0]]
    axes = np.linalg.qr((positions[frame.microphones[1:]] - first).T)[0]
    rows = []
    for a in range(D):
        rows.append(_row(N, D, frame.microphones[0], np.eye(D)[a]))
    for i, n in enumerate(frame.microphones[1:D]):
        for a in range(i + 1, D):
            rows.append(_row(N, D, n, axes[:, a]))
    return np.array(rows)


def _row(N: int, D: int, n: int, direction) -> np.ndarray:
    row = np.zeros((N, D))
    row[n] = direction
    return row.ravel()


def _enlarged(blocks, moves) -> np.ndarray:
    """Blocks (N, D, D) of the covariance, enlarged where the modes disagree."""
    N, D = blocks.shape[:2]
    influences = np.max([np.sum(v.reshape(-1, N, D) ** 2, axis=(0, 2)) for v in moves], axis=0)
    size = np.trace(blocks, axis1=1, axis2=2)
    return np.maximum(1.0, influences / np.maximum(size, np.finfo(float).tiny))[:, None, None] * blocks


def _gain_sigma(inverse, free, index, D: int) -> np.ndarray:
    if len(free) < index.size:
        return np.zeros((len(index), 2))
    return np.sqrt(np.maximum(np.diag(inverse)[index[:, D:]], 0.0))


def _stretch_sigma(newton, moves, state: State) -> float:
    """`Uncertainty.stretch_sigma`: of the maps x -> x + B x that fit a move best."""
    x = state.positions - state.positions.mean(axis=0)
    N, D = x.shape
    fit = np.kron(np.linalg.pinv(np.column_stack([x, np.ones(N)]))[:D], np.eye(D))  # (D D, N D)
    symmetric = np.array([(B + B.T).ravel() / 2 for B in np.eye(D * D).reshape(-1, D, D)])
    fit = symmetric @ fit
    variances = [fit @ newton @ fit.T] + [(v @ fit.T).T @ (v @ fit.T) for v in moves]
    return float(np.sqrt(max(np.linalg.eigvalsh(V)[-1] for V in variances)))
