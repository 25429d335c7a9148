"""Given positions that the pressures contradict no longer hold the array; two that were exchanged are put right.

Where the given positions and the pressures agree nothing changes. Otherwise the array is sought without given
positions, and put where the likeliest of several hypotheses has it; the next steps hold the positions that are right.

    b = x + G t + d + e,   d ~ N(0, P),   e ~ N(0, s^2 I)

b are the positions given of the microphones that a hypothesis holds to be right, x those of the free array and P their
covariance, t a rigid motion, s one sigma of a given coordinate. With
S = P + s^2 I and r = b - x, and t marginalised over,

    -log evidence = [r^T S^-1 r - g^T W^-1 g + log det S + log det W + (n - c) log 2 pi] / 2 - log priors
    W = G^T S^-1 G,   g = G^T S^-1 r,   n coordinates, c columns of G

A position that is wrong lies anywhere, its distance from the right one spread evenly over the orders of magnitude. s
has a log-normal prior, and is maximised over.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np
from scipy.special import chdtrc

from ...cost.likelihood import Terms
from ...model.gauge import align, fixes_gauge, rigid_motion, rigid_motions
from ...model.problem import Problem
from ...model.validation import Bools, Integers, Reals, frozen_array
from .. import starts
from ..interface import GivenHypothesis
from . import noise
from . import objective as objectives
from .channels import relocated
from .state import FREE_STEPS, GIVEN_SIGMA, NEGLIGIBLE_DECREASE, STAGE_DAMPING, SUSPICIOUS, LocalOptimum, State

EXACT_SIGMA = 1e-3  # metres, one sigma of a coordinate of positions that are given as exact, where these are examined
# that sigma over the expected one from which all given positions are inaccurate; without it the error of 1 of 32
# arrays with wrong given positions grows from 9 to 19 mm
INACCURATE = 2.0


def resolved(problem: Problem, state: State) -> State:
    """Return `state` with the likeliest hypothesis on the given positions where those assumed do not fit."""
    exact = state.model.known_sigma == 0
    if exact or len(problem.known) <= problem.array_dimension or objectives.given_carry_scale(problem):
        return state
    try:
        if _agree(problem, state, free_array(problem, state, 0)):
            return state
        found = free_array(problem, state, FREE_STEPS)
    except np.linalg.LinAlgError:
        return state
    best = likely(problem, state, found)[0]
    moved = objectives.with_unknowns(state, replace(found.unknowns, positions=best.positions))
    places, wrong = frozen_array(problem.known_positions[best.order], float), frozen_array(~best.right, bool)
    model = replace(moved.model, places=places, contradicted=wrong, known_sigma=best.sigma)
    assumed = replace(moved, shape=moved.positions, model=model)
    mirrored = np.linalg.det(rigid_motion(state.positions, best.positions)[0]) < 0  # the same positions count in both
    as_before = same_given(state, assumed) and best.sigma < INACCURATE * GIVEN_SIGMA and not mirrored
    return state if as_before else assumed


# by which another hypothesis must be likelier than exact positions as they are given; without it 2 of 12 arrays with
# wrong exact positions are good
MIN_ADVANTAGE = 3.0


def contradicted(problem: Problem, state: State, terms: tuple[Terms, Terms]) -> GivenHypothesis | None:
    """Return the likeliest hypothesis where the positions assumed do not fit the pressures, at the end of a run.

    Where positions are exact the search has left them as they are, whatever they do to the array. Here they are let go.
    """
    if len(problem.known) <= problem.array_dimension or objectives.given_carry_scale(problem):
        return None
    exact = state.model.known_sigma == 0
    try:
        noisy = exact and bool(np.any(state.model.channel_noise[problem.known] > SUSPICIOUS))
        if not noisy and _agree(problem, state, free_array(problem, state, 0, terms)):
            return None
        free = _let_go(problem, state) if exact else state
        if exact:
            found = free_array(problem, free, 0)
            tried = hypotheses(found, problem.known, problem.known_positions, EXACT_SIGMA)
        else:
            found = free_array(problem, state, FREE_STEPS)
            tried = likely(problem, state, found)
    except np.linalg.LinAlgError:
        return None
    best, known = tried[0], problem.known
    noise_there = free.model.channel_noise[known]
    wrong = ~best.right | (best.order != np.arange(len(known)))
    wrong &= noise_there < SUSPICIOUS  # a channel that fits nowhere says nothing of its position
    as_given = next(one for one in tried if np.all(one.right) and np.all(np.diff(one.order) > 0))
    if best.log_evidence - as_given.log_evidence < MIN_ADVANTAGE or not np.any(wrong):
        return None
    variance = np.diag(found.covariance).reshape(state.positions.shape).sum(axis=1)
    return GivenHypothesis(best.positions, np.sqrt(np.maximum(variance[known], 0.0)), noise_there, wrong)


def _let_go(problem: Problem, state: State) -> State:
    """`state` with every exact given position free, its channels where they fit, and the noise that is then left."""
    damped, every = noise.is_damped(problem, state), np.ones(len(problem.known), bool)
    model = replace(state.model, contradicted=every, damped=damped, directional=False)
    state = replace(state, model=replace(model, directions=None), shape=state.positions)
    used = objectives.used_modes(problem, state)
    state, damping = relocated(problem, state)[0], STAGE_DAMPING
    for _ in range(FREE_STEPS):
        objective, here = objectives.objective_of(problem, state, used), objectives.unknowns_of(state)
        trial = objectives.channel_step(here, objective, objective.free(here), damping)
        if trial.terms is None:
            break
        state = noise.with_power(objectives.with_unknowns(state, trial.unknowns), used, objective.field, trial.terms)
        damping = trial.damping
        if trial.decrease < NEGLIGIBLE_DECREASE:
            break
    return noise.with_noise(problem, replace(state, shape=state.positions), rough=False)


def likely(problem: Problem, state: State, found: FreeArray) -> list[Hypothesis]:
    """Return the hypotheses on the given positions, the likeliest first."""
    return hypotheses(found, problem.known, problem.known_positions, state.settings.known_sigma)


# probability of the disagreement found from which the given positions are taken as they are; without it arrays with
# given positions take 1.2 times the time
AGREE = 0.2


def _agree(problem: Problem, state: State, found: FreeArray) -> bool:
    """Whether the positions that hold the array and the pressures agree within their sigmas."""
    known, places = objectives.constrained_positions(problem, state)
    x, D = found.unknowns.positions, problem.array_dimension
    index = (known[:, None] * D + np.arange(D)).ravel()
    sigma = max(state.model.known_sigma, GIVEN_SIGMA) if state.model.known_sigma > 0 else EXACT_SIGMA
    S = found.covariance[np.ix_(index, index)] + sigma**2 * np.eye(len(index))
    r, G = (places - x[known]).ravel(), rigid_motions(x)[index]
    weighed = np.linalg.solve(S, np.column_stack([r, G]))
    left = r - G @ np.linalg.solve(G.T @ weighed[:, 1:], G.T @ weighed[:, 0])
    freedom = len(index) - G.shape[1]
    return freedom <= 0 or bool(chdtrc(freedom, left @ np.linalg.solve(S, left)) > AGREE)


def same_given(one: State | LocalOptimum, other: State | LocalOptimum) -> bool:
    """Return whether the same given positions hold two arrays."""
    a, b = one.model, other.model
    return bool(np.array_equal(a.contradicted, b.contradicted) and np.array_equal(a.places, b.places))


def inaccurate(state: State) -> bool:
    """Return whether the given positions are all less accurate than expected."""
    stated = state.settings.known_sigma
    return state.model.known_sigma > INACCURATE * (GIVEN_SIGMA if stated is None else stated)


# distance of a given position over the median of all of them, or their sigma, that leaves it out when the array is
# moved onto the given positions; without it 1 of 32 arrays with wrong given positions is lost
GIVEN_OUTLIER = 3.0


def anchored(problem: Problem, state: State) -> np.ndarray:
    """Return the array moved as a whole onto the given positions, if any, without outliers among them; exact ones stay.

    The pressures do not fix the array as a whole, and the last steps hardly see the weak pull of the given positions
    where there is hardly any noise.
    """
    x, (known, given) = state.positions, objectives.constrained_positions(problem, state)
    if state.model.known_sigma == 0:
        return x
    away = np.linalg.norm(x[known] - given, axis=1)
    near = away <= GIVEN_OUTLIER * max(float(np.median(away)) if len(away) else 0.0, state.model.known_sigma)
    if not len(known) or np.sum(near) <= x.shape[1] or not fixes_gauge(given[near]):
        return x
    moved = starts.onto(x, known[near], given[near])
    before, after = (np.sum((y[known[near]] - given[near]) ** 2) for y in (x, moved))
    return frozen_array(moved, float) if after < before else x


@dataclass(frozen=True)
class FreeArray:
    """An array up to a rigid motion and a mirror image."""

    unknowns: objectives.Unknowns  # of which the positions (N, D) are in a frame of their own, metres
    covariance: Reals  # (N D, N D) float64, metres^2, without rigid motions


def free_array(problem: Problem, state: State, steps: int, terms: tuple[Terms, Terms] | None = None) -> FreeArray:
    """Return the minimum without given positions, near `state`, after `steps` at most.

    With 0 it is that of the quadratic at `state`, of which the `terms` may be known already, and those with a weaker
    field. Raises numpy.linalg.LinAlgError where a covariance is singular.
    """
    objective = objectives.objective_of(problem, state, objectives.used_modes(problem, state))
    objective = replace(objective, priors=objective.priors.without_given())
    here = objectives.descend(objectives.unknowns_of(state), objective, steps)[0]
    if terms is None:
        weaker = objective.weakened().evaluate(here)
        own = weaker if steps else objective.evaluate(here)
    else:
        own, weaker = (objective.with_priors(here, one) for one in terms)
    covariance = objectives.quadratic(here, objective, weaker).covariance
    if not steps:
        here = replace(here, positions=here.positions + objectives.quadratic(here, objective, own).step)
    motions = np.linalg.qr(rigid_motions(here.positions))[0]
    fixed = np.eye(here.positions.size) - motions @ motions.T
    return FreeArray(here, fixed @ covariance @ fixed.T)


@dataclass(frozen=True)
class Hypothesis:
    """What may be right of the given positions."""

    log_evidence: float
    right: Bools  # (A,) bool, which given positions hold the array
    order: Integers  # (A,) int64, the positions given in the order in which they belong to the microphones
    sigma: float  # metres, of every given coordinate
    positions: Reals  # (N, D) float64, metres, the array in the frame of the given positions


# given positions that are examined, each as wrong and each two as exchanged; of more, those that fit worst
EXAMINED = 7


def hypotheses(found: FreeArray, known: Integers, places: Reals, stated: float | None) -> list[Hypothesis]:
    """Return the hypotheses on `places` (A, D), metres, given of `known` (A,), the likeliest first.

    All are right, one is wrong, or two are exchanged; each as it is or mirrored.
    `stated`: sigma of a given coordinate that the user states, metres.
    """
    A, D = places.shape
    as_given, all_right = np.arange(A, dtype=np.int64), np.ones(A, bool)
    x = found.unknowns.positions[known]
    away = np.linalg.norm(align(x, places, starts.best_subset(x, places)) - places, axis=1)
    suspects: list[int] = sorted(np.argsort(-away)[:EXAMINED].tolist()) if A > D else []
    tried = [(all_right, as_given), *((np.arange(A) != n, as_given) for n in suspects)]
    for i, j in combinations(suspects, 2):
        order = as_given.copy()
        order[[i, j]] = j, i
        tried.append((all_right, order))
    weighed = [_weighed(found, known, places, *one, stated) for one in tried]
    return sorted(weighed, key=lambda one: -one.log_evidence)


# probability that a given position is wrong, or that two are exchanged; with 0.2 the errors of 2 of 32 arrays grow from
# 5 to 11 mm
WRONG = 0.05


def _weighed(
    found: FreeArray, known: Integers, places: Reals, right: Bools, order: Integers, stated: float | None
) -> Hypothesis:
    """One hypothesis, with the likelier one of the two mirror images."""
    x, D = found.unknowns.positions, places.shape[1]
    ordered, constrained = places[order], known[right]
    index = (constrained[:, None] * D + np.arange(D)).ravel()
    values, vectors = np.linalg.eigh(found.covariance[np.ix_(index, index)])
    columns, spectrum = rigid_motions(x), (np.maximum(values, 0.0), vectors)
    placed = partial(_placed, found, known, ordered, right, columns, index, spectrum, stated)
    evidence, sigma, positions = max((placed(mirror) for mirror in (False, True)), key=lambda one: one[0])
    A, wrong = len(right), np.sum(~right)
    evidence += wrong * np.log(WRONG) + (A - wrong) * np.log1p(-WRONG)
    if np.any(order != np.arange(A)):
        evidence += np.log(WRONG / (A * (A - 1) / 2))
    return Hypothesis(float(evidence), right, order, sigma, positions)


def _placed(
    found: FreeArray,
    known: Integers,
    places: Reals,
    right: Bools,
    columns: Reals,
    index: Integers,
    spectrum: tuple[Reals, Reals],
    stated: float | None,
    mirror: bool,
) -> tuple[float, float, np.ndarray]:
    """Log evidence, sigma and positions of one image of the array."""
    x = found.unknowns.positions
    turn, centre, target = rigid_motion(x[known[right]], places[right], mirror)
    b = (places - target) @ turn.T + centre  # the given positions in the frame of the free array
    values, vectors = spectrum
    r, G = vectors.T @ (b[right] - x[known[right]]).ravel(), vectors.T @ columns[index]
    sigmas, log_prior = sigma_grid(stated)
    inverse = 1 / (values + sigmas[:, None] ** 2)
    W = np.asarray(np.einsum("sn,na,nb->sab", inverse, G, G))
    g = np.asarray(np.einsum("sn,na,n->sa", inverse, G, r))
    t = np.linalg.solve(W, g[..., None])[..., 0]
    chi = inverse @ r**2 - np.sum(g * t, axis=1)
    logs = log_prior - (chi - np.log(inverse).sum(axis=1) + np.linalg.slogdet(W)[1]) / 2
    best = int(np.argmax(logs))
    pull = vectors @ (inverse[best] * (r - G @ t[best]))
    moved = x + (columns @ t[best] + found.covariance[:, index] @ pull).reshape(x.shape)
    evidence = logs[best] - (r.size - columns.shape[1]) / 2 * np.log(2 * np.pi)
    # Log density of the wrong positions, so far from where they should be.
    away, D, sigma = b[~right] - moved[known[~right]], x.shape[1], float(sigmas[best])
    distance = np.sqrt(np.sum(away**2, axis=1) + sigma**2)
    sphere = 2 * np.pi if D == 2 else 4 * np.pi
    evidence += float(-np.sum(D * np.log(distance) + np.log(sphere * np.log(DECADES))))
    return float(evidence), sigma, (moved - centre) @ turn + target


# greatest distance of a wrong position over the least one; with 10 the error of one grows from 5 to 12 mm
DECADES = 1e3


# spread, nepers, of the log-normal prior of one sigma of a given coordinate about GIVEN_SIGMA, and its greatest
# value, metres, where the grid of sigmas ends; with a spread of 1 the error of an array in space grows from 11 to 18 mm
SIGMA_SPREAD = 0.6
MAX_SIGMA = 0.04


def sigma_grid(stated: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Return sigmas of a given coordinate, metres, and the logarithm of their prior probabilities."""
    middle = GIVEN_SIGMA if stated is None else stated
    max_sigma = MAX_SIGMA if stated is None else stated
    above = np.geomspace(middle, max_sigma, 8)[1:] if max_sigma > middle else np.zeros(0)
    sigmas = np.append(np.geomspace(middle / 4, middle, 4), above)
    logs = -((np.log(sigmas / middle) / SIGMA_SPREAD) ** 2) / 2
    return sigmas, logs
