"""What is estimated beside positions and gains: noise, power, directions, spreads of the priors, and evidence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...cost.angular_spectrum import learned_powers
from ...cost.kernels import directions_needed
from ...cost.likelihood import FieldModel, Terms
from ...cost.noise import NOISE_RULES, estimate_noise, hyper_cost, profile_cost, updated_channel_noise, updated_power
from ...model.problem import Problem
from ...model.validation import frozen_array
from ..estimate import stretch_sigma
from . import arrivals as direct_sound
from .objective import (
    ChannelStep,
    Objective,
    arrival_index,
    corrected,
    field_of,
    field_wavenumbers,
    first_known_sigma,
    free_directions,
    gains_are_free,
    given_carry_scale,
    held_positions,
    objective_of,
    position_covariance,
    reduced,
    scaled_inverse,
    speed_is_free,
    spring,
    state_arrivals,
    unknowns_of,
    used_modes,
    wavenumbers,
)
from .state import ASSUMED, CONDITIONAL, DIRECTIONAL, FINAL, OUTLIERS, KernelName, Model, State


def with_power(state: State, used, chosen: FieldModel, terms: Terms) -> State:
    """Return `state` with power and channel noise after one round of their fixed point."""
    power = np.array(state.model.power)
    power[used] = updated_power(chosen, terms)
    return replace(state, model=replace(state.model, power=power, channel_noise=updated_channel_noise(chosen, terms)))


def with_noise(problem: Problem, state: State, deflation: float = 1.0, rough: bool = True) -> State:
    """Return `state` with the noise and the spread of the positions that explain best what is left.

    rough : whether the spread adds to the noise; where every microphone has found its place, all is noise
    """
    used, floor = used_modes(problem, state, ASSUMED.noise_modes), ASSUMED.min_share[state.model.kernel]
    seen = corrected(problem, state, used)
    found = estimate_noise(state.positions, seen, field_of(problem, state, used), floor)
    share = found.share if rough else found.alone
    k = np.real(problem.wavenumbers)
    noise, given = np.full(len(k), max(share, floor)), given_noise(problem, state)
    level = 0.0 if given is None else float(np.median(given))
    if given is not None and level / ASSUMED.believed < share < level * ASSUMED.believed:
        noise = np.maximum(given, floor)
    noise = np.maximum(noise / deflation, floor)
    noise = np.minimum(noise + rough * (k * found.spread) ** 2 / problem.dimension, NOISE_RULES.max_share)
    model = replace(state.model, noise=noise, share=share, spread=found.spread, deflation=deflation)
    return replace(state, model=model)


def misfit(problem: Problem, state: State) -> float:
    """Return -log likelihood of the pressures with the noise found and each mode's likeliest power of the field."""
    used = used_modes(problem, state, ASSUMED.noise_modes)
    seen = corrected(problem, state, used)
    return profile_cost(state.positions, seen, field_of(problem, state, used), state.model.share)


def given_noise(problem: Problem, state: State) -> np.ndarray | None:
    """Return the noise power of the measurement (M,), None where it is not given or not to be used."""
    if state.settings.snr_db is not None:
        return np.full(len(problem.pressures), 1 / (1 + 10 ** (state.settings.snr_db / 10)))
    return problem.noise_power if state.settings.noise == "reported" else None


def centred(state: State) -> State:
    """Return `state` with gains whose median is 1, and delays of median 0: what is common to all is the field's."""
    shift = np.median(state.gains - state.offsets, axis=0)
    louder = np.exp(2 * shift[0])
    filters = state.model.filters
    if state.model.delay_sigma > 0:
        filters = frozen_array(filters - [np.median(filters[:, 0]), 0.0], float)
    model = replace(state.model, power=state.model.power * louder, noise=state.model.noise * louder, filters=filters)
    return replace(state, gains=state.gains - shift, model=model)


