"""What the likelihood solver has found, as `fdcal.solvers.interface.Estimate`.

    H      Gauss-Newton matrix of cost and priors over everything that is free;  P = H^-1, the covariance by the model
    g_b    gradient of a block of neighbouring frequencies of a take, or of the arrivals of a take, less their mean;
           H_b its part of H

H takes the field as `WEAKER_FIELD` times as powerful, which weakens the prior of an isotropic field: what becomes
uncertain rests on that prior and not on the wave equation. Without given positions the covariance is that of the array
without its rigid motions; in the frame of the least gauge, of the array moved into it.

A room is not the random field of the model, and its blocks disagree by more, or less, than H says. The sandwich of
their gradients measures it (Huber 1967, White 1980), with the leverage of each block corrected as by leaving it out
(MacKinnon and White 1985):

    J = sum_b H^-1 g_b g_b^T (H - H_b)^-1,    Q = P (sum_b H_b) P,    dispersion = tr J / tr Q

over the coordinates of the microphones whose channels are healthy. Where the model holds, J is Q on average: the part
of P that is the error of the data. The rest is the error of what the priors state, which blocks cannot show.

Given positions and pressures agree if the array without given positions is hardly likelier:

    S = prior(x) + cost(x) - min cost      over arrays that no given position holds

Under the model 2 S has a chi-square distribution with one degree of freedom for each coordinate given beyond those that
place the array as a whole. A given position that is wrong, a wrong sound speed and an array that was not found all make
S large. So does a field that is not as random as its model: where the covariance that is claimed is e times that of the
likelihood, S = a + b of prior a and rest b is (a + b)^2 / (a + e b) instead, as a quadratic of one coordinate has it.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from ...cost.likelihood import Terms
from ...model.gauge import GaugeFrame, rigid_motions
from ...model.problem import Problem
from ...model.settings import SolverSettings
from ...model.validation import Bools, Reals
from ..interface import ChannelEstimate, Estimate, FieldEstimate, GivenEstimate, PositionSpread, TriedOptimum
from . import given, noise
from .objective import (
    Evaluation,
    Objective,
    Quadratic,
    Unknowns,
    arrival_index,
    descend,
    given_carry_scale,
    in_unit_power,
    objective_of,
    quadratic,
    speed_is_free,
    unknowns_of,
    used_modes,
    with_unknowns,
)
from .schedule import begin, refined
from .state import (
    DIRECTION_UPDATES,
    FINAL,
    FREE_STEPS,
    GIVEN_SIGMA,
    STAGES,
    State,
)

# blocks of rows: neighbours are not independent, and with 20 blocks J comes out a tenth lower; fewest that count
BLOCKS, MIN_BLOCKS = 10, 4
LEVERAGE = 0.95  # part of H_b that is taken off H, so that what one block alone determines stays finite
FIELD_ROUNDS = 3  # of learning the field at given positions: a faulty channel is found in the second


def result(problem: Problem, state: State) -> Estimate:
    """Return what the solver has found at `state`."""
    problem = in_unit_power(problem)
    state = replace(state, progress=replace(state.progress, stage=FINAL), shape=state.positions)
    used = used_modes(problem, state)
    objective, here = objective_of(problem, state, used), unknowns_of(state)
    undeflated = objective.field.noise * state.model.deflation  # without what the last stage takes off the noise
    objective = replace(objective, field=replace(objective.field, noise=undeflated))
    evaluated = objective.evaluate(here)
    weakened = _weakened(objective, here, evaluated)
    likely, (N, D), model = quadratic(here, objective, weakened), state.positions.shape, state.model
    sigma = np.zeros(here.vector.size)
    sigma[likely.free] = np.sqrt(np.maximum(np.diag(likely.inverse), 0.0))
    each = np.zeros((N, 4))
    each[:, : here.gains * here.channels.shape[1]] = sigma[:-1].reshape(N, -1)[:, D:]
    stated = state.settings.sound_speed_sigma or 0.0
    spread = _spread(problem, state, objective, evaluated, likely)
    claimed = float(np.trace(spread.covariance))
    excess = max(1.0, claimed / max(float(np.trace(quadratic(here, objective, evaluated).covariance)), 1e-300))
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
        field=FieldEstimate(model.noise_fraction, model.power[state.modes], undeflated, weakened.terms),
        spread=spread,
        given=_given(problem, state, objective, here, evaluated.terms, weakened.terms, excess),
        log_speed=model.log_speed,
        log_speed_sigma=float(sigma[-1]) if len(problem.known) else stated,
        tried=_tried(problem, state),
    )


def estimate_at(
    problem: Problem, settings: SolverSettings, positions: Reals, modes: slice, converged: bool
) -> Estimate:
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
        objective = objective_of(problem, state, used_modes(problem, state))
        state = with_unknowns(state, descend(unknowns_of(state), objective, 60)[0])
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
            objective = objective_of(problem, state, used)
            state = noise.with_power(state, used, objective.field, objective.evaluate(unknowns_of(state)).terms)
            state = noise.with_directions(problem, state, used, DIRECTION_UPDATES)
        state = noise.with_noise(problem, state, state.model.deflation, rough=False)
    return state


def _weakened(objective: Objective, here: Unknowns, evaluated: Evaluation) -> Evaluation:
    """The objective with a field of more power; as it is where C is then singular."""
    try:
        return objective.weakened().evaluate(here)
    except np.linalg.LinAlgError:
        return evaluated


def _spread(
    problem: Problem, state: State, objective: Objective, evaluated: Evaluation, likely: Quadratic
) -> PositionSpread:
    """The covariance by the model, in the gauge of the problem, and how far the blocks of the data disagree with it."""
    here, gauge = likely.unknowns, _gauge(problem, state.positions)
    newton = gauge @ likely.covariance @ gauge.T
    counted = np.repeat(noise.healthy(state.model), state.positions.shape[1])
    data, dispersion = _of_data(problem, state, objective, likely, gauge, counted)
    if not len(problem.known):  # sound speed and size of a blind array are one
        x = (state.positions - state.positions.mean(axis=0)).ravel()
        newton = newton + (state.settings.sound_speed_sigma or 0.0) ** 2 * np.outer(x, x)
    own = quadratic(here, objective, evaluated)
    return PositionSpread(newton, data, dispersion, own.step, own.sigma)


def _of_data(
    problem: Problem, state: State, objective: Objective, likely: Quadratic, gauge: Reals, counted: Bools
) -> tuple[Reals, float]:
    """Q of the module (N D, N D) and tr J / tr Q over the coordinates `counted` (N D,) bool; 1 of too few blocks."""
    here, index = likely.unknowns, np.ix_(likely.free, likely.free)
    order = np.argsort(problem.takes[used_modes(problem, state)], kind="stable")
    blocks = np.array_split(order, max(1, min(BLOCKS, len(order) // 2)))
    gradients, matrices = list[Reals](), list[Reals]()
    for rows in blocks:
        part = objective.of_rows(rows)
        gradients.append(part.likelihood(here)[0][likely.free])
        matrices.append(part.weakened().likelihood(here)[1][index])
    for gradient, matrix in _of_arrivals(here, objective):
        gradients.append(gradient[likely.free])
        matrices.append(matrix[index])
    outputs = np.zeros((gauge.shape[0], len(likely.free)))
    outputs[:, : len(likely.coordinates)] = gauge[:, likely.coordinates]
    across = outputs @ likely.inverse
    data = across @ np.sum(matrices, axis=0) @ across.T
    if len(blocks) < MIN_BLOCKS:
        return data, 1.0
    try:
        return data, sandwich(likely.inverse, np.array(gradients), np.array(matrices), outputs[counted])
    except np.linalg.LinAlgError:
        return data, 1.0


def sandwich(P: Reals, gradients: Reals, matrices: Reals, outputs: Reals) -> float:
    """Return tr J / tr Q of the module over some functions of the unknowns.

    P : (F, F); gradients, matrices : (B, F) and (B, F, F), g_b and H_b of the blocks; outputs : (K, F), linear
    functions of the unknowns.
    """
    H, centred, across = np.linalg.inv(P), gradients - gradients.mean(axis=0), outputs @ P
    others = np.asarray(H - LEVERAGE * matrices)
    left_out = np.asarray(np.linalg.solve(others, np.asarray(centred[..., None])))[..., 0]
    found = np.sum((centred @ across.T) * (left_out @ outputs.T))
    model = np.sum((across @ matrices.sum(axis=0)) * across)
    return float(found / model) if model > 0 else 1.0


def _of_arrivals(here: Unknowns, objective: Objective) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Gradient and Gauss-Newton matrix of the arrivals of each take by all unknowns."""
    if objective.arrivals is None:
        return
    terms, index = objective.arrivals.terms(here.positions, here.log_speed, True, here.delays), arrival_index(here)
    for gradient, slopes in zip(terms.gradient, terms.slopes, strict=True):
        whole, matrix = np.zeros(here.vector.size), np.zeros((here.vector.size,) * 2)
        whole[index], matrix[np.ix_(index, index)] = gradient, slopes.T @ slopes
        yield whole, matrix


