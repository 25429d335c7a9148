"""What the likelihood solver has found, as `fdcal.solvers.estimate.Estimate`.

    H      Gauss-Newton matrix of cost and priors over everything that is free
    g_m    gradient of mode m; -g_m H^-1 is the influence of that mode on the unknowns

H takes the field as `GIVEN.weaker_field` times as powerful, which weakens the prior of an isotropic field: what becomes
uncertain rests on that prior and not on the wave equation. A conditional likelihood needs none. Without given
positions the covariance is that of the array without its rigid motions; in the frame of the least gauge, of the array
moved into it.

Given positions and pressures agree if the array without given positions is hardly likelier:

    S = prior(x) + cost(x) - min cost      over arrays that no given position holds

Under the model 2 S has a chi-square distribution with one degree of freedom for each coordinate given beyond those that
place the array as a whole. A given position that is wrong, a wrong sound speed and an array that was not found all make
S large.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from ...cost.likelihood import Terms
from ...model.gauge import GaugeFrame, rigid_motions
from ...model.problem import Problem
from ...model.settings import SolverSettings
from ..estimate import ChannelEstimate, Estimate, FieldEstimate, GivenEstimate, PositionSpread, TriedOptimum
from . import given, noise
from .objective import (
    Evaluation,
    Objective,
    Unknowns,
    arrival_index,
    channel_step,
    free_directions,
    given_carry_scale,
    in_unit_power,
    objective_of,
    position_covariance,
    reduced,
    remaining_step,
    scaled_inverse,
    speed_is_free,
    unknowns_of,
    used_modes,
)
from .schedule import begin, refined
from .state import ASSUMED, FINAL, GIVEN, STAGES, STEPS, State

NEIGHBOURS, MIN_GROUPS = 8, 6  # modes in a group, whose gradients are not independent; fewest groups
LEARNED = 1 / 3  # one sigma over that step: with 1 measured and simulated rooms have errors of 0.3 to 0.6 of the claim
FIELD_ROUNDS = 3  # of learning the field at given positions: a faulty channel is found in the second


@dataclass(frozen=True)
class AgreementRules:
    """How the array without given positions is sought."""

    clear: float = 0.05  # probability of the linear estimate above which no array is sought
    margin: float = 1.5  # factor on that estimate


AGREEMENT = AgreementRules()


def result(problem: Problem, state: State) -> Estimate:
    """Return what the solver has found at `state`."""
    problem = in_unit_power(problem)
    state = replace(state, progress=replace(state.progress, stage=FINAL), shape=state.positions)
    used = used_modes(problem, state)
    goal, here = objective_of(problem, state, used), unknowns_of(state)
    undeflated = goal.field.noise * state.model.deflation  # without what the last stage takes off the noise
    goal = replace(goal, field=replace(goal.field, noise=undeflated))
    free = free_directions(here, goal.priors.held, None, speed_is_free(problem, state))
    evaluated = goal.evaluate(here)
    weakened = _weakened(goal, here, evaluated)
    inverse = scaled_inverse(reduced(here, weakened, free, not len(problem.known))[1])
    (N, D), model = state.positions.shape, state.model
    sigma = np.zeros(here.vector.size)
    sigma[free] = np.sqrt(np.maximum(np.diag(inverse), 0.0))
    each = np.zeros((N, 4))
    each[:, : here.gains * here.channels.shape[1]] = sigma[:-1].reshape(N, -1)[:, D:]
    stated = state.settings.sound_speed_sigma or 0.0
    return Estimate(
        problem=problem,
        modes=state.modes,
        positions=state.positions,
        converged=state.converged or state.finished,
        channels=ChannelEstimate(
            state.gains,
            each[:, :2],
            model.filters,
            each[:, 2:],
            np.array([model.gain_sigma, model.phase_sigma]),
            model.channel_noise,
        ),
        field=FieldEstimate(model.share, model.power[state.modes], undeflated, weakened.terms),
        spread=_spread(problem, state, goal, here, evaluated, free, inverse),
        given=_given(problem, state, goal, here, evaluated.terms, weakened.terms),
        log_speed=model.log_speed,
        log_speed_sigma=float(sigma[-1]) if len(problem.known) else stated,
        tried=_tried(problem, state),
    )


def estimate_at(problem: Problem, settings: SolverSettings, positions, modes: slice, converged: bool) -> Estimate:
    """Return the estimate of positions (N, D), metres, that a solver of another cost has found.

    Channels count as matched and given positions as exact; the noise is all that the likelihood leaves unexplained.
    With an uncertain sound speed, positions and speed are those of the nearest minimum of the likelihood.
    """
    first, last, _ = modes.indices(len(problem.pressures))
    matched = replace(settings, modes=last, gains="fixed", known_sigma=0.0)
    problem = replace(in_unit_power(problem), arrivals=None, arrival_sigma=None)  # which the solver has not used
    begun = begin(State, problem, matched, 0, positions)
    state = replace(begun, first=first + 1, last=last, progress=replace(begun.progress, stage=FINAL))
    state = noise.with_noise(problem, state, rough=False)
    state = refined(problem, replace(state, model=replace(state.model, kernel=noise.last_kernel(problem, state))))
    state = _with_field(problem, state)
    if speed_is_free(problem, state):
        state = _at_minimum(problem, state)
    found = result(problem, replace(state, converged=converged, finished=True))
    # The other cost has its minimum elsewhere: what the likelihood would still move is no sign of an unfinished search.
    return replace(found, spread=replace(found.spread, step=np.zeros_like(found.spread.step)))


def _with_field(problem: Problem, state: State) -> State:
    """Return `state` with the field and all noise learned, the positions as they are.

    In rounds, as the last stage has them: the noise of a faulty channel is that of all until its own is known.
    """
    used = used_modes(problem, state)
    for _ in range(FIELD_ROUNDS):
        for _ in range(STAGES[FINAL].max_steps):
            goal = objective_of(problem, state, used)
            state = noise.with_power(state, used, goal.field, goal.evaluate(unknowns_of(state)).terms)
            state = noise.with_directions(problem, state, used, ASSUMED.direction_updates)
        state = noise.with_noise(problem, state, state.model.deflation, rough=False)
    return state


def _at_minimum(problem: Problem, state: State) -> State:
    goal, here = objective_of(problem, state, used_modes(problem, state)), unknowns_of(state)
    return given.with_unknowns(state, _descend(here, goal, False, 60)[0])


def _weakened(goal: Objective, here: Unknowns, evaluated: Evaluation) -> Evaluation:
    """The objective with a field of more power; as it is where it is conditional, and where C is then singular."""
    if goal.field.conditional is not None:
        return evaluated
    try:
        return replace(goal, field=replace(goal.field, power=GIVEN.weaker_field * goal.field.power)).evaluate(here)
    except np.linalg.LinAlgError:
        return evaluated


def _spread(
    problem: Problem, state: State, goal: Objective, here: Unknowns, evaluated, free, inverse
) -> PositionSpread:
    """The covariance and the influences in the gauge of the problem."""
    shape, held = state.positions.shape, goal.priors.held
    slopes = np.asarray(evaluated.terms.slopes).reshape(len(goal.pressures), -1)
    slopes = np.column_stack([slopes, slopes @ here.by_speed()])[:, free]
    timed = _arrival_slopes(here, goal)[:, free]
    gauge = _gauge(problem, state.positions)
    newton = gauge @ position_covariance(inverse, shape, held) @ gauge.T
    if not len(problem.known):  # sound speed and size of a blind array are one
        x = (state.positions - state.positions.mean(axis=0)).ravel()
        newton = newton + (state.settings.sound_speed_sigma or 0.0) ** 2 * np.outer(x, x)
    index = np.delete(np.arange(newton.shape[0]).reshape(shape), held, axis=0).ravel()
    influences = []
    by_take = np.argsort(problem.takes[used_modes(problem, state)], kind="stable")  # neighbours are of one take
    for parts in (slopes, _grouped(slopes[by_take])):
        parts = np.concatenate([parts, timed])
        moves = np.zeros((len(parts), newton.shape[0]))
        moves[:, index] = -(_about_zero(parts) @ inverse)[:, : len(index)]
        influences.append(moves @ gauge.T)
    own = scaled_inverse(reduced(here, evaluated, free, not len(problem.known))[1])
    step = remaining_step(here, goal, evaluated, free, own)
    sigma = np.sqrt(np.diag(position_covariance(own, shape, held))).reshape(shape)
    shift = (gauge @ _shift(problem, state, here, goal, free).ravel()).reshape(shape)
    return PositionSpread(newton, tuple(influences), step, sigma, shift)


def _arrival_slopes(here: Unknowns, goal: Objective) -> np.ndarray:
    """Gradient (T, N P + 1) of the arrivals of each take by all unknowns."""
    if goal.arrivals is None:
        return np.zeros((0, here.vector.size))
    terms = goal.arrivals.terms(here.positions, here.log_speed, True, here.delays)
    slopes = np.zeros((len(terms.gradient), here.vector.size))
    slopes[:, arrival_index(here)] = terms.gradient
    return slopes


def _shift(problem: Problem, state: State, here: Unknowns, goal: Objective, free) -> np.ndarray:
    """How far the minimum of an isotropic random field is (N, D); none where that is what the state assumes.

    The Newton step to it; LEARNED of it where the directions were learned, which takes off most of what an isotropic
    field gets wrong. The near-field kernel explains what such a field cannot: there is nothing to learn from their
    difference.
    """
    model, kernel = state.model, noise.isotropic_kernel(problem, state)
    if model.kernel == "near" or (model.kernel == kernel and not model.conditional):
        return np.zeros(state.positions.shape)
    isotropic = replace(state, model=replace(model, kernel=kernel, directions=None, conditional=""))
    other = replace(objective_of(problem, isotropic, used_modes(problem, state)), priors=goal.priors)
    try:
        evaluated = other.evaluate(here)
    except np.linalg.LinAlgError:
        return np.zeros(state.positions.shape)
    inverse = scaled_inverse(reduced(here, evaluated, free, not len(problem.known))[1])
    return (1.0 if model.conditional else LEARNED) * remaining_step(here, other, evaluated, free, inverse)


def _grouped(slopes) -> np.ndarray:
    """Sums of the gradients (M, F) of neighbouring modes."""
    count = max(1, len(slopes) // max(1, min(NEIGHBOURS, len(slopes) // MIN_GROUPS)))
    return np.array([part.sum(axis=0) for part in np.array_split(slopes, count)])


def _about_zero(slopes) -> np.ndarray:
    """Gradients about their mean, which is zero at the minimum; it takes a share 1 / G off their squares."""
    return (slopes - slopes.mean(axis=0)) * np.sqrt(len(slopes) / max(len(slopes) - 1, 1))


def _gauge(problem: Problem, positions) -> np.ndarray:
    """Projection (N D, N D) that takes rigid motions off: onto the frame, or onto no motion on average."""
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
    fixed = [(frame.microphones[0], along) for along in np.eye(D)]
    fixed += [(n, axes[:, a]) for i, n in enumerate(frame.microphones[1:D]) for a in range(i + 1, D)]
    rows = np.zeros((len(fixed), N, D))
    for row, (n, along) in zip(rows, fixed, strict=True):
        row[n] = along
    return rows.reshape(len(fixed), -1)


def _tried(problem: Problem, state: State) -> tuple[TriedOptimum, ...]:
    held = bool(len(problem.known)) and not given.inaccurate(state)
    ended = sorted((one for one in state.optima if np.isfinite(one.score)), key=lambda one: one.score)
    return tuple(
        TriedOptimum(one.positions, one.score, one.regrouped, held and given.same_given(state, one)) for one in ended
    )


def _given(
    problem: Problem, state: State, goal: Objective, here: Unknowns, at_goal: Terms, weakened: Terms
) -> GivenEstimate:
    sigma = goal.priors.known_sigma or given.EXACT_SIGMA
    every = replace(goal.priors, known=problem.known, places=problem.known_positions, known_sigma=sigma)

    def probability(kept: np.ndarray) -> float:
        priors = replace(every, known=problem.known[kept], places=problem.known_positions[kept])
        held = replace(goal, priors=priors)
        return _agreement(held, here, at_goal)

    stated = state.settings.known_sigma
    expected = GIVEN.sigma if stated is None else stated
    stiffness = every.of_known(state.positions)[2]
    return GivenEstimate(
        state.model.known_sigma,
        expected,
        stiffness,
        given_carry_scale(problem),
        probability,
        given.contradicted(problem, state, (at_goal, weakened)),
    )


def _agreement(held: Objective, here: Unknowns, at_goal: Terms) -> float:
    """Probability of the disagreement; the array without given positions is sought only where it could be low."""
    D = here.positions.shape[1]
    freedom = len(held.priors.known) * D - D * (D + 1) // 2
    alone = replace(held, priors=held.priors.without_given())
    falls = (_promised(here, goal, at_goal, goal is alone) for goal in (alone, held))
    quadratic = held.priors.of_known(here.positions)[0] + max(0.0, next(falls) - next(falls))
    if chdtrc(freedom, 2 * AGREEMENT.margin * quadratic) > AGREEMENT.clear:
        return float(chdtrc(freedom, 2 * quadratic))
    there, _ = _descend(here, held, False, GIVEN.steps)
    prior = held.priors.of_known(there.positions)[0]
    linear = _promised(there, alone, alone.evaluate(there).terms, True)
    if chdtrc(freedom, 2 * (prior + AGREEMENT.margin * linear)) > AGREEMENT.clear:
        return float(chdtrc(freedom, 2 * (prior + linear)))
    return float(chdtrc(freedom, 2 * (prior + _descend(there, alone, True, GIVEN.steps)[1])))


def _promised(there: Unknowns, goal: Objective, terms: Terms, blind: bool) -> float:
    """Fall of the cost to the minimum of its quadratic approximation; `terms` are of the likelihood at `there`."""
    free = free_directions(there, goal.priors.held, None, goal.priors.speed_sigma > 0)
    g, H = reduced(there, goal.with_priors(there, terms), free, blind)
    return float(g @ scaled_inverse(H) @ g) / 2


def _descend(unknowns: Unknowns, goal: Objective, blind: bool, steps: int) -> tuple[Unknowns, float]:
    """Return the minimum and by how much the cost has fallen."""
    damping, fall = STEPS.damping, 0.0
    free = free_directions(unknowns, goal.priors.held, None, goal.priors.speed_sigma > 0)
    for _ in range(steps):
        trial = channel_step(unknowns, goal, free, damping, blind)
        if trial.terms is None:
            break
        unknowns, damping, fall = trial.unknowns, trial.damping, fall + trial.fall
        if trial.fall < GIVEN.negligible:
            break
    return unknowns, fall
