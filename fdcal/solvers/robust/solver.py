"""Positions, channel gains and channel noise together: Levenberg-Marquardt on one likelihood, in stages.

    step     one damped Gauss-Newton step of everything that is free, then one round of the fixed point of the field's
             power, the channels' noise and the spreads of the gains
    stage    one row of `settings.SCHEDULE`: deformations of the whole array, every microphone, then the gains as well
    attempt  the stages from one start (`starts.plan`); the likeliest end of several attempts is refined

The likelihood: `fdcal.cost.channel_likelihood`. What a row assumes: `assumptions`. What follows a row: `stages`. What
follows an attempt: `attempts`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...model.power import mode_power
from ...model.problem import Problem
from ...model.settings import Search, SolverSettings
from ...model.validation import InputError
from ..initial_positions import require_gauge
from ..interface import AssessmentMethod, Traits
from ..joint.requirements import require_modes
from ..polynomial_deformation import polynomial_deformations
from . import assumptions, hyperparameters, kernels
from .attempts import begin_attempt, next_attempt
from .channel_fit import channel_step
from .convergence import is_converged
from .settings import ASSUMED, RULES, SCHEDULE
from .stages import begin_row, end_row
from .state import DIRECTIONAL, Progress, State
from .unit_power import in_unit_power

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
FREE = next(i for i, row in enumerate(SCHEDULE) if not row.degree)  # the first row that moves every microphone


def init(problem: Problem, settings: SolverSettings, seed: int, positions: np.ndarray | None = None) -> State:
    """Return the first state, at the first start of `starts.plan` or at `positions`.

    Parameters
    ----------
    problem : Problem
    settings : SolverSettings
    seed : int, kept; the solver draws nothing
    positions : (N, D) float64, metres, optional

    Raises
    ------
    InputError
        For too few modes, modes that show too few directions, or known microphones that do not span the array.
    """
    require_modes(problem, settings.modes)
    require_gauge(problem)
    problem, N = in_unit_power(problem), problem.pressures.shape[1]
    here = np.zeros((N, problem.array_dimension)) if positions is None else np.asarray(positions, float)
    empty = State(
        positions=here,
        settings=settings,
        seed=seed,
        step=0,
        sweep=0,
        stage=-1,  # `begin_row` counts the first
        moved=-1,
        first=1,
        last=settings.modes,
        automatic=True,
        cost=0.0,
        finished=False,
        converged=False,
        gains=np.zeros((N, 2)),
        offsets=np.zeros((N, 2)),
        model=assumptions.first_model(problem, settings),
        progress=Progress(attempt=0, row=0, rounds=0, steps=0, damping=0.0),
        shape=here,
        ends=(),
    )
    return next_attempt(problem, empty, 0) if positions is None else begin_attempt(problem, empty, here, 0)


def step(problem: Problem, state: State) -> State:
    """Return `state` after one damped step; the same state if it is finished."""
    if state.finished:
        return state
    problem = in_unit_power(problem)
    progress, row = state.progress, SCHEDULE[state.progress.row]
    used = assumptions.used_modes(problem, state, row.modes)
    goal = assumptions.objective(problem, state, used)
    gains = row.gains and assumptions.gains_are_free(state)
    shapes = polynomial_deformations(state.shape, np.zeros(0, int), row.degree) if row.degree else None
    free = assumptions.free_unknowns(problem, state, shapes)
    furthest = RULES.stride * 2 * np.pi / float(np.real(problem.wavenumbers[used]).max())
    here = assumptions.unknowns(state)
    held = not len(problem.known) or state.model.kernel == "near"  # the pull of given positions is lost in rounding
    trial = channel_step(here, goal, free, progress.damping, furthest, held)
    moved = replace(
        assumptions.with_unknowns(state, trial.unknowns),
        step=state.step + 1,
        sweep=state.sweep + 1,
        cost=trial.cost if np.isfinite(trial.cost) else state.cost,
        progress=replace(progress, steps=progress.steps + 1, damping=trial.damping),
    )
    settled = trial.moved < row.settled or trial.fall < row.negligible
    if row.learns and trial.terms is not None and trial.matrix is not None:
        moved = hyperparameters.with_power(moved, used, goal.field, trial.terms)
        moved = kernels.with_directions(problem, moved, used, ASSUMED.direction_updates)
        if gains:
            moved = hyperparameters.centred(hyperparameters.with_spreads(problem, moved, trial.free, trial.matrix))
            settled = settled and hyperparameters.same_spreads(state.model, moved.model)
        if moved.model.kernel in DIRECTIONAL:
            settled = settled and progress.steps > 0 and state.cost - moved.cost < ASSUMED.learned
    if settled or trial.terms is None or moved.progress.steps >= row.steps:
        after = end_row(problem, moved, goal, trial, settled)
        return replace(after, converged=is_converged(problem, after)) if after.finished else after
    return moved


def use_modes(problem: Problem, state: State, first: int, last: int, automatic: bool) -> State:
    """Return `state` with modes `first` to `last` in use, counted from 1; the solver goes on from its positions.

    Raises
    ------
    InputError
        For modes that are not there, or too few.
    """
    if not 1 <= first <= last:
        raise InputError(f"modes {first} to {last} are not a range", "use 1 or more, the lower one first", key="modes")
    require_modes(problem, last)
    problem = in_unit_power(problem)
    changed = replace(state, first=first, last=last, automatic=automatic, ends=(), finished=False, converged=False)
    changed = replace(changed, progress=replace(state.progress, row=FREE, rounds=0, regrouped=False, poses=()))
    return begin_row(problem, hyperparameters.with_noise(problem, changed), FREE)


def landscape(problem: Problem, state: State, n: int, modes: slice, search: Search | None = None) -> np.ndarray:
    """Return the likelihood's cost of microphone `n` over the search lattice, mode by mode, the gains held.

    Parameters
    ----------
    problem : Problem
    state : State
    n : int, microphone
    modes : slice
    search : Search, optional
        Another lattice over the same area.

    Returns
    -------
    (modes, ny, nx) float64, dimensionless; in space over the horizontal layer at the microphone's own height

    Raises
    ------
    InputError
        Without a search domain.
    """
    if problem.search is None:
        raise InputError("the measurement has no search domain", "give <search> and <radius>", key="search")
    from ...cost.maps import likelihood_maps  # compiled code is loaded with the first map
    from ...cost.noise_model import NOISE

    problem = in_unit_power(problem)
    corrected = replace(
        problem,
        pressures=assumptions.corrected(problem, state, slice(None)),
        wavenumbers=assumptions.wavenumbers(problem, state),
    )
    least = NOISE.diffuse_floor * mode_power(corrected.pressures[modes])
    return likelihood_maps(corrected, state.positions, n, modes, np.maximum(state.model.noise[modes], least), search)


def usable_modes(problem: Problem, settings: SolverSettings) -> int:
    """Return the number of modes measured: the likelihood can use all of them."""
    return len(problem.frequencies)
