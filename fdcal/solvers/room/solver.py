"""Microphones in a rectangular room of known size: absolute positions, up to the symmetries of the room.

    step   one step of what follows
    sweep  the same: every microphone has moved once
    stage  an end of one of the phases

    search     the likeliest arrays on a lattice (`array_search`), from the lowest modes: one step
    diffuse    all microphones move together, all modes in use, by the diffuse model, which needs no source; the error
               of the lattice counts as noise, less of it from stage to stage
    source     the likeliest places of the source on a lattice (`source_search`): one step
    rough      microphones, source and the admittance of the walls together by the exact model
               (`fdcal.acoustics.room_modes`), part of the power counted as noise
    relocated  if much is left unexplained: the same, after each microphone is placed where the source found says
    exact      the same, with the noise of the measurement

If too much is left unexplained, other places of the source are tried, and other arrays (`multistart`). Known
microphones only select one of the symmetries of the room; without them the array is put into the corner at the origin.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...acoustics.room_modes import diffuse_model
from ...model.problem import Problem
from ...model.settings import Search, SolverSettings
from ...model.validation import InputError, frozen_array
from ..interface import AssessmentMethod, Traits
from ..levenberg_marquardt import DAMPING
from . import array_search
from .phases import STEPS
from .requirements import require_enough, require_room
from .state import Attempts, Phase, State, noise_of, scaled
from .thresholds import NOISE

TRAITS = Traits(
    moves_all=True,
    needs_search=False,
    needs_room=True,
    adds_modes=False,
    starts=(),
    draws_order=False,
    takes_positions=True,
    settings=None,
    assessment=AssessmentMethod.KNOWN_ROOM,
    uses_likelihood=False,
)


def init(problem: Problem, settings: SolverSettings, seed: int, positions: np.ndarray | None = None) -> State:
    """Return the first state: the microphones in the middle of the room, and phase "search" next.

    Parameters
    ----------
    problem : Problem
    settings : SolverSettings, with the size of the room
    seed : int, not used
    positions : (N, D) float64, metres, optional
        Start with phase "diffuse" at these positions.

    Raises
    ------
    InputError
        For a room that is impossible or does not fit the measurement, and for too few modes.
    """
    size = require_room(problem, settings)
    N, D = problem.pressures.shape[1], len(size)
    return State(
        positions=frozen_array(np.tile(np.asarray(size) / 2, (N, 1)) if positions is None else positions, float),
        settings=settings,
        seed=seed,
        step=0,
        sweep=0,
        stage=0,
        moved=-1,
        first=1,
        last=settings.modes,
        automatic=True,
        cost=0.0,
        finished=False,
        converged=False,
        phase=Phase("search" if positions is None else "diffuse", 0, 0, DAMPING.first),
        attempts=Attempts((), (), None, None),
        noise=noise_of(problem, settings),
        walls=frozen_array(np.zeros(D + 2), float),
        width=array_search.RULES.widths[0],
    )


def step(problem: Problem, state: State) -> State:
    """Return `state` after one step; the same state if it is finished."""
    if state.finished:
        return state
    p, noise, k = scaled(problem, state, state.modes)
    phase = replace(state.phase, steps=state.phase.steps + 1)
    taken = replace(state, step=state.step + 1, sweep=state.sweep + 1, phase=phase)
    return STEPS[phase.name](problem, taken, p, noise, k)


def use_modes(problem: Problem, state: State, first: int, last: int, automatic: bool) -> State:
    """Return `state` with modes `first` to `last` in use, counted from 1; the solver continues from its positions.

    Raises
    ------
    InputError
        For modes that are not there, or too few.
    """
    if not 1 <= first <= last <= len(problem.frequencies):
        raise InputError(
            f"modes {first} to {last} are not a range of 1 to {len(problem.frequencies)}",
            "use modes that were measured, the lower one first",
            key="modes",
        )
    N, D = state.positions.shape
    require_enough(N, D, last - first + 1)
    return replace(
        state,
        first=first,
        last=last,
        automatic=automatic,
        phase=Phase("search" if state.phase.name == "search" else "diffuse", 0, 0, DAMPING.first),
        attempts=Attempts((), (), None, None),
        noise=noise_of(problem, state.settings),  # a finished state has its own estimate
        finished=False,
        converged=False,
    )


def landscape(problem: Problem, state: State, n: int, modes: slice, search: Search | None = None) -> np.ndarray:
    """Return the cost of microphone `n` over the search lattice, the others held, mode by mode.

    Parameters
    ----------
    problem : Problem
    state : State
    n : int, microphone
    modes : slice
    search : Search, optional
        Another lattice; that of the problem unless given.

    Returns
    -------
    (modes, ny, nx) float64, dimensionless, not negative

    Raises
    ------
    InputError
        Without a search domain.
    """
    search = problem.search if search is None else search
    if search is None:
        raise InputError("the measurement has no search domain", "give <search> and <radius>", key="search")
    points = search.layer(*state.positions[n, 2:])
    p, noise, k = scaled(problem, state, modes)
    model = diffuse_model(state.size, k, state.width)
    lattice = array_search.LatticePoints(points.reshape(-1, points.shape[-1]), p, noise + NOISE.rough, model)
    costs = lattice.costs(state.positions, n)
    costs -= np.minimum(costs.min(axis=1, keepdims=True), 0.0)
    return costs.reshape(len(p), *points.shape[:2])


def usable_modes(problem: Problem, settings: SolverSettings) -> int:
    """Return the number of modes measured."""
    return len(problem.frequencies)