def with_spreads(problem: Problem, state: State, trial: ChannelStep) -> State:
    """Return `state` with the spreads of gains and given positions by empirical Bayes (MacKay) after a step."""
    (N, D), model, H = state.positions.shape, state.model, trial.matrix
    assert H is not None  # of a step whose covariance was not singular
    variance = np.zeros(trial.unknowns.vector.size)
    variance[trial.free] = np.diag(np.linalg.inv(H + 1e-12 * np.diag(np.diag(H))))
    variance = variance[:-1].reshape(N, -1)
    stated, sigmas = (state.settings.gain_sigma_db, state.settings.phase_sigma_deg), []
    for column, sigma in enumerate((model.gain_sigma, model.phase_sigma)):
        e = state.gains[:, column] - state.offsets[:, column]
        fresh = _updated_sigma(sigma, e, variance[:, D + column], 1, ASSUMED.min_sigma)
        sigmas.append(fresh if stated[column] is None else sigma)
    filters = []
    for column, sigma in enumerate((model.delay_sigma, model.corner_sigma)):
        expected = ASSUMED.prior_filter[column]
        if sigma > 0:
            e, v = np.append(model.filters[:, column], expected), np.append(variance[:, D + 2 + column], 0.0)
            sigma = _updated_sigma(sigma, e, v, 1, expected, ASSUMED.max_filter[column])
        filters.append(sigma)
    (known, places), sigma = held_positions(problem, state), model.known_sigma
    if len(known) and sigma > 0 and not given_carry_scale(problem):
        e = np.linalg.norm(state.positions[known] - places, axis=1)
        e = np.append(e, ASSUMED.given_sigma * np.sqrt(D) * np.ones(ASSUMED.known_count))
        v = np.append(variance[known, :D].mean(axis=1), np.zeros(ASSUMED.known_count))
        at_most = max(first_known_sigma(problem, state.settings), sigma)  # greater by a hypothesis alone (`given`)
        sigma = min(_updated_sigma(sigma, e, v, D, 1e-5), at_most)
    spreads = dict(zip(("gain_sigma", "phase_sigma", "delay_sigma", "corner_sigma"), sigmas + filters, strict=True))
    return replace(state, model=replace(model, known_sigma=sigma, **spreads))


def with_filters(problem: Problem, state: State) -> State:
    """Return `state` with delays and corners of all channels free if the channels differ in either.

    With the curvature S of the cost by them, all else at its minimum, and the gradient z along its eigenvectors,

        evidence(sigma) = sum z^2 / (S + sigma^-2) / 2 - log(1 + sigma^2 S) / 2    over sigma = 0, by Laplace.

    Over a narrow band, or with few microphones, a delay is a phase or a place: S is small, and there is no evidence.
    """
    if not gains_are_free(state) or state.model.delay_sigma > 0:
        return state
    goal, here = objective_of(problem, state, used_modes(problem, state)), unknowns_of(state)
    D, channels = state.positions.shape[1], np.hstack([state.gains, state.model.filters])
    here = replace(here, channels=channels, filters=True)
    free = free_directions(here, goal.priors.held, None, speed_is_free(problem, state))
    kind = np.where(free < here.vector.size - 1, free % (D + 4) - (D + 2), -1)
    try:
        gradient, matrix = reduced(here, goal.evaluate(here), free, not len(problem.known))
        found = [_likeliest_spread(gradient, matrix, kind < 0, kind == c, c) for c in (0, 1)]
    except np.linalg.LinAlgError:
        return state
    if max(evidence for evidence, _ in found) < ASSUMED.filter_nats:
        return state
    return replace(state, model=replace(state.model, delay_sigma=found[0][1], corner_sigma=found[1][1]))


def _likeliest_spread(gradient, matrix, rest, filters, c: int) -> tuple[float, float]:
    """Evidence for a spread of filters, nats over none, and the likeliest one; rest, filters : (F,) bool."""
    across = matrix[np.ix_(filters, rest)] @ scaled_inverse(matrix[np.ix_(rest, rest)])
    values, vectors = np.linalg.eigh(matrix[np.ix_(filters, filters)] - across @ matrix[np.ix_(rest, filters)])
    z2, values = (vectors.T @ (gradient[filters] - across @ gradient[rest])) ** 2, np.maximum(values, 0.0)[:, None]
    sigma = np.geomspace(ASSUMED.prior_filter[c], ASSUMED.max_filter[c], 33)
    evidence = np.sum(z2[:, None] / (values + sigma**-2.0) - np.log1p(values * sigma**2), axis=0) / 2
    best = int(np.argmax(evidence))
    return float(evidence[best]), float(sigma[best])


