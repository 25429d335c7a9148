"""Block coordinate descent, section 3 of the paper: one microphone at a time over all candidates.

    step   one free microphone is moved to the candidate of least cost, the basis recentred
    sweep  all free microphones are moved once
    stage  sweeps with one set of modes, until no microphone moves; then the next mode is added

The centre of the expansion is the centre of mass rounded to the search lattice, so that one table of radial functions
serves every step (`fdcal.acoustics.lattice_dictionary.LatticeDictionary`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...cost import mode_limits
from ...cost.eq7 import known_weights, leave_one_out_fits
from ...cost.mode_limits import require_modes, search_lattice
from ...model.gauge import fixes_gauge
from ...model.problem import Problem
from ...model.settings import Search, SolverSettings
from ...model.validation import InputError, frozen_array
from .. import initial_positions
from ..interface import AssessmentMethod, Traits
from .state import State

TRAITS = Traits(
    moves_all=False,
    needs_search=True,
    needs_room=False,
    adds_modes=True,
    starts=("random", "affine"),
    draws_order=True,
    takes_positions=False,
    settings=frozenset(
        {"modes", "first_modes", "order_offset", "ample_modes", "known_weight", "max_sweeps", "start", "known"}
    ),
    assessment=AssessmentMethod.LIKELIHOOD,
    uses_likelihood=False,
)


def init(problem: Problem, settings: SolverSettings, seed: int) -> State:
    """Return the first state: free microphones on the search lattice, known ones in their places.

    Parameters
    ----------
    problem : Problem
    settings : SolverSettings; `start` is "random" or "affine"
    seed : int, of the random start and of the order in which the microphones are moved

    Raises
    ------
    InputError
        Without a search domain or known microphones that fix the gauge, for modes that the microphones cannot resolve,
        or if there is no affine start.
    """
    _require_solvable(problem, settings)
    require_modes(problem, settings.order_offset, settings.modes)
    lattice = search_lattice(problem, settings.order_offset)
    if settings.start == "affine":
        positions = lattice.nearest(initial_positions.affine(problem, settings.modes))
    else:
        rng = np.random.default_rng([seed, 0])
        positions = lattice.points[rng.choice(len(lattice.points), problem.pressures.shape[1], replace=False)]
    positions[problem.known] = problem.known_positions
    state = State(
        positions=frozen_array(positions, float),
        centre=frozen_array(lattice.nearest(positions.mean(axis=0)), float),
        settings=settings,
        seed=seed,
        step=0,
        sweep=0,
        stage=0,
        turn=0,
        moved=-1,
        first=1,
        last=settings.first_modes,
        automatic=True,
        stage_sweeps=0,
        changed=False,
        cost=0.0,
        finished=False,
        converged=False,
    )
    return replace(state, cost=_cost(problem, state))


def step(problem: Problem, state: State) -> State:
    """Return `state` with the next microphone moved to its best candidate; the same state if it is finished."""
    if state.finished:
        return state
    from ...cost.lattice_search import best_candidate  # compiled code is loaded with the first step

    n = int(_turns(problem, state)[state.turn])
    lattice, _, fits = _fits(problem, state, n)
    here = lattice.index(state.positions[n])
    best, least = best_candidate(lattice, state.centre, state.modes, fits, here)
    positions = state.positions.copy()
    positions[n] = lattice.points[best]
    moved = replace(
        state,
        positions=frozen_array(positions, float),
        centre=frozen_array(lattice.nearest(positions.mean(axis=0)), float),
        step=state.step + 1,
        turn=state.turn + 1,
        moved=n,
        changed=state.changed or best != here,
        cost=least,
    )
    return moved if moved.turn < len(problem.free) else _end_sweep(moved)


def use_modes(problem: Problem, state: State, first: int, last: int, automatic: bool) -> State:
    """Return `state` with modes `first` to `last` in use, counted from 1; the solver continues from its positions.

    Raises
    ------
    InputError
        For modes that are not there.
    """
    if not 1 <= first <= last:
        raise InputError(f"modes {first} to {last} are not a range", "use 1 or more, the lower one first", key="modes")
    require_modes(problem, state.settings.order_offset, last)
    changed = replace(
        state,
        first=first,
        last=last,
        automatic=automatic,
        turn=0,  # converged means that a whole sweep with the new modes moves nothing
        stage_sweeps=0,
        changed=False,
        finished=False,
        converged=False,
    )
    return replace(changed, cost=_cost(problem, changed))


def landscape(problem: Problem, state: State, n: int, modes: slice) -> np.ndarray:
    """Return what a step on microphone `n` minimises, over the lattice, mode by mode : (modes, ny, nx) float64."""
    from ...cost.lattice_search import lattice_landscape

    lattice = search_lattice(problem, state.order_offset)
    weight = state.settings.known_weight
    return lattice_landscape(problem, lattice, state.positions, n, state.centre, modes, weight)


def usable_modes(problem: Problem, settings: SolverSettings) -> int:
    """Return how many of the lowest modes have an expansion with fewer functions than there are microphones."""
    return mode_limits.usable_modes(problem, settings.order_offset)


def _require_solvable(problem: Problem, settings: SolverSettings) -> None:
    """Raise InputError for a problem that descent cannot work on."""
    if settings.known != "all":
        raise InputError(
            f'solver.known = "{settings.known}" leaves descent without the known microphones that it needs',
            "use <known> all, or <solver> joint",
            key="known",
            value=settings.known,
        )
    if problem.dimension != 2:
        raise InputError(
            "descent works on two-dimensional fields; this measurement has dimension = 3", "use <solver> joint"
        )
    if problem.search is None:
        raise InputError("the measurement has no search domain", "give <search> and <radius>", key="search")
    if not fixes_gauge(problem.known_positions):
        raise InputError(
            f"known = {problem.known.tolist()} does not fix translation, rotation and mirror",
            "descent needs at least three known microphones that are not on one line",
            key="known",
            value=problem.known.tolist(),
        )
    _require_lattice(problem, problem.search)


def _require_lattice(problem: Problem, search: Search) -> None:
    """Raise InputError for a search domain with too few points, or too far from a known microphone."""
    count = problem.pressures.shape[1]
    if np.prod(search.shape) < count:
        raise InputError(
            f"search.step = {search.step:g} m leaves {np.prod(search.shape)} candidates for {count} microphones",
            "use a smaller step or a larger search.size",
            key="search.step",
            value=search.step,
        )
    low, high = np.array(search.origin) - search.radius, np.add(search.origin, search.size) + search.radius
    far = np.flatnonzero(np.any((problem.known_positions < low) | (problem.known_positions > high), axis=1))
    if len(far):
        raise InputError(
            f"known microphone {problem.known[far[0]]} at {problem.known_positions[far[0]].tolist()} m is further than"
            f" search.radius = {search.radius:g} m from the search domain",
            "move search.origin",
            key="search.origin",
        )


def _turns(problem: Problem, state: State) -> np.ndarray:
    """Order in which the free microphones are moved in the present sweep; every sweep has its own."""
    return np.random.default_rng([state.seed, 1, state.sweep]).permutation(problem.free)


def _cost(problem: Problem, state: State) -> float:
    """Eq. 7 over the modes in use: a microphone is left out and put back at its position."""
    _, W, fits = _fits(problem, state, int(problem.free[0]))
    return float(sum(fit.cost_of(w[problem.free[:1]])[0] for fit, w in zip(fits, W, strict=True)))


def _fits(problem: Problem, state: State, n: int):
    """The lattice, W of every mode in use and its fit without microphone `n`."""
    lattice = search_lattice(problem, state.order_offset)
    W = lattice.dictionary(state.positions, state.centre, range(len(lattice.orders))[state.modes])
    weights = known_weights(problem, state.settings.known_weight)
    return lattice, W, leave_one_out_fits(W, problem.pressures[state.modes], n, weights=weights)


def _end_sweep(state: State) -> State:
    """Close the sweep; if nothing has moved, or the stage has had its sweeps, add a mode or finish."""
    settled = not state.changed
    state = replace(state, sweep=state.sweep + 1, stage_sweeps=state.stage_sweeps + 1, turn=0, changed=False)
    if not settled and state.stage_sweeps < state.settings.max_sweeps:
        return state
    if state.automatic and state.last < state.settings.modes:
        return replace(state, stage=state.stage + 1, last=state.last + 1, stage_sweeps=0)
    return replace(state, finished=True, converged=settled)
