"""Positions, channel gains and channel noise together: Levenberg-Marquardt on one likelihood, in stages.

    step     one damped Gauss-Newton step of everything that is free, then one round of the fixed point of the field's
             power, the channels' noise and the spreads of the gains
    stage    one of `rules.STAGES`: deformations of the whole array, every microphone, then the gains as well
    restart  the stages from one start (`fdcal.solvers.starts.plan`); the likeliest of several optima is refined

The likelihood: `fdcal.cost.likelihood`. What a stage minimises: `objective`. What follows a stage: `schedule`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...cost.noise import DIFFUSE_FLOOR
from ...model.problem import Problem, mode_power
from ...model.settings import Search, SolverSettings
from ..interface import Traits
from ..requirements import require_modes, require_range, require_search
from ..starts import require_gauge
from . import noise
from .objective import (
    channel_step,
    corrected,
    free_directions,
    in_unit_power,
    is_converged,
    objective_of,
    polynomial_deformations,
    sigmas_moved,
    speed_is_free,
    unknowns_of,
    used_modes,
    wavenumbers,
    with_unknowns,
)
from .result import result
from .schedule import Turn, begin, begin_stage, following
from .state import ASSUMED, DIRECTIONAL, FREE, STAGES, STEPS, State

__all__ = ["TRAITS", "State", "init", "landscape", "result", "step", "usable_modes", "use_modes"]

TRAITS = Traits(
    moves_all=True,
    takes_positions=True,
    settings=frozenset(
        {"modes", "noise", "known", "gains", "gain_sigma_db", "phase_sigma_deg", "known_sigma", "sound_speed_sigma"}
    ),
    uses_likelihood=True,
)


def init(problem: Problem, settings: SolverSettings, seed: int, positions: np.ndarray | None = None) -> State:
    """Return the first state, at the first start of `fdcal.solvers.starts.plan` or at `positions` (N, D), metres.

    The solver draws nothing. Raises InputError for too few modes, modes that show too few directions, or known
    microphones that do not span the array.
    """
    require_solvable(problem, settings)
    return begin(State, problem, settings, seed, positions)


def require_solvable(problem: Problem, settings: SolverSettings) -> None:
    """Raise InputError for too few modes, or known microphones that an array and its mirror image fit equally well."""
    require_modes(problem, settings.modes)
    require_gauge(problem)


def step(problem: Problem, state: State) -> State:
    """Return `state` after one damped step; the same state if it is finished."""
    if state.finished:
        return state
    problem, progress, stage = in_unit_power(problem), state.progress, STAGES[state.progress.stage]
    used = used_modes(problem, state, stage.modes)
    goal, here = objective_of(problem, state, used), unknowns_of(state)
    held = goal.priors.held
    shapes = polynomial_deformations(state.shape, held, stage.degree) if stage.degree else None
    free = free_directions(here, held, shapes, speed_is_free(problem, state))
    max_step = STEPS.max_step * 2 * np.pi / float(np.real(problem.wavenumbers[used]).max())
    # With the near-field kernel the pull of given positions is lost in rounding: nothing holds the array as a whole.
    blind = not len(problem.known) or (state.model.kernel == "near" and not len(held))
    trial = channel_step(here, goal, free, progress.damping, blind, max_step)
    moved = replace(
        with_unknowns(state, trial.unknowns),
        step=state.step + 1,
        sweep=state.sweep + 1,
        cost=trial.cost if np.isfinite(trial.cost) else state.cost,
        progress=replace(progress, steps=progress.steps + 1, damping=trial.damping),
    )
    directional, healthy = state.model.kernel in DIRECTIONAL, noise.healthy(state.model)
    settled = directional and problem.dimension == 3 and sigmas_moved(here, trial, healthy) < STEPS.settled_sigmas
    ended = settled or trial.moved < stage.tolerance or trial.fall < stage.negligible
    if stage.learns and trial.terms is not None:
        moved = noise.with_power(moved, used, goal.field, trial.terms)
        moved = noise.with_directions(problem, moved, used, ASSUMED.direction_updates)
        if here.gains:
            moved = noise.centred(noise.with_spreads(problem, moved, trial))
            ended = ended and noise.same_spreads(state.model, moved.model)
        if moved.model.arrival_sigma is not None:
            moved = noise.with_arrival_sigma(problem, moved, trial)
            ended = ended and noise.same_arrivals(state.model, moved.model)
        if directional:
            ended = ended and progress.steps > 0 and (settled or state.cost - moved.cost < ASSUMED.learned)
    if not ended and trial.terms is not None and moved.progress.steps < stage.max_steps:
        return moved
    after = following(Turn(problem, stage.name, moved, goal, trial, ended and trial.terms is not None))
    return replace(after, converged=is_converged(problem, after)) if after.finished else after


def use_modes(problem: Problem, state: State, first: int, last: int, automatic: bool) -> State:
    """Return `state` with modes `first` to `last` in use, counted from 1; the solver goes on from its positions.

    Raises InputError for modes that are not there, or too few.
    """
    require_range(problem, first, last)
    require_modes(problem, last)
    problem = in_unit_power(problem)
    progress = replace(state.progress, stage=FREE, rounds=0, regrouped=False, poses=())
    changed = replace(state, first=first, last=last, automatic=automatic, optima=(), finished=False, converged=False)
    return begin_stage(problem, noise.with_noise(problem, replace(changed, progress=progress)), FREE)


def landscape(problem: Problem, state: State, n: int, modes: slice, search: Search | None = None) -> np.ndarray:
    """Return the likelihood's cost of microphone `n` over the search lattice, mode by mode, the gains held.

    (modes, ny, nx) float64, dimensionless; in space over the horizontal layer at the microphone's own height. `search`
    is another lattice over the same area. Raises InputError without a search domain.
    """
    require_search(problem, search)
    from ...cost.maps import likelihood_maps  # compiled code is loaded with the first map

    problem = in_unit_power(problem)
    pressures, k = corrected(problem, state, slice(None)), wavenumbers(problem, state)
    least = DIFFUSE_FLOOR * mode_power(pressures[modes])
    noise_power = np.maximum(state.model.noise[modes], least)
    equal = replace(problem, pressures=pressures, wavenumbers=k)
    return likelihood_maps(equal, state.positions, n, modes, noise_power, search)


def usable_modes(problem: Problem, settings: SolverSettings) -> int:
    """Return the number of modes measured: the likelihood can use all of them."""
    return len(problem.frequencies)
