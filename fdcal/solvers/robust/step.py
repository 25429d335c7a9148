"""One Levenberg-Marquardt step of everything that is free, and how far it leaves the solver from its minimum.

    H d = -g,   sigma_i^2 = (H^-1)_ii

g and H belong to the whole objective, priors included. A run has converged when the Newton step d that is left is a
small part of sigma: a limit in metres or nats cannot serve all measurements.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from ...cost.likelihood import Terms
from ...model.gauge import align, rigid_motions
from ...model.problem import Problem
from ..levenberg_marquardt import DAMPING, NewtonTerms, damped_step
from .arrivals import Source
from .objective import Evaluation, Objective, Priors, Unknowns, objective_of, speed_is_free, unknowns_of, used_modes
from .rules import OUTLIERS, STEPS
from .state import State

DISTINCT = 1e-3  # a shape that moves the array by less, relative, is that of the microphones that stay


@dataclass(frozen=True)
class ChannelStep:
    """Result of one step."""

    unknowns: Unknowns
    cost: float  # infinite where a covariance is singular
    fall: float  # by how much the cost has fallen
    damping: float  # of the next step
    moved: float  # metres, greatest change of a coordinate
    free: np.ndarray  # see `free_directions`
    terms: Terms | None = None  # Terms at the point from which the step was taken; None where a covariance is singular
    matrix: np.ndarray | None = None  # (F, F) float64, Gauss-Newton matrix in the free directions; None with `terms`
    source: Source | None = None  # Source of the arrivals there; None without any


def free_directions(unknowns: Unknowns, held, deformations=None, speed: bool = False) -> np.ndarray:
    """Return the directions in which the unknowns may move.

    held : microphones whose coordinates never move, (A,) int64; deformations : (N D, F) float64 or None, directions of
    the positions, of which those that are left may move; speed : whether the sound speed is free. Delays and corners
    are free where `Unknowns.filters` says so.

    Returns (N P + 1, F) float64, or, where every microphone moves for itself, the indices (F,) int64 of the unknowns.
    """
    N, D = unknowns.positions.shape
    size = unknowns.vector.size
    index = np.arange(size - 1).reshape(N, -1)
    freed = []
    if unknowns.gains:
        freed.append(index[:, D : D + 2].T.ravel())
        filters = unknowns.channels[:, 2:]
        freed.append(index[:, D + 2 :][(filters != 0) | unknowns.filters])
    rest = np.concatenate([*freed, [size - 1] if speed else []]).astype(np.int64)
    if deformations is None:
        return np.concatenate([np.delete(index[:, :D], held, axis=0).ravel(), rest])
    basis = np.zeros((size, deformations.shape[1] + len(rest)))
    basis[index[:, :D].ravel(), : deformations.shape[1]] = deformations
    basis[rest, deformations.shape[1] + np.arange(len(rest))] = 1.0
    return basis


def polynomial_deformations(positions: np.ndarray, held: np.ndarray, degree: int) -> np.ndarray:
    """Return an orthonormal basis (N D, F) of smooth deformations that leave the microphones `held` in place.

    The error of a rough start is smooth, as the field is. Every coordinate moves by a polynomial of positions (N, D),
    metres, less what `interpolation` makes of it at the microphones that stay. The degree is lower if the array has too
    few microphones to distinguish the monomials.
    """
    N, D = positions.shape
    z = positions - positions.mean(axis=0)
    z = z / np.sqrt(np.mean(z**2))
    columns = [np.ones(N)]
    for d in range(1, degree + 1):
        more = [np.prod(z[:, list(c)], axis=1) for c in combinations_with_replacement(range(D), d)]
        if d > 1 and len(columns) + len(more) > N / 2:
            break
        columns += more
    shapes = np.linalg.qr(np.column_stack(columns))[0]
    if len(held):
        left = shapes - interpolation(positions, held) @ shapes[held]
        left[held] = 0.0  # exactly
        U, values, _ = np.linalg.svd(left, full_matrices=False)
        shapes = U[:, values > DISTINCT]
        shapes[held] = 0.0
    return np.kron(shapes, np.eye(D))


def interpolation(positions: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Return the weights (N, A) by which moves of microphones `held` (A,) become a smooth move of the whole array.

    Kriging with the covariance (1 + r / l) exp(-r / l), l the radius of the array: far from them nothing moves.
    """
    x = positions
    radius = np.sqrt(np.mean(np.sum((x - x.mean(axis=0)) ** 2, axis=1)))
    r = np.linalg.norm(x[:, None] - x[held], axis=-1) / radius
    K = (1 + r) * np.exp(-r)
    return K @ np.linalg.pinv(K[held], hermitian=True)


def channel_step(
    unknowns: Unknowns, objective: Objective, free: np.ndarray, damping: float, blind: bool, max_step: float = np.inf
) -> ChannelStep:
    """Return one damped Gauss-Newton step; free, blind as of `reduced`, max_step in metres."""
    try:
        here = objective.evaluate(unknowns)
    except np.linalg.LinAlgError:
        return ChannelStep(unknowns, np.inf, 0.0, DAMPING.first, 0.0, free)
    if not free.shape[-1]:
        return ChannelStep(unknowns, here.cost, 0.0, DAMPING.first, 0.0, free, here.terms, np.zeros((0, 0)))
    g, H = reduced(unknowns, here, free, blind)
    before, near = unknowns.vector, objective.beside(here.source)
    step = damped_step(
        before,
        NewtonTerms(here.cost, g, H),
        lambda tried: near.evaluate(unknowns.at(tried), False).cost,
        lambda y: before + (free @ y if free.ndim == 2 else np.bincount(free, y, before.size)),
        lambda tried: float(np.abs(unknowns.at(tried).positions - unknowns.positions).max()),
        damping,
        max_step,
    )
    moved = unknowns.at(step.unknowns)
    return ChannelStep(moved, step.cost, step.fall, step.damping, step.moved, free, here.terms, H, here.source)


