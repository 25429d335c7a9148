"""Solver "robust": positions, channel gains and channel noise by Levenberg-Marquardt on one likelihood, in stages.

    step     one damped Gauss-Newton step of all free unknowns, then one step of the fixed-point iteration for the power
             of the field, the noise of the channels and the standard deviations of the gains
    stage    one of `state.STAGES`: first the positions, then also the gains, then also the directions of the field
    restart  a run through the stages from one of the starts that `search` finds; the best optimum is then refined

`fdcal.cost.likelihood` computes the likelihood, `objective` adds priors and takes steps, and `schedule` decides what
follows a stage.
"""

from dataclasses import replace

import numpy as np

from ...cost.eq7 import search_domain
from ...cost.noise import DIFFUSE_FLOOR
from ...model.problem import Problem, mode_power
from ...model.settings import Search, SolverSettings
from ..interface import Traits
from ..requirements import require_modes, require_range
from ..starts import require_gauge
from . import noise, search
from . import objective as objectives
from .result import result
from .schedule import StageEnd, after_stage, begin, next_restart
from .stages import begin_stage, moved_once
from .state import FREE, SEARCH, STAGES, State

__all__ = ["TRAITS", "State", "init", "landscape", "result", "step", "usable_modes", "use_modes"]

TRAITS = Traits(
    moves_all=True,
    settings=frozenset(
        {"modes", "noise", "known", "gains", "gain_sigma_db", "phase_sigma_deg", "known_sigma", "sound_speed_sigma"}
    ),
)


def init(problem: Problem, settings: SolverSettings, seed: int, positions: np.ndarray | None = None) -> State:
    """Return the first state, at `positions` (N, D), metres, or at the first start of the search.

    Raises InputError for too few modes or microphones, or known positions that do not fix the gauge.
    """
    require_solvable(problem, settings)
    return begin(State, problem, settings, seed, positions)


def require_solvable(problem: Problem, settings: SolverSettings) -> None:
    """Raise InputError for too few modes, or known microphones that an array and its mirror image fit equally well."""
    require_modes(problem, settings.modes)
    require_gauge(problem)


# A stage that learns the directions of a field in space ends when the RMS move in one step falls below this number of
# standard deviations of the coordinates, because the directions still change long after the positions have converged.
# For an array of 32 microphones with four takes, whose error is 3 to 4 mm, this changes the positions by 0.1 to 0.5 mm
# compared with many more steps. The rule does not apply to fields in the plane, where learning directions takes little
# time: there the error of an array whose size is hardly determined would grow from 14 to 17 mm.
TOLERANCE_SIGMAS = 0.05
# A stage that learns directions continues while a step lowers the cost by more than this, nats. Without this condition
# the error of an array in the plane whose size is hardly determined grows from 14 to 17 mm.
LEARNED_NATS = 0.5


def step(problem: Problem, state: State) -> State:
    """Return `state` after one damped step or, in the search, after one start; the same state if it is finished."""
    if state.finished:
        return state
    problem, progress, stage = objectives.in_unit_power(problem), state.progress, STAGES[state.progress.stage]
    if progress.stage == SEARCH:
        searched = search.step(problem, replace(state, step=state.step + 1, sweep=state.sweep + 1))
        if not search.is_complete(problem, searched):
            return searched
        return next_restart(problem, replace(searched, starts=search.likely(problem, searched)))
    here, used = objectives.unknowns_of(state), objectives.used_modes(problem, state)
    moved, objective, trial = moved_once(problem, state, used)
    directional, healthy = state.model.directional, noise.healthy(state.model)
    learning_in_space = directional and problem.dimension == 3
    within_sigmas = learning_in_space and objectives.sigmas_moved(here, trial, healthy) < TOLERANCE_SIGMAS
    ended = within_sigmas or trial.moved < stage.tolerance or trial.decrease < stage.negligible
    if trial.terms is not None:
        ended = ended and noise.same_sigmas(state.model, moved.model)
        if directional:
            ended = ended and progress.steps > 0 and (within_sigmas or state.cost - moved.cost < LEARNED_NATS)
    if not ended and trial.terms is not None and moved.progress.steps < stage.max_steps:
        return moved
    after = after_stage(StageEnd(problem, moved, objective, trial, ended and trial.terms is not None))
    return replace(after, converged=objectives.is_converged(problem, after)) if after.finished else after


def use_modes(problem: Problem, state: State, first: int, last: int, automatic: bool) -> State:
    """Return `state` with modes `first` to `last` in use, counted from 1; the solver continues from its positions.

    Raises InputError if these modes were not measured, or are too few for the unknown coordinates.
    """
    require_range(problem, first, last)
    require_modes(problem, last - first + 1)
    problem = objectives.in_unit_power(problem)
    progress = replace(state.progress, stage=FREE, rounds=0)
    changed = replace(state, first=first, last=last, automatic=automatic, optima=(), finished=False, converged=False)
    return begin_stage(problem, noise.with_noise(problem, replace(changed, progress=progress)), FREE)


def landscape(problem: Problem, state: State, n: int, modes: slice, search: Search | None = None) -> np.ndarray:
    """Return the cost of each mode with microphone `n` moved over the lattice, at the present gains.

    The cost is the negative log-likelihood, (modes, ny, nx) float64, dimensionless. In space the lattice is the
    horizontal layer at the height of the microphone. If short windows are used, the map of each mode contains an equal
    part of their term. The sum of the maps of the modes in use approximates what the last stage minimises: its field is
    isotropic and undamped, all channels have equal noise, and priors and arrivals are left out.
    """
    from ...cost.maps import likelihood_maps  # imported here, because only maps need it

    problem = objectives.in_unit_power(problem)
    pressures, k = objectives.corrected(problem, state, slice(None)), objectives.wavenumbers(problem, state)
    noise_power = np.maximum(state.model.noise[modes], DIFFUSE_FLOOR * mode_power(pressures[modes]))
    equal = replace(problem, pressures=pressures, wavenumbers=k)
    maps = likelihood_maps(equal, state.positions, n, modes, noise_power, search)
    term = objectives.window_term_of(state.model)
    if term is None:
        return maps
    domain = search_domain(problem) if search is None else search
    of_windows = term.costs(state.positions, n, domain.layer()[..., :2])
    return maps / state.model.tempering + of_windows / len(problem.pressures[state.modes])


def usable_modes(problem: Problem, settings: SolverSettings) -> int:
    """Return the number of measured modes, because the likelihood can use all of them."""
    return len(problem.frequencies)