def with_arrivals(problem: Problem, state: State) -> State:
    """Return `state` with arrivals that count, if there are any, at positions near by that fit these best."""
    arrivals = direct_sound.arrivals_of(problem, None)
    if arrivals is None:
        return state
    held = objective_of(problem, state, slice(0)).priors.held
    x, sigma = direct_sound.near_positions(arrivals, state.positions, state.model.spread, held)
    return _with_sigma_of(problem, replace(state, positions=frozen_array(x, float)), sigma)


def with_arrival_sigma(problem: Problem, state: State, trial: ChannelStep) -> State:
    """Return `state` with the sigma of the arrivals of each take by empirical Bayes after a step."""
    arrivals = state_arrivals(problem, state)
    if arrivals is None or trial.matrix is None or trial.free.ndim != 1:
        return state
    H, index = trial.matrix, arrival_index(trial.unknowns)
    covariance = np.zeros((trial.unknowns.vector.size,) * 2)
    covariance[np.ix_(trial.free, trial.free)] = np.linalg.inv(H + 1e-12 * np.diag(np.diag(H)))
    begun = replace(arrivals, start=trial.source)
    terms = begun.terms(state.positions, state.model.log_speed, True, trial.unknowns.delays)
    return _with_sigma_of(problem, state, direct_sound.updated_sigma(arrivals, terms, covariance[np.ix_(index, index)]))


def _with_sigma_of(problem: Problem, state: State, sigma) -> State:
    """`state` with a sigma for each take that has enough arrivals."""
    assert problem.arrivals is not None and problem.arrival_sigma is not None
    every = problem.sound_speed * np.array(problem.arrival_sigma)
    every[direct_sound.counted(problem)] = sigma
    return replace(state, model=replace(state.model, arrival_sigma=frozen_array(every, float)))


def _updated_sigma(sigma: float, deviation, variance, components: int, floor: float, most: float = np.inf) -> float:
    """Spread of a prior: squared deviations over how many the data determine.

    deviation : (K,) root of the sum of squares of the components; variance : (K,) posterior, per component
    """
    weight = spring(deviation**2, sigma, components) * sigma**2
    determined = components * np.clip(1 - weight * variance / sigma**2, 0.0, 1.0)
    fresh = np.sqrt(np.sum(weight * deviation**2) / max(float(determined.sum()), 1e-3))
    return float(np.clip(np.clip(fresh, sigma / 4, 4 * sigma), floor, most))


def same_spreads(before: Model, after: Model) -> bool:
    """Return whether the spreads of gain and phase have hardly changed."""
    pairs = [(before.gain_sigma, after.gain_sigma), (before.phase_sigma, after.phase_sigma)]
    for column, least in enumerate(ASSUMED.prior_filter):
        old, new = ((one.delay_sigma, one.corner_sigma)[column] for one in (before, after))
        pairs.append((max(old, least), max(new, least)))
    return all(abs(np.log(new / old)) < ASSUMED.same_spread for old, new in pairs)


def same_arrivals(before: Model, after: Model) -> bool:
    """Return whether the sigmas of the arrivals have hardly changed."""
    if before.arrival_sigma is None or after.arrival_sigma is None:
        return before.arrival_sigma is after.arrival_sigma
    return bool(np.all(np.abs(np.log(after.arrival_sigma / before.arrival_sigma)) < ASSUMED.same_spread))


def score(problem: Problem, state: State, goal: Objective, trial: ChannelStep) -> float:
    """Return -log evidence at the end of a restart, by Laplace's approximation, up to a constant.

    goal : what the last step minimised; the cost of the state and the normalisation of the priors are both its
    """
    N, D = state.positions.shape
    priors, cost = goal.priors, state.cost
    cost += hyper_cost(goal.field, corrected(problem, state, used_modes(problem, state)))
    cost += 0.5 * np.linalg.slogdet(np.asarray(trial.matrix))[1]
    if priors.known_sigma > 0:
        cost += len(problem.known) * D * np.log(priors.known_sigma)
    if trial.unknowns.gains:
        cost += N * (np.log(priors.gain_sigma) + np.log(priors.phase_sigma))
        if priors.delay_sigma > 0:
            cost += N * (np.log(priors.delay_sigma) + np.log(priors.corner_sigma))
        else:
            cost += np.sum((state.model.filters != 0) * np.log([OUTLIERS.delay_sigma, OUTLIERS.corner_sigma]))
    if goal.arrivals is not None:
        cost += direct_sound.hyper_cost(goal.arrivals)
    if speed_is_free(problem, state):
        cost += np.log(state.settings.sound_speed_sigma or 1.0)
    return float(cost)


