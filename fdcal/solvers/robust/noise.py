"""Estimates other than positions and gains: noise, power, directions, standard deviations of priors, and evidence."""

from dataclasses import replace

import numpy as np

from ...cost.kernels import directions_needed
from ...cost.likelihood import FieldModel, Terms
from ...cost.noise import (
    MAX_NOISE_FRACTION,
    estimate_noise,
    hyper_cost,
    learned_powers,
    updated_channel_noise,
    updated_power,
)
from ...model.problem import Problem
from ...model.validation import Bools, Integers, Reals, frozen_array
from . import arrivals as direct_sound
from . import objective as objectives
from .state import CORNER_SIGMA, DELAY_SIGMA, MIN_NOISE_FRACTION, SUSPICIOUS, Model, State


def with_power(state: State, used: Integers, chosen: FieldModel, terms: Terms) -> State:
    """Return `state` with power and channel noise after one step of their fixed-point iteration.

    If short windows are used, the positions do not minimise the residual of the long rows. The residual then contains
    no information on the noise of a channel, and the channel noise does not change.
    """
    power, model = np.array(state.model.power), state.model
    power[used] = updated_power(chosen, terms)
    kept = model.window_positions is not None
    channel_noise = model.channel_noise if kept else updated_channel_noise(chosen, terms)
    return replace(state, model=replace(model, power=power, channel_noise=channel_noise))


# largest number of modes, evenly spaced, from which the noise is estimated; with all modes the estimate takes three
# times as long, and the error of 1 of 22 arrays grows from 36 to 54 mm
NOISE_MODES = 24
# The reported noise is used if it is within this factor of the estimate. If it were always used, one array of the suite
# would not be found; if it were never used, errors could grow by a quarter.
BELIEVED = 2.0


def with_noise(problem: Problem, state: State, rough: bool = True) -> State:
    """Return `state` with the noise and the position error that explain the residual best.

    rough : whether the position error adds to the noise of each mode; otherwise noise alone explains the residual
    """
    used, model = objectives.used_modes(problem, state, NOISE_MODES), state.model
    floor = MIN_NOISE_FRACTION["others" if model.damped or model.directional else "isotropic"]
    seen = objectives.corrected(problem, state, used)
    found = estimate_noise(state.positions, seen, objectives.field_of(problem, state, used), floor)
    fraction = found.noise_fraction if rough else found.alone
    k = np.real(problem.wavenumbers)
    noise, given = np.full(len(k), max(fraction, floor)), given_noise(problem, state)
    level = 0.0 if given is None else float(np.median(given))
    if given is not None and level / BELIEVED < fraction < level * BELIEVED:
        noise = np.maximum(given, floor)
    noise = np.minimum(noise + rough * (k * found.spread) ** 2 / problem.dimension, MAX_NOISE_FRACTION)
    return replace(state, model=replace(model, noise=noise, noise_fraction=fraction, spread=found.spread))


def given_noise(problem: Problem, state: State) -> np.ndarray | None:
    """Return the noise power (M,) in the settings or the measurement; None if none is given or none may be used."""
    if state.settings.snr_db is not None:
        return np.full(len(problem.pressures), 1 / (1 + 10 ** (state.settings.snr_db / 10)))
    return problem.noise_power if state.settings.noise == "reported" else None


def centred(state: State) -> State:
    """Return `state` with gains of median 1 and delays of median 0; a common gain becomes a factor of the powers."""
    shift = np.median(state.gains - state.offsets, axis=0)
    louder = np.exp(2 * shift[0])
    filters = state.model.filters
    if state.model.delay_sigma > 0:
        filters = frozen_array(filters - [np.median(filters[:, 0]), 0.0], float)
    model = replace(state.model, power=state.model.power * louder, noise=state.model.noise * louder, filters=filters)
    return replace(state, gains=state.gains - shift, model=model)


# smallest sigma of gains and phases, nepers and radians; with 1e-3 the errors of matched arrays with little noise grow
# by 10 to 15 %
MIN_SPREAD = 1e-4
# Expected (and smallest) and largest sigma of the delays, metres, and of the corners, rad/m. The first counts as one
# more channel when the sigma is estimated.
PRIOR_FILTER = (2e-4, 2e-3)
MAX_FILTER = (0.2, 2.0)
# expected error of a given coordinate, metres, and its weight as a number of positions; without them an array with a
# wrong given position and an error of 27 mm gets the verdict "good", and the 95 % ellipses cover 2 percentage
# points fewer of the true positions
EXPECTED_GIVEN = 2e-3
KNOWN_COUNT = 2