def _gauge(problem: Problem, positions: Reals) -> np.ndarray:
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


def _frame_rows(frame: GaugeFrame, positions: Reals) -> np.ndarray:
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
    constrained = bool(len(problem.known)) and not given.inaccurate(state)
    ended = sorted((one for one in state.optima if np.isfinite(one.score)), key=lambda one: one.score)
    return tuple(TriedOptimum(one.positions, one.score, constrained and given.same_given(state, one)) for one in ended)


def _given(
    problem: Problem,
    state: State,
    objective: Objective,
    here: Unknowns,
    at_objective: Terms,
    weakened: Terms,
    excess: float,
) -> GivenEstimate:
    sigma = objective.priors.known_sigma or given.EXACT_SIGMA
    every = replace(objective.priors, known=problem.known, places=problem.known_positions, known_sigma=sigma)

    def probability(kept: np.ndarray) -> float:
        priors = replace(every, known=problem.known[kept], places=problem.known_positions[kept])
        constrained = replace(objective, priors=priors)
        return _agreement(constrained, here, at_objective, excess)

    stated = state.settings.known_sigma
    expected = GIVEN_SIGMA if stated is None else stated
    stiffness = every.of_known(state.positions)[2]
    return GivenEstimate(
        state.model.known_sigma,
        expected,
        stiffness,
        given_carry_scale(problem),
        probability,
        given.contradicted(problem, state, (at_objective, weakened)),
    )


