"""Block coordinate descent, section 3 of the paper: one microphone at a time over all candidates.

    step   one free microphone is moved to the candidate of least cost, the basis recentred
    sweep  all free microphones are moved once
    stage  sweeps with one set of modes, until no microphone moves; then the next mode is added

The centre of the expansion is the centre of mass rounded to the search lattice, so that one table of radial functions
serves every step (`fdcal.acoustics.lattice_dictionary.LatticeDictionary`). In three dimensions the candidates are
searched from coarse to fine (`fdcal.cost.lattice`), and the lowest one that was tried counts as the best.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from ...acoustics.lattice_dictionary import LatticeDictionary
from ...cost import expansion
from ...cost.eq7 import known_weights, leave_one_out_fits
from ...cost.expansion import require_modes
from ...cost.lattice import SpaceLattice, best_candidate, search_lattice, space_lattice
from ...cost.maps import descent_maps
from ...model.problem import Problem
from ...model.settings import Search, SolverSettings
from ...model.validation import InputError, frozen_array
from .. import initial_positions
from ..interface import AssessmentMethod, Traits
from .requirements import require_solvable
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
    require_solvable(problem, settings)
    require_modes(problem, settings.order_offset, settings.modes)
    lattice = _lattice(problem, settings.order_offset)
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
    n = int(_turns(problem, state.seed, state.sweep)[state.turn])
    lattice = _lattice(problem, state.order_offset)
    positions = state.positions.copy()
    positions[n], least = _best(problem, lattice, state, n)
    moved = replace(
        state,
        positions=frozen_array(positions, float),
        centre=frozen_array(lattice.nearest(positions.mean(axis=0)), float),
        step=state.step + 1,
        turn=state.turn + 1,
        moved=n,
        changed=state.changed or not np.array_equal(positions[n], lattice.nearest(state.positions[n])),
        cost=least,
    )
    return moved if moved.turn < problem.pressures.shape[1] - len(problem.known) else _end_sweep(moved)


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


def landscape(problem: Problem, state: State, n: int, modes: slice, search: Search | None = None) -> np.ndarray:
    """Return what a step on microphone `n` minimises, over the lattice, mode by mode : (modes, ny, nx) float64.

    In three dimensions it is the layer at the height of the microphone; `search` may be another lattice.
    """
    numbers, weight = range(1, len(problem.pressures) + 1)[modes], state.settings.known_weight
    return descent_maps(problem, state.positions, n, numbers, state.order_offset, weight, state.centre, search)


def usable_modes(problem: Problem, settings: SolverSettings) -> int:
    """Return how many of the lowest modes have an expansion with fewer functions than there are microphones."""
    return expansion.usable_modes(problem, settings.order_offset)


def _lattice(problem: Problem, order_offset: int) -> LatticeDictionary | SpaceLattice:
    """The lattice of the search domain, of two or three dimensions."""
    if problem.array_dimension == 3:
        return space_lattice(problem, order_offset)
    return search_lattice(problem, order_offset)


def _best(problem: Problem, lattice, state: State, n: int) -> tuple[np.ndarray, float]:
    """The best candidate for microphone `n`, metres, and its cost."""
    if isinstance(lattice, SpaceLattice):
        return lattice.best(state.centre, state.modes, _fits(problem, state, n)[1], state.positions[n])
    weight = state.settings.known_weight
    return best_candidate(problem, lattice, state.positions, n, state.centre, state.modes, weight)


@functools.lru_cache(maxsize=8)
def _turns(problem: Problem, seed: int, sweep: int) -> np.ndarray:
    """Order in which the free microphones are moved in a sweep; every sweep has its own."""
    return np.random.default_rng([seed, 1, sweep]).permutation(problem.free)


def _cost(problem: Problem, state: State) -> float:
    """Eq. 7 over the modes in use: a microphone is left out and put back at its position."""
    W, fits = _fits(problem, state, int(problem.free[0]))
    return float(sum(fit.cost_of(w[problem.free[:1]])[0] for fit, w in zip(fits, W, strict=True)))


def _fits(problem: Problem, state: State, n: int):
    """W of every mode in use, and its fit without microphone `n`."""
    lattice = _lattice(problem, state.order_offset)
    W = lattice.dictionary(state.positions, state.centre, range(len(lattice.orders))[state.modes])
    weights = known_weights(problem, state.settings.known_weight)
    return W, leave_one_out_fits(W, problem.pressures[state.modes], n, weights)


def _end_sweep(state: State) -> State:
    """Close the sweep; if nothing has moved, or the stage has had its sweeps, add a mode or finish."""
    settled = not state.changed
    state = replace(state, sweep=state.sweep + 1, stage_sweeps=state.stage_sweeps + 1, turn=0, changed=False)
    if not settled and state.stage_sweeps < state.settings.max_sweeps:
        return state
    if state.automatic and state.last < state.settings.modes:
        return replace(state, stage=state.stage + 1, last=state.last + 1, stage_sweeps=0)
    return replace(state, finished=True, converged=settled)
