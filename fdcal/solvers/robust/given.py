"""Tests whether given positions contradict the pressures; wrong ones are then ignored and exchanged ones corrected.

If given positions and pressures agree, nothing changes. Otherwise the array is found without given positions, several
hypotheses on them are compared, and the next steps use the positions that the likeliest hypothesis takes as right.

    b = x + G t + d + e,   d ~ N(0, P),   e ~ N(0, s^2 I)

b are the given positions that a hypothesis takes as right, x the positions of the same microphones in the free array,
P their covariance, G t a rigid motion, and s one sigma of a given coordinate. With S = P + s^2 I and r = b - x, and t
marginalised over,

    -log evidence = [r^T S^-1 r - g^T W^-1 g + log det S + log det W + (n - c) log 2 pi] / 2 - log priors
    W = G^T S^-1 G,   g = G^T S^-1 r,   n coordinates, c columns of G

The distance of a wrong position from the right one has a log-uniform prior. s has a log-normal prior and takes its
likeliest value.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
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

EXACT_SIGMA = 1e-3  # metres, one sigma of a coordinate that is assumed when exact given positions are tested
# All given positions count as inaccurate if their sigma exceeds the expected one by this factor; without it the error
# of 1 of 32 arrays with wrong given positions grows from 9 to 19 mm
INACCURATE = 2.0


def resolved(problem: Problem, state: State) -> State:
    """Return `state` with the likeliest hypothesis on the given positions if the present hypothesis does not fit."""
    exact = state.model.known_sigma == 0
    if exact or len(problem.known) <= problem.array_dimension or objectives.given_carry_scale(problem):
        return state
    try:
        near = free_array(problem, state, 0)
        if _agree(problem, state, near) and mirror_advantage(problem, state, near) >= 0:
            return state
        found = free_array(problem, state, FREE_STEPS)
    except np.linalg.LinAlgError:
        return state
    best = hypotheses(found, problem.known, problem.known_positions, state.settings.known_sigma)[0]
    moved = objectives.with_unknowns(state, replace(found.unknowns, positions=best.positions))
    places, wrong = frozen_array(problem.known_positions[best.order], float), frozen_array(~best.right, bool)
    model = replace(moved.model, places=places, contradicted=wrong, known_sigma=best.sigma)
    assumed = replace(moved, stage_start=moved.positions, model=model)
    mirrored = np.linalg.det(rigid_motion(state.positions, best.positions)[0]) < 0
    accurate = best.sigma < INACCURATE * objectives.first_known_sigma(problem, state.settings)
    return state if accurate and same_given(state, assumed) and not mirrored else assumed


MIN_ADVANTAGE = 3.0  # nats by which a hypothesis must be likelier than the positions as they are given


def contradicted(problem: Problem, state: State, near: FreeArray) -> GivenHypothesis | None:
    """Return the likeliest hypothesis at the end of a run, or None if the given positions fit the pressures.

    `near` is the array without given positions. The solver never moves exact given positions. They are released here
    for the test.
    """
    if len(problem.known) <= problem.array_dimension or objectives.given_carry_scale(problem):
        return None
    exact = state.model.known_sigma == 0
    try:
        noisy = exact and bool(np.any(state.model.channel_noise[problem.known] > SUSPICIOUS))
        if not noisy and _agree(problem, state, near):
            return None
        free, stated = (_released(problem, state), EXACT_SIGMA) if exact else (state, state.settings.known_sigma)
        found = free_array(problem, free, 0 if exact else FREE_STEPS)
        tried = hypotheses(found, problem.known, problem.known_positions, stated)
    except np.linalg.LinAlgError:
        return None
    best, known = tried[0], problem.known
    noise_there = free.model.channel_noise[known]
    wrong = ~best.right | (best.order != np.arange(len(known)))
    wrong &= noise_there < SUSPICIOUS  # a channel that fits nowhere says nothing about its position
    as_given = next(one for one in tried if np.all(one.right) and np.all(np.diff(one.order) > 0))
    if best.log_evidence - as_given.log_evidence < MIN_ADVANTAGE or not np.any(wrong):
        return None
    variance = np.diag(found.covariance).reshape(state.positions.shape).sum(axis=1)
    return GivenHypothesis(best.positions, np.sqrt(np.maximum(variance[known], 0.0)), noise_there, wrong)


def _released(problem: Problem, state: State) -> State:
    """Return `state` after steps without given positions, with suspicious channels moved and the noise estimated."""
    damped, every = noise.is_damped(problem, state), np.ones(len(problem.known), bool)
    model = replace(state.model, contradicted=every, damped=damped, directional=False)
    state = replace(state, model=replace(model, directions=None), stage_start=state.positions)
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
    return noise.with_noise(problem, replace(state, stage_start=state.positions), rough=False)


# To save time, the given positions are not examined further if the probability that chance causes a disagreement at
# least as large as theirs is above this.
AGREE = 0.2


def _agree(problem: Problem, state: State, found: FreeArray) -> bool:
    """Return whether the given positions in use and the pressures agree within their sigmas."""
    known, places = objectives.given_in_use(problem, state)
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
    """Return whether two states or optima use the same given positions."""
    a, b = one.model, other.model
    return bool(np.array_equal(a.contradicted, b.contradicted) and np.array_equal(a.places, b.places))


# When the array is moved onto the given positions, a position is left out if its distance from its microphone exceeds
# this number times the median distance, or times sigma if that is larger. Without this rule 1 of 32 arrays with wrong
# given positions is not found.
GIVEN_OUTLIER = 3.0


def anchored(problem: Problem, state: State) -> np.ndarray:
    """Return the array (N, D), metres, moved as a whole onto the given positions, of which outliers are left out.

    The pressures do not determine the position of the array as a whole, and with little noise the prior of the given
    positions is too weak to move it in the last steps. An array with exact given positions stays as it is.
    """
    x, (known, given) = state.positions, objectives.given_in_use(problem, state)
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
    """An array that was found without given positions: known up to a rigid motion and a mirror image."""

    unknowns: objectives.Unknowns  # with the positions in an arbitrary frame
    covariance: Reals  # (N D, N D) float64, metres^2, without rigid motions


def free_array(problem: Problem, state: State, steps: int, terms: tuple[Terms, Terms] | None = None) -> FreeArray:
    """Return the minimum without given positions near `state`, after `steps` steps at most.

    With 0 steps it is the minimum of the quadratic approximation at `state`. `terms` are the two results of the
    likelihood at `state`, with its own field and with that of `Objective.weakened`; they are computed unless given.
    Raises LinAlgError if a covariance is singular.
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
    """A hypothesis on the given positions, and the array that follows from it."""

    log_evidence: float
    right: Bools  # (A,) bool, which given positions are right
    order: Integers  # (A,) int64, index of the given position that belongs to each microphone
    sigma: float  # metres, one sigma of every given coordinate
    positions: Reals  # (N, D) float64, metres, the array in the frame of the given positions


