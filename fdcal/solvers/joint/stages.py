"""How the stages of the joint solver begin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...cost.likelihood import diffuse_field
from ...cost.noise_model import NoiseEstimate
from ...model.gauge import move_to_frame
from ...model.power import mode_power
from ...model.problem import Problem
from ...model.validation import frozen_array
from ..levenberg_marquardt import DAMPING
from ..position_fit import finite_cost
from ..residual_noise import noise_at, relocated
from . import noise_schedule
from .state import State
from .thresholds import PRIOR, STAGES


def in_frame(problem: Problem, positions) -> np.ndarray:
    """Return the positions in the frame of the minimal gauge, if there is one : (N, D) float64, metres, read-only."""
    return frozen_array(positions if problem.frame is None else move_to_frame(positions, problem.frame), float)


def begin(problem: Problem, state: State, residual: NoiseEstimate | None = None) -> State:
    """Return `state` at the beginning of a stage of its phase; `residual` is that at its positions, if computed."""
    positions = in_frame(problem, state.positions)
    damping = DAMPING.first if state.phase.name == "deformation" else STAGES.refinement_damping
    phase = replace(state.phase, origin=positions, steps=0, damping=damping)
    begun = noise_schedule.with_noise(problem, replace(state, positions=positions, phase=phase), residual)
    return replace(begun, cost=finite_cost(begun.positions, *noise_schedule.stage_model(problem, begun)))


def begin_free(problem: Problem, state: State, residual: NoiseEstimate | None = None) -> State:
    """Return `state` at the beginning of phase "free", with the microphones in wrong basins relocated."""
    residual = noise_at(problem, state.positions, state.modes) if residual is None else residual
    return begin(
        problem,
        replace(
            state,
            phase=replace(state.phase, name="free"),
            attempt=replace(state.attempt, rounds=state.attempt.rounds + 1),
            positions=relocated(problem, state.positions, state.modes, residual),
        ),
    )


def begin_angular_prior(problem: Problem, state: State) -> State:
    """Return `state` at the beginning of phase "angular_prior", with the prior estimated at its positions."""
    from ...cost.angular_prior import diffuse_prior, learned_prior

    assumed = state.field
    p, k = problem.pressures[state.modes], problem.wavenumbers[state.modes]
    field = diffuse_field(p, k, assumed.noise_power[state.modes], 2)
    prior = diffuse_prior(state.positions, k)
    iterations = (assumed.prior_updates + 1) * PRIOR.iterations
    prior = learned_prior(state.positions, p, np.real(k), field.power, field.noise, prior, iterations)
    deflation = noise_schedule.noise_deflation(assumed.noise_power / mode_power(problem.pressures), problem)
    begun = replace(
        state,
        phase=replace(state.phase, name="angular_prior", origin=state.positions, steps=0, damping=DAMPING.first),
        field=replace(
            assumed,
            prior=frozen_array(prior, float),
            prior_updates=assumed.prior_updates + 1,
            noise=frozen_array(assumed.noise_power / np.minimum(deflation, PRIOR.deflation), float),
        ),
    )
    return replace(begun, cost=finite_cost(begun.positions, *noise_schedule.stage_model(problem, begun)))
