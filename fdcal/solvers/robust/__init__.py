"""Positions, channel gains and channel noise together: Levenberg-Marquardt on one likelihood, in stages.

    step     one damped Gauss-Newton step of all free unknowns, then one iteration of the fixed point for the power of
             the field, the noise of the channels and the spreads of the gains
    stage    one of `state.STAGES`: the positions, then also the gains, then also the directions of the field
    restart  the stages from one of the starts that `search` finds; the likeliest optimum is then refined

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
    """Return the first state, at `positions` (N, D), metres, or at the likeliest start."""
    require_solvable(problem, settings)
    return begin(State, problem, settings, seed, positions)


def require_solvable(problem: Problem, settings: SolverSettings) -> None:
    """Raise InputError for too few modes, or known microphones that an array and its mirror image fit equally well."""
    require_modes(problem, settings.modes)
    require_gauge(problem)


# A stage that learns the directions of a field in space ends when the RMS move in one step, in sigmas of the
# coordinates, falls below this: the directions still change long after the positions have settled. Four takes of 32
# microphones end 0.1 to 0.5 mm from where many more steps would lead, with an error of 3 to 4 mm. The rule does not
# apply to fields in the plane, where learning directions takes little time: with it the error of an array whose size is
# hardly determined would grow from 14 to 17 mm.
TOLERANCE_SIGMAS = 0.05
# A stage that learns directions continues while the cost decreases by more than this, nats. Without this condition the
# error of an array in the plane whose size is hardly determined grows from 14 to 17 mm.
LEARNED_NATS = 0.5


def step(problem: Problem, state: State) -> State:
    """Return `state` after one damped step, or one start in the search; the same state if it is finished."""
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
    """Return `state` with modes `first` to `last` in use, counted from 1; the solver goes on from its positions.

    InputError if these modes were not measured, or are too few for the unknown coordinates.
    """
    require_range(problem, first, last)
    require_modes(problem, last)
    problem = objectives.in_unit_power(problem)
    progress = replace(state.progress, stage=FREE, rounds=0)
    changed = replace(state, first=first, last=last, automatic=automatic, optima=(), finished=False, converged=False)
    return begin_stage(problem, noise.with_noise(problem, replace(changed, progress=progress)), FREE)


def landscape(problem: Problem, state: State, n: int, modes: slice, search: Search | None = None) -> np.ndarray:
    """Return the likelihood's cost of microphone `n` over the search lattice, mode by mode, at the present gains.

    It is (modes, ny, nx) float64, dimensionless; in space the lattice is the horizontal layer at the height of the
    microphone. Where short windows count, each mode holds an equal part of their term, so that the sum over the modes
    in use is what the last stage minimises.
    """
    from ...cost.maps import likelihood_maps  # compiled code is loaded with the first map

    problem = objectives.in_unit_power(problem)
    pressures, k = objectives.corrected(problem, state, slice(None)), objectives.wavenumbers(problem, state)
    least = DIFFUSE_FLOOR * mode_power(pressures[modes])
    noise_power = np.maximum(state.model.noise[modes], least)
    equal = replace(problem, pressures=pressures, wavenumbers=k)
    maps = likelihood_maps(equal, state.positions, n, modes, noise_power, search)
    term = objectives.window_term_of(state.model)
    if term is None:
        return maps
    domain = search_domain(problem) if search is None else search
    beside = term.costs(state.positions, n, domain.layer()[..., :2]) / len(problem.pressures[state.modes])
    return maps / state.model.tempering + beside


def usable_modes(problem: Problem, settings: SolverSettings) -> int:
    """Return the number of modes measured: the likelihood can use all of them."""
    return len(problem.frequencies)
