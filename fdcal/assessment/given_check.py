"""Whether the given positions and the pressures agree: the same array without the given positions.

    S = prior(x) + cost(x) - min cost      over arrays that no given position holds

x is the array found, the prior that of its given positions. Under the model 2 S has a chi-square distribution with one
degree of freedom for each coordinate given beyond those that place the array as a whole. A given position that is
wrong, a wrong sound speed and an array that was not found all make S large.

A given position checks nothing where the others and the pressures place its microphone only roughly: that sigma is

    (P^-1 - spring)^-1 ,   P the covariance of its microphone, spring the curvature of its prior
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from ..cost.channel_likelihood import Terms
from ..model.problem import Problem
from ..solvers.robust import assumptions
from ..solvers.robust.channel_fit import channel_step, free_basis, reduced
from ..solvers.robust.convergence import scaled_inverse
from ..solvers.robust.objective import Objective, Priors, Unknowns
from ..solvers.robust.state import State
from .channel_covariance import Uncertainty
from .odd_channels import OddChannel


@dataclass(frozen=True)
class CheckRules:
    """How the array without given positions is sought.

    Attributes
    ----------
    steps : at most
    negligible : nats, fall of the cost after which a step is the last
    stride : metres, longest move of a microphone in one step
    clear : probability of the linear estimate above which no array is sought
    margin : factor on that estimate
    """

    steps: int = 8
    negligible: float = 0.05
    stride: float = 0.1
    clear: float = 0.05
    margin: float = 1.5


RULES = CheckRules()


@dataclass(frozen=True)
class GivenCheck:
    """How well the given positions and the pressures agree.

    Attributes
    ----------
    probability : of a disagreement as large by chance; 1 where nothing can be checked
    loosest : metres, one sigma of the given microphone that the others and the pressures place least certainly; 0
        without any, infinite where those that are right are too few to place the array
    """

    probability: float
    loosest: float


def check_given(problem: Problem, state: State, found: Uncertainty, odd: Sequence[OddChannel]) -> GivenCheck:
    """Return how well the given positions and the pressures agree.

    Parameters
    ----------
    problem : Problem
        With modes of unit power.
    state : State
    found : Uncertainty
    odd : sequence of OddChannel
        Those that are misplaced or exchanged are not counted among the given positions.
    """
    wrong = [one.number for one in odd if one.kind in ("misplaced", "exchanged")]
    kept = ~np.isin(problem.known, wrong)
    priors = replace(found.goal.priors, known=problem.known[kept], places=problem.known_positions[kept])
    D = problem.array_dimension
    freedom = len(priors.known) * D - D * (D + 1) // 2
    if freedom <= 0:
        return GivenCheck(1.0, np.inf if len(problem.known) else 0.0)
    if assumptions.given_carry_scale(problem):  # that of an isotropic field is no evidence against them
        return GivenCheck(1.0, _loosest(state, found, priors))
    return GivenCheck(_probability(state, found, priors, freedom), _loosest(state, found, priors))


def _probability(state: State, found: Uncertainty, priors: Priors, freedom: int) -> float:
    """`GivenCheck.probability`; the array without given positions is sought only where it could be low."""
    here = assumptions.unknowns(state)
    held, alone = replace(found.goal, priors=priors), replace(found.goal, priors=_without_given(priors))
    falls = (_promised(here, goal, found.at_goal, goal is alone) for goal in (alone, held))
    quadratic = _prior(here, priors) + max(0.0, next(falls) - next(falls))
    if chdtrc(freedom, 2 * RULES.margin * quadratic) > RULES.clear:
        return float(chdtrc(freedom, 2 * quadratic))
    there, _ = _descend(here, held, False)
    prior = _prior(there, priors)
    linear = _promised(there, alone, alone.evaluate(there).terms, True)
    if chdtrc(freedom, 2 * (prior + RULES.margin * linear)) > RULES.clear:
        return float(chdtrc(freedom, 2 * (prior + linear)))
    return float(chdtrc(freedom, 2 * (prior + _descend(there, alone, True)[1])))


def _prior(there: Unknowns, priors: Priors) -> float:
    """Cost of the given positions."""
    return priors.of_known(there.positions)[0]


def _promised(there: Unknowns, goal: Objective, terms: Terms, blind: bool) -> float:
    """Fall of the cost to the minimum of its quadratic approximation; `terms` are of the likelihood at `there`."""
    g, H = reduced(there, goal.with_priors(there, terms), _free(there, goal.priors), blind)
    return float(g @ scaled_inverse(H) @ g) / 2


def _without_given(priors: Priors) -> Priors:
    return replace(priors, known=priors.known[:0], places=priors.places[:0])


def _free(unknowns: Unknowns, priors: Priors) -> np.ndarray:
    filters = unknowns.channels[:, 2:] != 0
    return free_basis(unknowns, None, priors.gain_sigma > 0, filters, priors.speed_sigma > 0)


def _descend(unknowns: Unknowns, goal: Objective, blind: bool) -> tuple[Unknowns, float]:
    """Return the minimum and by how much the cost has fallen."""
    damping, fall, free = 1e-6, 0.0, _free(unknowns, goal.priors)
    for _ in range(RULES.steps):
        trial = channel_step(unknowns, goal, free, damping, RULES.stride, blind)
        if trial.terms is None:
            break
        unknowns, damping, fall = trial.unknowns, trial.damping, fall + trial.fall
        if trial.fall < RULES.negligible:
            break
    return unknowns, fall


def _loosest(state: State, found: Uncertainty, priors: Priors) -> float:
    """`GivenCheck.loosest`."""
    D = state.positions.shape[1]
    stiffness = priors.of_known(state.positions)[2]
    sigmas = []
    for n, held in zip(priors.known, stiffness, strict=True):
        left = np.linalg.eigvalsh(np.linalg.inv(found.curvature[n]) - held * np.eye(D))
        sigmas.append(np.sqrt(np.sum(1 / np.maximum(left, 1.0))))  # one metre at most
    return float(max(sigmas))
