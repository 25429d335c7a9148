"""What the likelihood solver has found, as `fdcal.solvers.interface.Estimate`.

The covariance of the positions comes from `spread`. Given positions and pressures agree if an array that is found
without given positions is hardly likelier. The test statistic is

    S = prior(x) + cost(x) - min cost      with the minimum over arrays without given positions

Under the model 2 S has a chi-square distribution, with one degree of freedom for each given coordinate beyond those
that place the array as a whole. A wrong given position, a wrong sound speed and an array that was not found all make S
large. So does a field that is less random than its model. Where the claimed covariance is e times that of the
likelihood, S is therefore replaced by (a + b)^2 / (a + e b), where a is the part of S from the prior and b the part
from the cost. This is exact for a quadratic of one coordinate.
"""

from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from ...cost.likelihood import Terms
from ...model.problem import Problem
from ...model.settings import SolverSettings
from ...model.validation import Reals
from ..interface import ChannelEstimate, Estimate, FieldEstimate, GivenEstimate, TriedOptimum
from . import given, noise
from . import objective as objectives
from .schedule import begin, refined
from .spread import Claim, claim_of
from .state import DIRECTION_UPDATES, FINAL, FREE_STEPS, GIVEN_SIGMA, STAGES, State
from .windows import must_be_flat

FIELD_ROUNDS = 3  # rounds in which `estimate_at` estimates the field; the second one finds a faulty channel


def result(problem: Problem, state: State) -> Estimate:
    """Return what the solver has found at `state`."""
    problem = objectives.in_unit_power(problem)
    state = replace(state, progress=replace(state.progress, stage=FINAL), stage_start=state.positions)
    claim, here, model = claim_of(problem, state), objectives.unknowns_of(state), state.model
    (N, D), likely = state.positions.shape, claim.likely
    sigma = np.zeros(here.vector.size)
    sigma[likely.free] = np.sqrt(np.maximum(np.diag(likely.inverse), 0.0))
    each = np.zeros((N, 4))
    each[:, : here.gains * here.channels.shape[1]] = sigma[:-1].reshape(N, -1)[:, D:]
    stated = state.settings.sound_speed_sigma or 0.0
    spread = np.array([model.gain_sigma, model.phase_sigma])
    noise_power = claim.objective.field.noise
    ended = sorted((one for one in state.optima if np.isfinite(one.score)), key=lambda one: one.score)
    usual = GIVEN_SIGMA if state.settings.known_sigma is None else state.settings.known_sigma
    # Given positions fix the frame unless they are less accurate than expected.
    framed = bool(len(problem.known)) and model.known_sigma <= given.INACCURATE * usual
    tried = tuple(TriedOptimum(one.positions, one.score, framed and given.same_given(state, one)) for one in ended)
    if model.window_positions is not None:  # the short windows determine the array
        tried = tuple(TriedOptimum(x, 0.0, False) for x in (state.positions, model.window_rival) if x is not None)
    return Estimate(
        problem=problem,
        modes=state.modes,
        positions=state.positions,
        ended=state.converged or state.finished,
        channels=ChannelEstimate(state.gains, each[:, :2], model.filters, each[:, 2:], spread, model.channel_noise),
        field=FieldEstimate(model.noise_fraction, model.power[state.modes], noise_power, claim.weakened.terms),
        spread=claim.spread,
        given=_given(problem, state, claim, here),
        log_speed=model.log_speed,
        log_speed_sigma=float(sigma[-1]) if len(problem.known) else stated,
        tried=tried,
        window_ratio=0.0 if model.window_positions is None else model.window_ratio,
        flat=model.window_positions is not None and must_be_flat(state.positions),
    )