EXAMINED = 7  # number of given positions with the worst fit that the hypotheses take as wrong or exchanged


def hypotheses(found: FreeArray, known: Integers, places: Reals, stated: float | None) -> list[Hypothesis]:
    """Return the hypotheses on the given positions `places` (A, D), metres, of `known` (A,), the likeliest first.

    Either all are right, or one is wrong, or two are exchanged. `stated` is the sigma of a given coordinate that the
    user states, metres.
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
    return sorted((_weighed(found, known, places, *one, stated) for one in tried), key=lambda one: -one.log_evidence)


# prior probability that a given position is wrong, or that two are exchanged; with 0.2 the errors of 2 of 32 arrays
# grow from 5 to 11 mm
WRONG = 0.05
# ratio of the largest to the smallest distance in the prior of a wrong position; with 10 an error can double
DISTANCE_RATIO = 1e3
# width (nepers) of the log-normal prior of the sigma of a given coordinate about the stated sigma or GIVEN_SIGMA, and
# largest sigma without a stated one, metres; with a width of 1 the error of an array in space grows from 11 to 18 mm
SIGMA_SPREAD = 0.6
MAX_SIGMA = 0.04


def mirror_advantage(problem: Problem, state: State, found: FreeArray) -> float:
    """Return by how many nats the array `found` is likelier than its mirror image, given the positions in use.

    The difference is small if the given positions lie on a line (in space, in a plane) within their accuracy and that
    of the array. It is infinite if too few positions are given to compare the two arrays.
    """
    known, places = objectives.given_in_use(problem, state)
    if len(known) <= problem.array_dimension or objectives.given_carry_scale(problem):
        return np.inf
    stated = EXACT_SIGMA if state.model.known_sigma == 0 else state.settings.known_sigma
    every = np.arange(len(known), dtype=np.int64)
    (as_found, *_), (mirrored, *_) = _images(found, known, places, np.ones(len(known), bool), every, stated)
    return as_found - mirrored


def _weighed(
    found: FreeArray, known: Integers, places: Reals, right: Bools, order: Integers, stated: float | None
) -> Hypothesis:
    """Return one hypothesis, with the likelier of the two mirror images of the array."""
    evidence, sigma, positions = max(_images(found, known, places, right, order, stated), key=lambda one: one[0])
    A, wrong = len(places), np.sum(~right)
    evidence += wrong * np.log(WRONG) + (A - wrong) * np.log1p(-WRONG)
    if np.any(order != np.arange(A)):
        evidence += np.log(WRONG / (A * (A - 1) / 2))
    return Hypothesis(float(evidence), right, order, sigma, positions)


def _images(
    found: FreeArray, known: Integers, places: Reals, right: Bools, order: Integers, stated: float | None
) -> list[tuple[float, float, np.ndarray]]:
    """Return log evidence, sigma of a given coordinate and positions of the array as it is, and of its mirror image."""
    x, D = found.unknowns.positions, places.shape[1]
    ordered, constrained = places[order], known[right]
    index = (constrained[:, None] * D + np.arange(D)).ravel()
    values, vectors = np.linalg.eigh(found.covariance[np.ix_(index, index)])
    columns = rigid_motions(x)
    middle, max_sigma = (GIVEN_SIGMA, MAX_SIGMA) if stated is None else (stated, stated)
    above = np.geomspace(middle, max_sigma, 8)[1:] if max_sigma > middle else np.zeros(0)
    sigmas = np.append(np.geomspace(middle / 4, middle, 4), above)
    log_prior = -((np.log(sigmas / middle) / SIGMA_SPREAD) ** 2) / 2
    inverse = 1 / (np.maximum(values, 0.0) + sigmas[:, None] ** 2)
    images: list[tuple[float, float, np.ndarray]] = []
    for mirror in (False, True):
        turn, centre, target = rigid_motion(x[constrained], ordered[right], mirror)
        b = (ordered - target) @ turn.T + centre  # the given positions in the frame of the free array
        r, G = vectors.T @ (b[right] - x[constrained]).ravel(), vectors.T @ columns[index]
        W = np.asarray(np.einsum("sn,na,nb->sab", inverse, G, G))
        g = np.asarray(np.einsum("sn,na,n->sa", inverse, G, r))
        t = np.linalg.solve(W, g[..., None])[..., 0]
        chi = inverse @ r**2 - np.sum(g * t, axis=1)
        logs = log_prior - (chi - np.log(inverse).sum(axis=1) + np.linalg.slogdet(W)[1]) / 2
        best = int(np.argmax(logs))
        pull = vectors @ (inverse[best] * (r - G @ t[best]))
        moved = x + (columns @ t[best] + found.covariance[:, index] @ pull).reshape(x.shape)
        evidence = logs[best] - (r.size - columns.shape[1]) / 2 * np.log(2 * np.pi)
        # the prior density of the wrong positions at their distances from the right ones
        away, sigma = b[~right] - moved[known[~right]], float(sigmas[best])
        distance = np.sqrt(np.sum(away**2, axis=1) + sigma**2)
        sphere = 2 * np.pi if D == 2 else 4 * np.pi
        evidence += float(-np.sum(D * np.log(distance) + np.log(sphere * np.log(DISTANCE_RATIO))))
        images.append((float(evidence), sigma, (moved - centre) @ turn + target))
    return images if np.linalg.det(rigid_motion(x[constrained], ordered[right])[0]) > 0 else images[::-1]
