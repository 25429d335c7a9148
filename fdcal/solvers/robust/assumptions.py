"""What each row of the schedule assumes: objective, kernel and noise, estimated again where a stage ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...cost.channel_field import Conditional
from ...cost.channel_likelihood import ChannelField, Terms, log_response
from ...model.problem import Problem
from ...model.settings import SolverSettings
from ...model.validation import frozen_array
from . import noise_model
from .channel_fit import free_basis
from .objective import NU, Objective, Priors, Unknowns
from .settings import ASSUMED, CONDITIONAL, FILTERS, FINAL, NOISE_RULES, RULES, SCHEDULE
from .state import Model, State

LEAST_SHARE = {"diffuse": 1e-6, "series": 1e-8, "directional": 1e-8, "near": 1e-10}  # of noise in the power


def spaced(count: int, most: int) -> np.ndarray:
    """At most `most` numbers below `count`, evenly taken : int64."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


def used_modes(problem: Problem, state: State, most: int) -> np.ndarray:
    """At most so many of the modes that the row of the schedule works with : int64; 0 for all."""
    count, row = len(problem.pressures[state.modes]), SCHEDULE[state.progress.row]
    if row.lowest and len(problem.known):
        count = min(count, row.modes)
    return state.first - 1 + (spaced(count, most) if most else np.arange(count))


def field(problem: Problem, state: State, used) -> ChannelField:
    """What is assumed of the modes `used`."""
    model = state.model
    k = wavenumbers(problem, state)[used]
    plain = model.kernel == "diffuse"
    return ChannelField(
        np.real(k) if plain else k.astype(complex),
        model.power[used],
        model.noise[used],
        model.channel_noise,
        problem.dimension,
        model.kernel == "near",
        None if plain else state.shape,
        model.directions[used] if model.kernel == "directional" and model.directions is not None else None,
        _conditional(problem, state, used),
    )


def _conditional(problem: Problem, state: State, used) -> Conditional | None:
    """The conditional likelihood of the last row, where the array can do without the other."""
    model = state.model
    if not model.conditional or model.kernel == "near" or state.progress.row != FINAL:
        return None
    response = log_response(unknowns(state).channels, np.real(wavenumbers(problem, state)[used]))[0]
    return Conditional(CONDITIONAL.power, CONDITIONAL.weight, model.conditional == "series", response)


def wavenumbers(problem: Problem, state: State) -> np.ndarray:
    """Wavenumbers at the sound speed found (M,) complex128, rad/m."""
    return problem.wavenumbers * np.exp(-state.model.log_speed)


def gains_are_free(state: State) -> bool:
    """Return whether the gains of the channels are sought."""
    return state.settings.gains != "fixed"


def objective(problem: Problem, state: State, used) -> Objective:
    """What the row minimises."""
    row, model = SCHEDULE[state.progress.row], state.model
    gains = row.gains and gains_are_free(state)
    loose = float(np.hypot(model.known_sigma, model.spread if row.degree else 0.0))
    spread = (model.gain_sigma, model.phase_sigma) if gains else (0.0, 0.0)
    speed = state.settings.sound_speed_sigma if speed_is_free(problem, state) else None
    tail = ASSUMED.carrying_tail if given_carry_scale(problem) else NU
    priors = Priors(*spread, *held(problem, state), loose, state.offsets, speed or 0.0, tail)
    return Objective(problem.pressures[used], field(problem, state, used), priors, model.log_speed)


def given_carry_scale(problem: Problem) -> bool:
    """Whether the pressures hardly show the size of the array, so that given positions must: a plane one in space."""
    return problem.array_dimension < problem.dimension