def estimate_at(problem: Problem, settings: SolverSettings, positions: Reals, modes: slice, ended: bool) -> Estimate:
    """Return the estimate at positions (N, D), metres, that a solver with another cost has found.

    ended : whether the run of that solver has ended

    Channels count as matched and given positions as exact; the noise is what the likelihood leaves unexplained. With an
    uncertain sound speed, positions and speed move to the nearest minimum of the likelihood.
    """
    first, last, _ = modes.indices(len(problem.pressures))
    matched = replace(settings, modes=last, gains="fixed", known_sigma=0.0)
    # The other solver has used no arrivals.
    problem = replace(objectives.in_unit_power(problem), arrivals=None, arrival_sigma=None)
    begun = begin(State, problem, matched, 0, positions)
    state = replace(begun, first=first + 1, last=last, progress=replace(begun.progress, stage=FINAL))
    state = noise.with_noise(problem, state, rough=False)
    state = refined(problem, noise.with_last_field(problem, state))
    # Several rounds are needed, as in the last stage: the first one spreads a faulty channel's noise over all channels.
    used = objectives.used_modes(problem, state)
    for _ in range(FIELD_ROUNDS):
        for _ in range(STAGES[FINAL].max_steps):
            objective = objectives.objective_of(problem, state, used)
            terms = objective.evaluate(objectives.unknowns_of(state)).terms
            state = noise.with_power(state, used, objective.field, terms)
            state = noise.with_directions(problem, state, used, DIRECTION_UPDATES)
        state = noise.with_noise(problem, state, rough=False)
    if objectives.speed_is_free(problem, state):
        objective = objectives.objective_of(problem, state, objectives.used_modes(problem, state))
        state = objectives.with_unknowns(state, objectives.descend(objectives.unknowns_of(state), objective, 60)[0])
    found = result(problem, replace(state, finished=ended))
    # The minimum of the other cost is elsewhere: a remaining Newton step of the likelihood does not mean that the
    # solver stopped early.
    return replace(found, spread=replace(found.spread, step=np.zeros_like(found.spread.step)), interpolates=True)


def _given(problem: Problem, state: State, claim: Claim, here: objectives.Unknowns) -> GivenEstimate:
    objective, at_objective = claim.objective, claim.evaluated.terms
    sigma = objective.priors.known_sigma or given.EXACT_SIGMA
    every = replace(objective.priors, known=problem.known, places=problem.known_positions, known_sigma=sigma)

    def probability(kept: np.ndarray) -> float:
        priors = replace(every, known=problem.known[kept], places=problem.known_positions[kept])
        return _agreement(replace(objective, priors=priors), here, at_objective, claim.excess)

    expected = GIVEN_SIGMA if state.settings.known_sigma is None else state.settings.known_sigma
    stiffness, terms = every.of_known(state.positions)[2], (at_objective, claim.weakened.terms)
    try:
        near = given.free_array(problem, state, 0, terms)
    except np.linalg.LinAlgError:
        mirror_advantage, contradicted = np.inf, None
    else:
        mirror_advantage = given.mirror_advantage(problem, state, near)
        contradicted = given.contradicted(problem, state, near)
    carried = objectives.given_carry_scale(problem) and state.model.window_positions is None
    return GivenEstimate(
        state.model.known_sigma, expected, stiffness, carried, probability, mirror_advantage, contradicted
    )


CLEAR = 0.05  # probability above which the linear estimate of S is accepted
MARGIN = 1.5  # factor on the linear estimate of S in this decision


def _agreement(
    constrained: objectives.Objective, here: objectives.Unknowns, at_objective: Terms, excess: float
) -> float:
    """Return the probability that given positions and pressures disagree by chance as much as they do.

    S needs minimisations, which are costly. They are only done if the linear estimate of this probability is low.
    `excess` is e of the module docstring.
    """
    D = here.positions.shape[1]
    freedom = len(constrained.priors.known) * D - D * (D + 1) // 2

    def probability(prior: float, rest: float, margin: float = 1.0) -> float:
        S = margin * (prior + rest) ** 2 / max(prior + excess * rest, 1e-300)
        return float(chdtrc(freedom, 2 * S))

    alone = replace(constrained, priors=constrained.priors.without_given())
    at_minimum = [objectives.quadratic(here, x, x.with_priors(here, at_objective)) for x in (alone, constrained)]
    prior = constrained.priors.of_known(here.positions)[0]
    rest = max(0.0, at_minimum[0].decrease - at_minimum[1].decrease)
    if probability(prior, rest, MARGIN) > CLEAR:
        return probability(prior, rest)
    there, _ = objectives.descend(here, constrained, FREE_STEPS)
    prior, linear = constrained.priors.of_known(there.positions)[0], objectives.quadratic(there, alone).decrease
    if probability(prior, linear, MARGIN) > CLEAR:
        return probability(prior, linear)
    return probability(prior, objectives.descend(there, alone, FREE_STEPS)[1])