def with_spreads(problem: Problem, state: State, trial: objectives.ChannelStep) -> State:
    """Return `state` with the sigmas of gains, filters and given positions after a step, by empirical Bayes."""
    (N, D), model, H = state.positions.shape, state.model, trial.matrix
    assert H is not None  # the caller has checked that no covariance was singular
    variance = np.zeros(trial.unknowns.vector.size)
    variance[trial.free] = np.diag(np.linalg.inv(H + 1e-12 * np.diag(np.diag(H))))
    variance = variance[:-1].reshape(N, -1)
    stated, sigmas = (state.settings.gain_sigma_db, state.settings.phase_sigma_deg), list[float]()
    for column, sigma in enumerate((model.gain_sigma, model.phase_sigma)):
        e = state.gains[:, column] - state.offsets[:, column]
        fresh = _updated_sigma(sigma, e, variance[:, D + column], 1, MIN_SPREAD)
        sigmas.append(fresh if stated[column] is None else sigma)
    filters: list[float] = []
    for column, sigma in enumerate((model.delay_sigma, model.corner_sigma)):
        expected = PRIOR_FILTER[column]
        if sigma > 0:
            e, v = np.append(model.filters[:, column], expected), np.append(variance[:, D + 2 + column], 0.0)
            sigma = _updated_sigma(sigma, e, v, 1, expected, MAX_FILTER[column])
        filters.append(sigma)
    (known, places), sigma = objectives.given_in_use(problem, state), model.known_sigma
    if len(known) and sigma > 0 and not objectives.given_carry_scale(problem):
        e = np.linalg.norm(state.positions[known] - places, axis=1)
        e = np.append(e, EXPECTED_GIVEN * np.sqrt(D) * np.ones(KNOWN_COUNT))
        v = np.append(variance[known, :D].mean(axis=1), np.zeros(KNOWN_COUNT))
        # Only a hypothesis on the given positions (`given`) may increase sigma above its first value.
        max_sigma = max(objectives.first_known_sigma(problem, state.settings), sigma)
        sigma = min(_updated_sigma(sigma, e, v, D, 1e-5), max_sigma)
    spreads = dict(zip(("gain_sigma", "phase_sigma", "delay_sigma", "corner_sigma"), sigmas + filters, strict=True))
    return replace(state, model=replace(model, known_sigma=sigma, **spreads))


FILTER_NATS = 3.0  # smallest evidence, nats, for which the filters of all channels are estimated


def with_filters(problem: Problem, state: State) -> State:
    """Return `state` with delays and corners of all channels free, if there is evidence that the channels differ.

    S are the eigenvalues of the curvature of the cost with respect to the filters, with all other unknowns at their
    minimum; z is the gradient along its eigenvectors. In Laplace's approximation the log evidence of a prior sigma,
    relative to sigma = 0, is

        evidence(sigma) = sum z^2 / (S + sigma^-2) / 2 - log(1 + sigma^2 S) / 2

    In a narrow band, or with few microphones, a delay has the same effect as a phase or a change of position. Then S is
    small, and there is no evidence.
    """
    if not objectives.gains_are_free(state) or state.model.delay_sigma > 0:
        return state
    objective = objectives.objective_of(problem, state, objectives.used_modes(problem, state))
    D, channels = state.positions.shape[1], np.hstack([state.gains, state.model.filters])
    here = replace(objectives.unknowns_of(state), channels=channels, filters=True)
    free = objective.free(here)
    kind = np.where(free < here.vector.size - 1, free % (D + 4) - (D + 2), -1)
    try:
        gradient, matrix = objectives.reduced(here, objective.evaluate(here), free, objective.priors)
        found = [_likeliest_spread(gradient, matrix, kind < 0, kind == c, c) for c in (0, 1)]
    except np.linalg.LinAlgError:
        return state
    if max(evidence for evidence, _ in found) < FILTER_NATS:
        return state
    return replace(state, model=replace(state.model, delay_sigma=found[0][1], corner_sigma=found[1][1]))


def _likeliest_spread(gradient: Reals, matrix: Reals, rest: Bools, filters: Bools, c: int) -> tuple[float, float]:
    """Return the largest log evidence for filters, nats, and its sigma.

    rest, filters : (F,) bool, unknowns other than filters, and filters of the kind c: 0 for delays, 1 for corners
    """
    across = matrix[np.ix_(filters, rest)] @ objectives.scaled_inverse(matrix[np.ix_(rest, rest)])
    values, vectors = np.linalg.eigh(matrix[np.ix_(filters, filters)] - across @ matrix[np.ix_(rest, filters)])
    z2, values = (vectors.T @ (gradient[filters] - across @ gradient[rest])) ** 2, np.maximum(values, 0.0)[:, None]
    sigma = np.geomspace(PRIOR_FILTER[c], MAX_FILTER[c], 33)
    evidence = np.sum(z2[:, None] / (values + sigma**-2.0) - np.log1p(values * sigma**2), axis=0) / 2
    best = int(np.argmax(evidence))
    return float(evidence[best]), float(sigma[best])


