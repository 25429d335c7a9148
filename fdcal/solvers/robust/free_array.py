"""The array that no given position holds: where the pressures alone put it, and how well they fix its shape."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...model.gauge import rigid_motions
from ...model.problem import Problem
from . import assumptions
from .channel_fit import channel_step, free_basis, reduced
from .convergence import scaled_inverse
from .given_rules import GIVEN
from .objective import Objective, Unknowns
from .state import State


@dataclass(frozen=True)
class FreeArray:
    """An array up to a rigid motion and a mirror image.

    Attributes
    ----------
    unknowns : Unknowns, of which the positions (N, D) are in a frame of their own, metres
    covariance : (N D, N D) float64, metres^2, without rigid motions
    """

    unknowns: Unknowns
    covariance: np.ndarray


def free_array(problem: Problem, state: State, steps: int) -> FreeArray:
    """Return the minimum without given positions, near `state`.

    Parameters
    ----------
    problem : Problem
        With modes of unit power.
    state : State
    steps : int
        Steps at most; with 0 the minimum is that of the quadratic at `state`.

    Raises
    ------
    numpy.linalg.LinAlgError
        A covariance is not positive definite.
    """
    goal = without_given(assumptions.objective(problem, state, assumptions.used_modes(problem, state, 0)))
    here = assumptions.unknowns(state)
    filters = here.channels[:, 2:] != 0
    free = free_basis(here, None, goal.priors.gain_sigma > 0, filters, goal.priors.speed_sigma > 0)
    damping = GIVEN.damping
    for _ in range(steps):
        trial = channel_step(here, goal, free, damping, GIVEN.stride, True)
        here, damping = trial.unknowns, trial.damping
        if trial.fall < GIVEN.negligible:
            break
    factor = 1.0 if goal.field.conditional is not None else GIVEN.weaker_field
    weaker = replace(goal, field=replace(goal.field, power=factor * goal.field.power))
    g, H = reduced(here, weaker.evaluate(here), free, True)
    inverse, count = scaled_inverse(H), here.positions.size
    if not steps:
        g, H = reduced(here, goal.evaluate(here), free, True)
        step = -(scaled_inverse(H) @ g)[:count].reshape(here.positions.shape)
        here = replace(here, positions=here.positions + step)
    motions = np.linalg.qr(rigid_motions(here.positions))[0]
    held = np.eye(count) - motions @ motions.T
    return FreeArray(here, held @ inverse[:count, :count] @ held.T)


def without_given(goal: Objective) -> Objective:
    """Return the objective without the prior of the given positions."""
    priors = goal.priors
    return replace(goal, priors=replace(priors, known=priors.known[:0], places=priors.places[:0]))
