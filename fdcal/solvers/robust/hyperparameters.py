"""What is estimated beside positions and gains: noise, power, spreads of the priors, and the evidence of an attempt.

What a row of the schedule assumes with them: `assumptions`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...cost.channel_likelihood import ChannelField, Terms
from ...model.problem import Problem
from . import assumptions, noise_model
from .objective import Objective
from .settings import ASSUMED, FILTERS, FINAL, NOISE_RULES, RULES
from .state import Model, State

LEAST_SHARE = {  # of noise in the power
    "diffuse": 1e-6,
    "series": 1e-8,
    "directional": 1e-8,
    "damped_directional": 1e-8,
    "near": 1e-10,
}


def with_power(state: State, used, chosen: ChannelField, terms: Terms) -> State:
    """`state` with power and channel noise after one round of their fixed point."""
    power = np.array(state.model.power)
    power[used] = noise_model.updated_power(chosen, terms)
    tau = noise_model.updated_channel_noise(chosen, terms)
    return replace(state, model=replace(state.model, power=power, channel_noise=tau))


def with_noise(problem: Problem, state: State, deflation: float = 1.0, rough: bool = True) -> State:
    """`state` with the noise and the spread of the positions that explain best what is left.

    rough : whether the spread adds to the noise; where every microphone has found its place, all is noise
    """
    used = assumptions.used_modes(problem, state, ASSUMED.noise_modes)
    model = state.model
    least = least_share(state)
    share, spread, alone = noise_model.estimate_noise(
        state.positions, assumptions.corrected(problem, state, used), assumptions.field(problem, state, used), least
    )
    k = np.real(problem.wavenumbers)
    share = share if rough else alone
    noise = np.full(len(k), max(share, least))
    given = given_noise(problem, state)
    level = 0.0 if given is None else float(np.median(given))
    if given is not None and level / ASSUMED.believed < share < level * ASSUMED.believed:
        noise = np.maximum(given, least)
    noise = np.maximum(noise / deflation, least)
    noise = np.minimum(noise + rough * (k * spread) ** 2 / problem.dimension, NOISE_RULES.most_share)
    return replace(state, model=replace(model, noise=noise, share=share, spread=spread, deflation=deflation))


def misfit(problem: Problem, state: State) -> float:
    """Return -log likelihood of the pressures with the noise found and each mode's likeliest power of the field."""
    used = assumptions.used_modes(problem, state, ASSUMED.noise_modes)
    seen = assumptions.corrected(problem, state, used)
    return noise_model.profile_cost(state.positions, seen, assumptions.field(problem, state, used), state.model.share)


def least_share(state: State) -> float:
    """Least share of noise in the power that the kernel can show."""
    return LEAST_SHARE[state.model.kernel]


def is_noiseless(problem: Problem, state: State) -> bool:
    """Whether the measurement is reported to have no noise to speak of, as a simulated one."""
    given = given_noise(problem, state)
    return given is not None and float(np.median(given[state.modes])) <= RULES.low_noise


def given_noise(problem: Problem, state: State) -> np.ndarray | None:
    """Noise power of the measurement (M,), None where it is not given or not to be used."""
    if state.settings.snr_db is not None:
        return np.full(len(problem.pressures), 1 / (1 + 10 ** (state.settings.snr_db / 10)))
    return problem.noise_power if state.settings.noise == "reported" else None


def with_spreads(problem: Problem, state: State, free, matrix) -> State:
    """`state` with the spread of gains and given positions by empirical Bayes; `matrix` (F, F) of the last step."""
    N, D = state.positions.shape
    variance = np.zeros(assumptions.unknowns(state).vector.size)
    variance[free] = np.diag(np.linalg.inv(matrix + 1e-12 * np.diag(np.diag(matrix))))
    variance = variance[:-1].reshape(N, -1)
    model, sigmas = state.model, []
    last = state.progress.row == FINAL
    floor = NOISE_RULES.least_sigma if last else ASSUMED.negligible_spread  # the last row can lower it, hardly raise it
    stated = state.settings.gain_sigma_db is not None, state.settings.phase_sigma_deg is not None
    for column, sigma in enumerate((model.gain_sigma, model.phase_sigma)):
        e = np.append(
            state.gains[:, column] - state.offsets[:, column], ASSUMED.prior_gain * np.sqrt(ASSUMED.prior_count)
        )
        fresh = noise_model.updated_sigma(sigma, e, np.append(variance[:, D + column], 0.0), floor=floor)
        sigmas.append(sigma if stated[column] else fresh)
    (known, places), sigma = assumptions.held(problem, state), model.known_sigma
    if len(known) and not assumptions.given_carry_scale(problem):
        e = np.linalg.norm(state.positions[known] - places, axis=1)
        e = np.append(e, ASSUMED.given_sigma * np.sqrt(D) * np.ones(int(ASSUMED.known_count)))
        v = np.append(variance[known, :D].mean(axis=1), np.zeros(int(ASSUMED.known_count)))
        # It is greater by a hypothesis on the given positions alone.
        most = max(assumptions.first_known_sigma(state.settings), sigma)
        sigma = min(noise_model.updated_sigma(sigma, e, v, D, 1e-5), most)
    model = replace(model, gain_sigma=sigmas[0], phase_sigma=sigmas[1], known_sigma=sigma)
    return replace(state, model=model)


def same_spreads(before: Model, after: Model) -> bool:
    """Whether the spreads of gain and phase have hardly changed."""
    pairs = (before.gain_sigma, after.gain_sigma), (before.phase_sigma, after.phase_sigma)
    return all(
        abs(np.log(new / old)) < ASSUMED.same_spread or max(old, new) < ASSUMED.negligible_spread for old, new in pairs
    )


def score(problem: Problem, state: State, goal: Objective, trial) -> float:
    """Return -log evidence of the end of an attempt, by Laplace's approximation, up to a constant.

    goal : what the last step minimised; the cost of the state and the normalisation of the priors are both its
    """
    used = assumptions.used_modes(problem, state, 0)
    N, D = state.positions.shape
    priors = goal.priors
    cost = state.cost + noise_model.hyper_cost(goal.field, assumptions.corrected(problem, state, used))
    cost += 0.5 * np.linalg.slogdet(trial.matrix)[1] + len(problem.known) * D * np.log(max(priors.known_sigma, 1e-6))
    if priors.gain_sigma > 0:
        cost += N * (np.log(priors.gain_sigma) + np.log(priors.phase_sigma))
        cost += np.sum((state.model.filters != 0) * np.log([FILTERS.delay_sigma, FILTERS.corner_sigma]))
    if assumptions.speed_is_free(problem, state):
        cost += np.log(state.settings.sound_speed_sigma or 1.0)
    return float(cost)


def centred(state: State) -> State:
    """`state` with gains whose median is 1: what is common to all is the field's."""
    shift = np.median(state.gains - state.offsets, axis=0)
    power = state.model.power * np.exp(2 * shift[0])
    noise = state.model.noise * np.exp(2 * shift[0])
    return replace(state, gains=state.gains - shift, model=replace(state.model, power=power, noise=noise))