def healthy(model: Model) -> np.ndarray:
    """Return which channels are not suspicious : (N,) bool."""
    return model.channel_noise < OUTLIERS.suspicious


def with_silent_inside(problem: Problem, state: State) -> State:
    """Return `state` with channels that are all noise in the middle of the others.

    Nothing shows where these stand. Far outside they would only ask for more directions of the field.
    """
    silent = state.model.share * state.model.channel_noise > 1
    silent[problem.known] = False
    if not np.any(silent):
        return state
    x = np.array(state.positions)
    x[silent] = x[healthy(state.model)].mean(axis=0)
    return replace(state, positions=frozen_array(x, float), shape=frozen_array(x, float))


def isotropic_kernel(problem: Problem, state: State) -> KernelName:
    """Return the kernel of an isotropic field that the noise left calls for."""
    k = problem.wavenumbers[state.modes]
    radius = float(np.sqrt(np.mean(np.sum((state.positions - state.positions.mean(axis=0)) ** 2, axis=1))))
    return "series" if (np.abs(np.imag(k)).max() * radius) ** 2 > ASSUMED.damped * state.model.share else "diffuse"


def last_kernel(problem: Problem, state: State) -> KernelName:
    """Return the kernel of the last stage: directional, but for plane arrays in space and where that takes too long."""
    k = wavenumbers(problem, state)[used_modes(problem, state)]
    products = len(k) * len(state.positions) ** 2 * directions_needed(state.positions, k, problem.dimension)
    slow = problem.dimension == 3 and (state.quick or products > ASSUMED.max_products)
    if slow or given_carry_scale(problem):
        return state.model.kernel
    return "damped_directional" if isotropic_kernel(problem, state) == "series" else "directional"


def with_directions(problem: Problem, state: State, used, updates: int) -> State:
    """Return `state` with the power of the field by direction learned a little further, where its kernel has one."""
    model = state.model
    if model.kernel not in DIRECTIONAL:
        return state
    if model.directions is None:
        k = field_wavenumbers(problem, state)
        Q = directions_needed(state.positions, k, problem.dimension)
        model = replace(model, directions=np.ones((len(k), Q)))
    learned, seen = np.array(model.directions), corrected(problem, state, used)
    field, count = field_of(problem, replace(state, model=model), used), ASSUMED.direction_count[problem.dimension]
    learned[used] = learned_powers(state.positions, seen, field, problem.takes[used], updates, count)
    return replace(state, model=replace(model, directions=frozen_array(learned, float)))


def with_conditional(problem: Problem, state: State) -> State:
    """Return `state`, at the beginning of the last stage, with the conditional likelihood if the array permits it.

    It is free of what the likelihood of a random field supposes of the room, and less sharp. Where the pressures hardly
    fix the size and shears of the array without that supposition, as of a small array, the array would run off.
    """
    used, model = used_modes(problem, state), state.model
    without = replace(state, model=replace(model, conditional=""))  # it may be that of a run with other modes
    slow = len(used) * len(state.positions) ** 3 > CONDITIONAL.max_products
    if model.kernel == "near" or model.share > CONDITIONAL.noise_share or slow:
        return without
    kernel = "series" if isotropic_kernel(problem, state) == "series" else "diffuse"
    chosen = replace(state, model=replace(model, conditional=kernel), progress=replace(state.progress, stage=FINAL))
    here, goal = unknowns_of(chosen), objective_of(problem, chosen, used)
    free = free_directions(here, goal.priors.held, None, speed_is_free(problem, chosen))
    try:
        inverse = scaled_inverse(reduced(here, goal.evaluate(here), free, not len(problem.known))[1])
        covariance = position_covariance(inverse, state.positions.shape, goal.priors.held)
        sigma = stretch_sigma(state.positions, [covariance], healthy(state.model))
    except np.linalg.LinAlgError:
        return without
    limit = CONDITIONAL.stretch_sigma if len(problem.known) else CONDITIONAL.blind_stretch_sigma
    return chosen if sigma < limit else without
