"""What each row of the schedule assumes: objective, kernel and noise, estimated again where a stage ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...cost.channel_field import Conditional
from ...cost.channel_likelihood import ChannelField, log_response
from ...model.problem import Problem
from ...model.settings import SolverSettings
from ...model.validation import frozen_array
from .channel_fit import free_basis
from .conditional_rules import CONDITIONAL
from .objective import NU, Objective, Priors, Unknowns
from .settings import ASSUMED, FINAL, RULES, SCHEDULE
from .state import DIRECTIONAL, UNDAMPED, Model, State


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
    return ChannelField(
        field_wavenumbers(problem, state)[used],
        model.power[used],
        model.noise[used],
        model.channel_noise,
        problem.dimension,
        model.kernel == "near",
        None if model.kernel == "diffuse" else state.shape,
        model.directions[used] if model.kernel in DIRECTIONAL and model.directions is not None else None,
        _conditional(problem, state, used),
    )


def _conditional(problem: Problem, state: State, used) -> Conditional | None:
    """The conditional likelihood of the last row, where the array can do without the other."""
    model = state.model
    if not model.conditional or model.kernel == "near" or state.progress.row != FINAL:
        return None
    response = log_response(unknowns(state).channels, np.real(wavenumbers(problem, state)[used]))[0]
    return Conditional(
        CONDITIONAL.power, CONDITIONAL.weight[problem.dimension], model.conditional == "series", response
    )


def wavenumbers(problem: Problem, state: State) -> np.ndarray:
    """Wavenumbers at the sound speed found (M,) complex128, rad/m."""
    return problem.wavenumbers * np.exp(-state.model.log_speed)


def field_wavenumbers(problem: Problem, state: State) -> np.ndarray:
    """Those of the kernel (M,), rad/m: float64 where it leaves out the damping, else complex128."""
    k = wavenumbers(problem, state)
    return np.real(k) if state.model.kernel in UNDAMPED else k.astype(complex)


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


def first_known_sigma(settings: SolverSettings) -> float:
    """Return one sigma of a given coordinate to begin with, and at most, metres."""
    return RULES.known_sigma if settings.known_sigma is None else max(settings.known_sigma, RULES.exact_sigma)


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