def held(problem: Problem, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Return the microphones that given positions hold (H,), and these positions (H, D), metres."""
    right = ~state.model.contradicted
    return problem.known[right], state.model.places[right]


def unknowns(state: State) -> Unknowns:
    """What a step moves."""
    filters = state.model.filters
    channels = np.hstack([state.gains, filters]) if np.any(filters) else state.gains
    return Unknowns(state.positions, channels, state.model.log_speed)


def with_unknowns(state: State, moved: Unknowns) -> State:
    """`state` where a step has led to."""
    filters = moved.channels[:, 2:] if moved.channels.shape[1] > 2 else state.model.filters
    model = replace(state.model, filters=frozen_array(filters, float), log_speed=moved.log_speed)
    positions, gains = frozen_array(moved.positions, float), frozen_array(moved.channels[:, :2], float)
    return replace(state, positions=positions, gains=gains, model=model)


def free_unknowns(problem: Problem, state: State, deformations) -> np.ndarray:
    """The unknowns that the row frees, see `channel_fit.free_basis`."""
    gains = SCHEDULE[state.progress.row].gains and gains_are_free(state)
    return free_basis(unknowns(state), deformations, gains, state.model.filters != 0, speed_is_free(problem, state))


def speed_is_free(problem: Problem, state: State) -> bool:
    """Whether the row seeks the sound speed: it is uncertain, and given positions carry the scale."""
    stated, row = state.settings.sound_speed_sigma, SCHEDULE[state.progress.row]
    return stated is not None and not row.degree and len(problem.known) > 1


def corrected(problem: Problem, state: State, used) -> np.ndarray:
    """Pressures divided by the responses of the channels."""
    k = np.real(wavenumbers(problem, state)[used])
    return problem.pressures[used] * np.exp(-log_response(unknowns(state).channels, k)[0])


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
    used = used_modes(problem, state, ASSUMED.noise_modes)
    model = state.model
    least = least_share(state)
    share, spread, alone = noise_model.estimate_noise(
        state.positions, corrected(problem, state, used), field(problem, state, used), least
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
    used = used_modes(problem, state, ASSUMED.noise_modes)
    seen = corrected(problem, state, used)
    return noise_model.profile_cost(state.positions, seen, field(problem, state, used), state.model.share)


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
    variance = np.zeros(unknowns(state).vector.size)
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
    (known, places), sigma = held(problem, state), model.known_sigma
    if len(known) and not given_carry_scale(problem):
        e = np.linalg.norm(state.positions[known] - places, axis=1)
        e = np.append(e, ASSUMED.given_sigma * np.sqrt(D) * np.ones(int(ASSUMED.known_count)))
        v = np.append(variance[known, :D].mean(axis=1), np.zeros(int(ASSUMED.known_count)))
        most = max(first_known_sigma(state.settings), sigma)  # greater by a hypothesis on the given positions alone
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
    used = used_modes(problem, state, 0)
    N, D = state.positions.shape
    priors = goal.priors
    cost = state.cost + noise_model.hyper_cost(goal.field, corrected(problem, state, used))
    cost += 0.5 * np.linalg.slogdet(trial.matrix)[1] + len(problem.known) * D * np.log(max(priors.known_sigma, 1e-6))
    if priors.gain_sigma > 0:
        cost += N * (np.log(priors.gain_sigma) + np.log(priors.phase_sigma))
        cost += np.sum((state.model.filters != 0) * np.log([FILTERS.delay_sigma, FILTERS.corner_sigma]))
    if speed_is_free(problem, state):
        cost += np.log(state.settings.sound_speed_sigma or 1.0)
    return float(cost)


def centred(state: State) -> State:
    """`state` with gains whose median is 1: what is common to all is the field's."""
    shift = np.median(state.gains - state.offsets, axis=0)
    power = state.model.power * np.exp(2 * shift[0])
    noise = state.model.noise * np.exp(2 * shift[0])
    return replace(state, gains=state.gains - shift, model=replace(state.model, power=power, noise=noise))


def first_known_sigma(settings: SolverSettings) -> float:
    """Return one sigma of a given coordinate to begin with, and at most, metres."""
    return RULES.known_sigma if settings.known_sigma is None else settings.known_sigma


def first_model(problem: Problem, settings: SolverSettings) -> Model:
    """Return the model that an attempt begins with."""
    M, N = problem.pressures.shape
    gain, phase = settings.gain_sigma_db, settings.phase_sigma_deg
    carrying = given_carry_scale(problem) and settings.known_sigma is None
    return Model(
        power=np.ones(M),
        noise=0.1 * np.ones(M),
        channel_noise=np.ones(N),
        share=0.1,
        spread=0.0,
        gain_sigma=RULES.gain_sigma if gain is None else gain * np.log(10) / 20,
        phase_sigma=RULES.phase_sigma if phase is None else float(np.radians(phase)),
        known_sigma=ASSUMED.carrying_sigma if carrying else first_known_sigma(settings),
        kernel="diffuse",
        places=frozen_array(problem.known_positions, float),
        contradicted=frozen_array(np.zeros(len(problem.known), bool), bool),
        filters=np.zeros((N, 2)),
    )