def with_arrivals(problem: Problem, state: State) -> State:
    """Return `state` with arrivals in use, if there are any, at the nearby positions that fit them best."""
    if problem.arrivals is None or (arrivals := direct_sound.arrivals_of(problem, None)) is None:
        return state
    constrained = objectives.objective_of(problem, state, np.arange(0)).priors.constrained
    x, sigma = direct_sound.near_positions(arrivals, state.positions, state.model.spread, constrained)
    return _with_sigma_of(problem, replace(state, positions=frozen_array(x, float)), sigma)


def with_arrival_sigma(problem: Problem, state: State, trial: objectives.ChannelStep) -> State:
    """Return `state` with the sigma of the arrivals of each take after a step, by empirical Bayes."""
    arrivals = direct_sound.arrivals_of(problem, state.model.arrival_sigma)
    if arrivals is None or trial.matrix is None:
        return state
    H, index = trial.matrix, objectives.arrival_index(trial.unknowns)
    covariance = np.zeros((trial.unknowns.vector.size,) * 2)
    covariance[np.ix_(trial.free, trial.free)] = np.linalg.inv(H + 1e-12 * np.diag(np.diag(H)))
    begun = replace(arrivals, start=trial.source)
    terms = begun.terms(state.positions, state.model.log_speed, True, trial.unknowns.delays)
    return _with_sigma_of(problem, state, direct_sound.updated_sigma(arrivals, terms, covariance[np.ix_(index, index)]))


def _with_sigma_of(problem: Problem, state: State, sigma: Reals) -> State:
    """Return `state` with `sigma` for the takes that have enough arrivals, and the stated sigma for the others."""
    assert problem.arrivals is not None and problem.arrival_sigma is not None
    every = problem.sound_speed * np.array(problem.arrival_sigma)
    every[direct_sound.counted(problem)] = sigma
    return replace(state, model=replace(state.model, arrival_sigma=frozen_array(every, float)))


def _updated_sigma(
    sigma: float, deviation: Reals, variance: Reals, components: int, floor: float, maximum: float = np.inf
) -> float:
    """Return the updated sigma of a prior: at most 4 times larger or smaller, and from `floor` to `maximum`.

    Its square is the weighted sum of the squared deviations, divided by the number of components that the data
    determine. deviation : (K,), norm of the components of each deviation; variance : (K,), posterior variance of one
    component
    """
    weight = objectives.prior_stiffness(deviation**2, sigma, components) * sigma**2
    determined = components * np.clip(1 - weight * variance / sigma**2, 0.0, 1.0)
    fresh = np.sqrt(np.sum(weight * deviation**2) / max(float(determined.sum()), 1e-3))
    return float(np.clip(np.clip(fresh, sigma / 4, 4 * sigma), floor, maximum))


# A stage does not end while the logarithm of a sigma changes by more than this. Without this condition an array without
# noise ends with an error of 0.011 instead of 0.004 mm.
SAME_SPREAD = 0.2


def same_sigmas(before: Model, after: Model) -> bool:
    """Return whether the sigmas of gains, phases, filters and arrivals have hardly changed."""
    if (before.arrival_sigma is None) != (after.arrival_sigma is None):
        return False
    pairs = [(before.gain_sigma, after.gain_sigma), (before.phase_sigma, after.phase_sigma)]
    for column, least in enumerate(PRIOR_FILTER):
        old, new = ((one.delay_sigma, one.corner_sigma)[column] for one in (before, after))
        pairs.append((max(old, least), max(new, least)))
    if before.arrival_sigma is not None and after.arrival_sigma is not None:
        pairs += zip(before.arrival_sigma, after.arrival_sigma, strict=True)
    return all(abs(np.log(new / old)) < SAME_SPREAD for old, new in pairs)


