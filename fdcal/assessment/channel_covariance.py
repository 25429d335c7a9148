"""Uncertainty of the positions with gains, filters, given positions and the sound speed marginalised over.

    H      Gauss-Newton matrix of cost and priors over everything that is free
    g_m    gradient of mode m; J = sum over groups of neighbouring modes of (sum g_m)(sum g_m)^T
    P      H^-1, and where the modes disagree more than the model says, enlarged to H^-1 J H^-1 (Huber 1967)

Without given positions, P is of the array without its rigid motions; in the frame of the least gauge, of the array
moved into that frame. The sound speed and the size of such an array are one: its uncertainty adds sigma_c^2 x x^T.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..cost.channel_likelihood import Terms
from ..model.gauge import GaugeFrame, rigid_motions
from ..model.problem import Problem
from ..solvers.robust import assumptions
from ..solvers.robust.channel_fit import reduced
from ..solvers.robust.conditional import stretch_sigma
from ..solvers.robust.convergence import scaled_inverse
from ..solvers.robust.objective import Evaluation, Objective, Unknowns
from ..solvers.robust.settings import FINAL
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
    filters : (N, 2) float64, one sigma of delay, metres, and corner, rad/m, as of `fdcal.solvers.robust.state`; 0 for
        a channel without
    log_speed : float, one sigma of the logarithm of the sound speed; 0 for one that is fixed
    stretch_sigma : float, one sigma of the least certain stretching or shearing of the array as a whole, relative
    terms : Terms, the cost where the solver ended, with the weaker field
    goal : Objective, whose minimum that is
    at_goal : Terms, of `goal` there
    """

    covariance: np.ndarray
    curvature: np.ndarray
    gains: np.ndarray
    filters: np.ndarray
    log_speed: float
    stretch_sigma: float
    terms: Terms
    goal: Objective
    at_goal: Terms


def uncertainty(problem: Problem, state: State, weaker: float = 1.0) -> Uncertainty:
    """Return the covariance of positions and gains where the solver ended.

    Parameters
    ----------
    problem : Problem
        With modes of unit power (`fdcal.solvers.robust.unit_power`).
    state : State
    weaker : float
        Factor on the power of the field in H alone, which weakens the prior of an isotropic field: what then becomes
        uncertain rests on that prior and not on the wave equation. A conditional likelihood needs none.
    """
    progress = replace(state.progress, row=FINAL)
    state = replace(state, progress=progress, shape=state.positions)
    used = assumptions.used_modes(problem, state, 0)
    goal = assumptions.objective(problem, state, used)
    goal = replace(goal, field=replace(goal.field, noise=_undeflated(state, goal.field)))
    here, free = assumptions.unknowns(state), assumptions.free_unknowns(problem, state, None)
    terms = goal.evaluate(here, 3).terms
    slopes = np.asarray(terms.slopes).reshape(len(used), -1)  # derivatives = 3 computes them
    slopes = np.column_stack([slopes, slopes @ here.by_speed()])[:, free]
    evaluated = _weakened(goal, weaker, here)
    H = reduced(here, evaluated, free, not len(problem.known))[1]
    inverse = scaled_inverse(H)
    influences = [-(part @ inverse) for part in (_about_zero(slopes), _about_zero(_grouped(slopes)))]
    N, D = state.positions.shape
    where = np.arange(N * D)  # the positions are the first of the free unknowns
    gauge = _gauge(problem, state.positions)
    newton = gauge @ inverse[np.ix_(where, where)] @ gauge.T
    if not len(problem.known):
        newton = newton + _of_size(state)
    moves = [v[:, where] @ gauge.T for v in influences]
    sigma = np.zeros(here.vector.size)
    sigma[free] = np.sqrt(np.maximum(np.diag(inverse), 0.0))
    channels = sigma[:-1].reshape(N, -1)[:, D:]
    blocks = np.einsum("nanb->nab", newton.reshape(N, D, N, D))
    return Uncertainty(
        _enlarged(blocks, moves),
        blocks,
        channels[:, :2],
        channels[:, 2:] if channels.shape[1] > 2 else np.zeros((N, 2)),
        float(sigma[-1]) if len(problem.known) else state.settings.sound_speed_sigma or 0.0,
        stretch_sigma(state.positions, [newton, *(v.T @ v for v in moves)]),
        evaluated.terms,
        goal,
        terms,
    )


def _weakened(goal: Objective, weaker: float, here: Unknowns) -> Evaluation:
    """The objective with a field of more power; as it is where it is conditional, and where C is then singular."""
    if goal.field.conditional is not None:
        return goal.evaluate(here)
    try:
        return replace(goal, field=replace(goal.field, power=weaker * goal.field.power)).evaluate(here)
    except np.linalg.LinAlgError:
        return goal.evaluate(here)


def _of_size(state: State) -> np.ndarray:
    """Covariance (N D, N D) of a blind array by the sound speed, which is its size."""
    x = (state.positions - state.positions.mean(axis=0)).ravel()
    return (state.settings.sound_speed_sigma or 0.0) ** 2 * np.outer(x, x)


def _undeflated(state: State, field) -> np.ndarray:
    """The noise without what the last stage takes off it; never below what the kernel explains."""
    return field.noise * state.model.deflation


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