def reduced(unknowns: Unknowns, here: Evaluation, free: np.ndarray, blind: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradient (F,) and the Gauss-Newton matrix (F, F) in the free directions.

    A `blind` array, which no given position holds, is held as a whole, and so are gain and delay that all channels
    share: the field takes them up.
    """
    x = unknowns.positions
    N, D = x.shape
    g, H = here.gradient, here.matrix.copy()
    index = np.arange(len(g) - 1).reshape(N, -1)
    diagonal = np.diag(H)[:-1].reshape(N, -1)
    if blind:
        motions = np.linalg.qr(rigid_motions(x))[0]
        placed = index[:, :D].ravel()
        H[np.ix_(placed, placed)] += np.mean(diagonal[:, :D]) * (motions @ motions.T)
    for column in (D, D + 1) if unknowns.gains else ():
        H[np.ix_(index[:, column], index[:, column])] += np.mean(diagonal[:, D : D + 2]) / N
    if unknowns.gains and unknowns.filters:
        H[np.ix_(index[:, D + 2], index[:, D + 2])] += np.mean(diagonal[:, D + 2]) / N
    if free.ndim == 1:
        return g[free], H[np.ix_(free, free)]
    return free.T @ g, free.T @ H @ free


def scaled_inverse(H: np.ndarray) -> np.ndarray:
    """Return the inverse of a positive semidefinite matrix (F, F) whose parameters may have different units."""
    scale = 1 / np.sqrt(np.diag(H))
    values, vectors = np.linalg.eigh(H * np.outer(scale, scale))
    return scale[:, None] * ((vectors / np.maximum(values, STEPS.min_eigenvalue)) @ vectors.T) * scale


def free_coordinates(shape: tuple[int, int], held) -> np.ndarray:
    """Return the numbers, of N D, of the coordinates that may move : int64; the first free unknowns are these."""
    return np.delete(np.arange(shape[0] * shape[1]).reshape(shape), held, axis=0).ravel()


def position_covariance(inverse: np.ndarray, shape: tuple[int, int], held) -> np.ndarray:
    """Return the covariance of all coordinates (N D, N D), metres^2, out of that of the free unknowns (F, F)."""
    index = free_coordinates(shape, held)
    whole = np.zeros((shape[0] * shape[1],) * 2)
    whole[np.ix_(index, index)] = inverse[: len(index), : len(index)]
    return whole


def remaining_step(unknowns: Unknowns, objective: Objective, here: Evaluation, free, inverse) -> np.ndarray:
    """Return the Newton step of the positions that is left (N, D), metres; inverse (F, F) of the matrix."""
    shape, held = unknowns.positions.shape, objective.priors.held
    index, whole = free_coordinates(shape, held), np.zeros(unknowns.positions.size)
    whole[index] = -(inverse @ here.gradient[free])[: len(index)]
    return whole.reshape(shape)


def sigmas_moved(before: Unknowns, trial: ChannelStep, healthy: np.ndarray) -> float:
    """Return the RMS move of the coordinates of the healthy microphones (N,) bool in a step, over their sigmas."""
    if trial.matrix is None or trial.free.ndim != 1:
        return np.inf
    variance = np.full(before.vector.size, np.inf)  # of what is not free
    variance[trial.free] = np.diag(scaled_inverse(trial.matrix))
    variance = variance[:-1].reshape(len(healthy), -1)[healthy, : before.positions.shape[1]]
    move = (trial.unknowns.positions - before.positions)[healthy]
    return float(np.sqrt(np.mean(move**2 / variance))) if np.any(healthy) else 0.0


def is_converged(problem: Problem, state: State) -> bool:
    """Return whether no healthy channel is farther from the minimum than a small part of its sigma."""
    goal, here = objective_of(problem, state, used_modes(problem, state)), unknowns_of(state)
    free = free_directions(here, goal.priors.held, None, speed_is_free(problem, state))
    try:
        evaluated = goal.evaluate(here)
        inverse = scaled_inverse(reduced(here, evaluated, free, not len(problem.known))[1])
    except np.linalg.LinAlgError:
        return False
    step = remaining_step(here, goal, evaluated, free, inverse)
    sigma = np.sqrt(np.diag(position_covariance(inverse, step.shape, goal.priors.held))).reshape(step.shape)
    healthy = state.model.channel_noise < OUTLIERS.suspicious
    step = without_motion(problem, state.positions, step, healthy, goal.priors)
    return bool(np.all(np.abs(step[healthy]) <= STEPS.converged_sigmas * sigma[healthy]))


def without_motion(problem: Problem, positions, step, healthy, priors: Priors) -> np.ndarray:
    """Return a step without the motion of the array as a whole, which given positions have settled (`given.anchored`).

    They say more of it than the pressures do; where they are exact they leave no such motion.
    """
    anchored = len(problem.known) and problem.frame is None and not len(priors.held)
    return align(positions + step, positions, healthy) - positions if anchored and np.any(healthy) else step