CLEAR = 0.05  # probability of the linear estimate above which no array is sought
MARGIN = 1.5  # factor on that estimate


def _agreement(constrained: Objective, here: Unknowns, at_objective: Terms, excess: float) -> float:
    """Probability of the disagreement; the array without given positions is sought only where it could be low.

    `excess` : variance that is claimed over that of the likelihood, of which S is made of two parts, prior and rest.
    """
    D = here.positions.shape[1]
    freedom = len(constrained.priors.known) * D - D * (D + 1) // 2

    def probability(prior: float, rest: float, margin: float = 1.0) -> float:
        S = margin * (prior + rest) ** 2 / max(prior + excess * rest, 1e-300)
        return float(chdtrc(freedom, 2 * S))

    alone = replace(constrained, priors=constrained.priors.without_given())
    decreases = (quadratic(here, one, one.with_priors(here, at_objective)).decrease for one in (alone, constrained))
    prior, rest = constrained.priors.of_known(here.positions)[0], max(0.0, next(decreases) - next(decreases))
    if probability(prior, rest, MARGIN) > CLEAR:
        return probability(prior, rest)
    there, _ = descend(here, constrained, FREE_STEPS)
    prior, linear = constrained.priors.of_known(there.positions)[0], quadratic(there, alone).decrease
    if probability(prior, linear, MARGIN) > CLEAR:
        return probability(prior, linear)
    return probability(prior, descend(there, alone, FREE_STEPS)[1])
