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
from ...model.power import mode_power
from ...model.problem import Problem
from ...model.settings import Search, SolverSettings
from ...model.validation import InputError
from ..interface import AssessmentMethod, Traits
from ..joint.requirements import require_modes
from ..polynomial_deformation import polynomial_deformations
from ..starts import require_gauge
from . import noise
from .objective import (
    corrected,
    first_model,
    in_unit_power,
    objective_of,
    speed_is_free,
    unknowns_of,
    used_modes,
    wavenumbers,
    with_unknowns,
)
from .restarts import begin_restart, begin_stage, next_restart
from .rules import ASSUMED, FREE, STAGES, STEPS
from .schedule import Turn, following
from .state import DIRECTIONAL, Progress, State
from .step import channel_step, free_directions, is_converged

TRAITS = Traits(
    moves_all=True,
    needs_search=False,
    needs_room=False,
    adds_modes=False,
    starts=(),
    draws_order=False,
    takes_positions=True,
    settings=frozenset(
        {"modes", "noise", "known", "gains", "gain_sigma_db", "phase_sigma_deg", "known_sigma", "sound_speed_sigma"}
    ),
    assessment=AssessmentMethod.CHANNELS,
    uses_likelihood=True,
)


def init(problem: Problem, settings: SolverSettings, seed: int, positions: np.ndarray | None = None) -> State:
    """Return the first state, at the first start of `fdcal.solvers.starts.plan` or at `positions` (N, D), metres.

    The solver draws nothing. Raises InputError for too few modes, modes that show too few directions, or known
    microphones that do not span the array.
    """
    return begin(State, problem, settings, seed, positions)


def begin(
    Kind: type[State], problem: Problem, settings: SolverSettings, seed: int, positions: np.ndarray | None
) -> State:
    """Return the first state, of the class of a preset."""
    require_modes(problem, settings.modes)
    require_gauge(problem)
    problem, N = in_unit_power(problem), problem.pressures.shape[1]
    here = np.zeros((N, problem.array_dimension)) if positions is None else np.asarray(positions, float)
    empty = Kind(
        positions=here,
        settings=settings,
        seed=seed,
        step=0,
        sweep=0,
        stage=-1,  # `begin_stage` counts the first
        moved=-1,
        first=1,
        last=settings.modes,
        automatic=True,
        cost=0.0,
        finished=False,
        converged=False,
        gains=np.zeros((N, 2)),
        offsets=np.zeros((N, 2)),
        model=first_model(problem, settings),
        progress=Progress(restart=0, stage=0, rounds=0, steps=0, damping=0.0),
        shape=here,
        optima=(),
    )
    return next_restart(problem, empty, 0) if positions is None else begin_restart(problem, empty, here, 0)


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
    trial = channel_step(here, goal, free, progress.damping, max_step, blind)
    moved = replace(
        with_unknowns(state, trial.unknowns),
        step=state.step + 1,
        sweep=state.sweep + 1,
        cost=trial.cost if np.isfinite(trial.cost) else state.cost,
        progress=replace(progress, steps=progress.steps + 1, damping=trial.damping),
    )
    ended = trial.moved < stage.tolerance or trial.fall < stage.negligible
    if stage.learns and trial.terms is not None:
        moved = noise.with_power(moved, used, goal.field, trial.terms)
        moved = noise.with_directions(problem, moved, used, ASSUMED.direction_updates)
        if here.gains:
            moved = noise.centred(noise.with_spreads(problem, moved, trial))
            ended = ended and noise.same_spreads(state.model, moved.model)
        if moved.model.kernel in DIRECTIONAL:
            ended = ended and progress.steps > 0 and state.cost - moved.cost < ASSUMED.learned
    if not ended and trial.terms is not None and moved.progress.steps < stage.max_steps:
        return moved
    after = following(Turn(problem, stage.name, moved, goal, trial, ended and trial.terms is not None))
    return replace(after, converged=is_converged(problem, after)) if after.finished else after


def use_modes(problem: Problem, state: State, first: int, last: int, automatic: bool) -> State:
    """Return `state` with modes `first` to `last` in use, counted from 1; the solver goes on from its positions.

    Raises InputError for modes that are not there, or too few.
    """
    if not 1 <= first <= last:
        raise InputError(f"modes {first} to {last} are not a range", "use 1 or more, the lower one first", key="modes")
    require_modes(problem, last)
    problem = in_unit_power(problem)
    progress = replace(state.progress, stage=FREE, rounds=0, regrouped=False, poses=())
    changed = replace(state, first=first, last=last, automatic=automatic, optima=(), finished=False, converged=False)
    return begin_stage(noise.with_noise(problem, replace(changed, progress=progress)), FREE)


def landscape(problem: Problem, state: State, n: int, modes: slice, search: Search | None = None) -> np.ndarray:
    """Return the likelihood's cost of microphone `n` over the search lattice, mode by mode, the gains held.

    (modes, ny, nx) float64, dimensionless; in space over the horizontal layer at the microphone's own height. `search`
    is another lattice over the same area. Raises InputError without a search domain.
    """
    if problem.search is None:
        raise InputError("the measurement has no search domain", "give <search> and <radius>", key="search")
    from ...cost.likelihood_maps import likelihood_maps  # compiled code is loaded with the first map

    problem = in_unit_power(problem)
    pressures, k = corrected(problem, state, slice(None)), wavenumbers(problem, state)
    least = DIFFUSE_FLOOR * mode_power(pressures[modes])
    noise_power = np.maximum(state.model.noise[modes], least)
    equal = replace(problem, pressures=pressures, wavenumbers=k)
    return likelihood_maps(equal, state.positions, n, modes, noise_power, search)


def usable_modes(problem: Problem, settings: SolverSettings) -> int:
    """Return the number of modes measured: the likelihood can use all of them."""
    return len(problem.frequencies)