def score(problem: Problem, state: State, objective: objectives.Objective, trial: objectives.ChannelStep) -> float:
    """Return the negative log evidence at the end of a restart, in Laplace's approximation, up to a constant.

    objective : the objective whose value is the cost of `state`; this function adds the normalisation of its priors
    """
    N, D = state.positions.shape
    priors, cost = objective.priors, state.cost
    cost += hyper_cost(objective.field, objectives.corrected(problem, state, objectives.used_modes(problem, state)))
    cost += 0.5 * np.linalg.slogdet(np.asarray(trial.matrix))[1]
    if priors.known_sigma > 0:
        cost += len(problem.known) * D * np.log(priors.known_sigma)
    if trial.unknowns.gains:
        cost += N * (np.log(priors.gain_sigma) + np.log(priors.phase_sigma))
        if priors.delay_sigma > 0:
            cost += N * (np.log(priors.delay_sigma) + np.log(priors.corner_sigma))
        else:
            cost += np.sum((state.model.filters != 0) * np.log([DELAY_SIGMA, CORNER_SIGMA]))
    if objective.arrivals is not None:
        ratio = objective.arrivals.sigma / objective.arrivals.stated
        cost += direct_sound.PRIOR_COUNT * np.sum(np.log(ratio) + (1 / ratio**2 - 1) / 2)
    if objectives.speed_is_free(problem, state):
        cost += np.log(state.settings.sound_speed_sigma or 1.0)
    return float(cost)


def healthy(model: Model) -> np.ndarray:
    """Return which channels are not suspicious : (N,) bool."""
    return model.channel_noise < SUSPICIOUS


# nepers, log gain below which a channel counts as silent; the solver may take a dead channel for a microphone of low
# gain far outside the array
SILENT_GAIN = -3.0


def with_silent_inside(problem: Problem, state: State) -> State:
    """Return `state` with free microphones of silent or purely noisy channels moved to the middle of the others.

    The pressures do not determine their positions, and far outside they would increase the number of directions of the
    field. All of their power counts as noise.
    """
    tau, all_noise = np.array(state.model.channel_noise), 1 / state.model.noise_fraction
    silent = (tau > all_noise) | (state.gains[:, 0] < SILENT_GAIN)
    others = healthy(state.model) & ~silent
    if not np.any(silent) or not np.any(others):
        return state
    x, moved = np.array(state.positions), silent.copy()
    moved[problem.known] = False
    x[moved] = x[others].mean(axis=0)
    tau[silent] = np.maximum(tau[silent], all_noise)
    model = replace(state.model, channel_noise=tau)
    return replace(state, positions=frozen_array(x, float), stage_start=frozen_array(x, float), model=model)


# The imaginary part of k is used if (Im k R)^2 exceeds this times the noise fraction, where R is the RMS radius of the
# array. If it were always used, the errors of 2 of 75 arrays would grow: from 1.0 to 1.1 mm, and from 45 to 80 mm for a
# circle without given positions.
DAMPED = 0.1


def is_damped(problem: Problem, state: State) -> bool:
    """Return whether the noise is so low that the damping of the modes must be modelled."""
    k = problem.wavenumbers[state.modes]
    radius = float(np.sqrt(np.sum((state.positions - state.positions.mean(axis=0)) ** 2, axis=1).mean()))
    return bool((np.abs(np.imag(k)).max() * radius) ** 2 > DAMPED * state.model.noise_fraction)


MAX_DIRECTION_PRODUCTS = 3e8  # products M N^2 Q, for Q directions, above which a field in space stays isotropic


def with_last_field(problem: Problem, state: State) -> State:
    """Return `state` with the field of the last stage, which is directional unless that takes too long.

    For a plane array in space the field stays isotropic.
    """
    k = objectives.wavenumbers(problem, state)[objectives.used_modes(problem, state)]
    products = len(k) * len(state.positions) ** 2 * directions_needed(state.positions, k, problem.dimension)
    slow = problem.dimension == 3 and (state.quick or products > MAX_DIRECTION_PRODUCTS)
    if slow or objectives.given_carry_scale(problem):
        return state
    return replace(state, model=replace(state.model, damped=is_damped(problem, state), directional=True))


# Weight of the power by direction of a take when that of one of its rows is estimated, as a number of observations, for
# fields of 2 and of 3 dimensions. It is lower in two dimensions, because the modes of a plate differ more than the
# frequencies of a room. If all rows of a take had the same power by direction, the errors of 9 of 27 arrays would be 4
# to 160 % larger; if all takes had the same one, a measured array of 70 microphones would not be found.
DIRECTION_COUNT = {2: 0.3, 3: 3.0}


def with_directions(problem: Problem, state: State, used: Integers, updates: int) -> State:
    """Return `state` with the power by direction of a directional field after `updates` iterations."""
    model = state.model
    if not model.directional:
        return state
    if model.directions is None:
        k = objectives.wavenumbers(problem, state)
        Q = directions_needed(state.positions, k, problem.dimension)
        model = replace(model, directions=np.ones((len(k), Q)))
    learned, seen = np.array(model.directions), objectives.corrected(problem, state, used)
    field, count = objectives.field_of(problem, replace(state, model=model), used), DIRECTION_COUNT[problem.dimension]
    learned[used] = learned_powers(state.positions, seen, field, problem.takes[used], updates, count)
    return replace(state, model=replace(model, directions=frozen_array(learned, float)))
