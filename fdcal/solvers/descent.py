"""Block coordinate descent, section 3 of the paper: one microphone at a time over all candidates.

    step   one free microphone moves to the candidate with the lowest cost (Eq. 7) while the others stay; then the
           expansion is recentred on the centre of mass of the array
    sweep  all free microphones move once, in an order drawn for this sweep
    stage  sweeps with one set of modes, until no microphone moves in a whole sweep, or for `max_sweeps` sweeps; then
           the next mode is added

The run either begins with its lowest modes and adds higher ones, or begins with its highest mode and adds lower ones
(`SolverSettings.mode_order`). By default the free microphones begin at random candidates, the points of the search
lattice. The centre of the expansion is the centre of mass rounded to the lattice, so that one table of radial functions
serves every step (`fdcal.acoustics.dictionary.LatticeDictionary`). In three dimensions the candidates are searched from
coarse to fine (`fdcal.cost.lattice`), and only some of them are tried.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..cost import eq7
from ..cost.eq7 import known_weights, leave_one_out_fits, require_modes
from ..cost.maps import descent_maps
from ..model.gauge import MIN_KNOWN, fixes_gauge
from ..model.problem import Problem
from ..model.settings import Search, SolverSettings
from ..model.validation import InputError, Reals, frozen_array
from . import starts
from .interface import Estimate, RunState, Traits
from .requirements import require_range
from .robust.result import estimate_at

if TYPE_CHECKING:
    from ..cost.lattice import PlaneLattice, SpaceLattice

TRAITS = Traits(
    moves_all=False,
    needs_search=True,
    adds_modes=True,
    starts=("random", "affine"),
    draws_order=True,
    settings=frozenset(
        "modes first_modes mode_order order_offset ample_modes known_weight max_sweeps start known".split()
    ),
)


@dataclass(frozen=True)
class State(RunState):
    """Everything that `step` needs, so that a run can be continued from any state.

    `cost`: Eq. 7 summed over the modes in use, with the expansion about the centre that the last step used.
    """

    solver: ClassVar[str] = "descent"

    centre: Reals  # (D,) float64, metres, centre of the expansion, read-only
    turn: int = 0  # steps taken in the present sweep, from 0 to the number of free microphones minus 1
    stage_sweeps: int = 0  # sweeps completed in the present stage
    changed: bool = False  # whether a microphone has moved in the present sweep

    @property
    def order_offset(self) -> int:
        """The number added to ceil(kR), which depends on the highest mode in use (`order_offset_of`)."""
        return order_offset_of(self.settings, self.last)

    def next_microphone(self, problem: Problem) -> int:
        """Return the microphone that the next step moves; -1 at the end."""
        return -1 if self.finished else int(_order(problem, self.seed, self.sweep)[self.turn])


def order_offset_of(settings: SolverSettings, modes: int) -> int:
    """Return the number added to ceil(kR) (Eq. 3) if mode `modes`, counted from 1, is the highest in use.

    It is 0 while only low modes are in use, because with more functions the expansion would fit them at any positions.
    """
    return settings.order_offset if modes >= settings.ample_modes else 0


def init(problem: Problem, settings: SolverSettings, seed: int) -> State:
    """Return the first state: free microphones on the search lattice, known ones at their positions.

    `seed` determines the random start and the order in which the microphones are moved.
    """
    _require_solvable(problem, settings)
    require_modes(problem, settings.order_offset, settings.modes)
    lattice = _lattice(problem, settings.order_offset)
    if settings.start == "affine":
        positions = lattice.nearest(starts.affine(problem, settings.modes))
    else:
        rng = np.random.default_rng([seed, 0])
        positions = lattice.points[rng.choice(len(lattice.points), problem.pressures.shape[1], replace=False)]
    positions[problem.known] = problem.known_positions
    state = State(
        positions=frozen_array(positions, float),
        centre=frozen_array(lattice.nearest(positions.mean(axis=0)), float),
        settings=settings,
        seed=seed,
        first=settings.modes if settings.mode_order == "descending" else 1,
        last=settings.modes if settings.mode_order == "descending" else settings.first_modes,
    )
    return replace(state, cost=_cost(problem, state))


def step(problem: Problem, state: State) -> State:
    """Return `state` with the next microphone moved to its best candidate; the same state if it is finished."""
    if state.finished:
        return state
    n = state.next_microphone(problem)
    lattice, modes = _lattice(problem, state.order_offset), state.modes
    positions = state.positions.copy()
    _, fits = _fits(problem, lattice, state, n)
    positions[n], cost = lattice.best(state.centre, modes, fits, state.positions[n])
    moved = replace(
        state,
        positions=frozen_array(positions, float),
        centre=frozen_array(lattice.nearest(positions.mean(axis=0)), float),
        step=state.step + 1,
        turn=state.turn + 1,
        moved=n,
        changed=state.changed or not np.array_equal(positions[n], lattice.nearest(state.positions[n])),
        cost=cost,
    )
    return moved if moved.turn < len(problem.free) else _end_sweep(moved)


def _end_sweep(state: State) -> State:
    """Return the state after a sweep. If it was the last one of its stage, a mode is added, or the run ends."""
    converged = not state.changed
    state = replace(state, sweep=state.sweep + 1, stage_sweeps=state.stage_sweeps + 1, turn=0, changed=False)
    if not converged and state.stage_sweeps < state.settings.max_sweeps:
        return state
    descending = state.settings.mode_order == "descending"
    if state.automatic and (state.first > 1 if descending else state.last < state.settings.modes):
        added = {"first": state.first - 1} if descending else {"last": state.last + 1}
        return replace(state, stage=state.stage + 1, stage_sweeps=0, **added)
    return replace(state, finished=True, converged=converged)


@functools.lru_cache(maxsize=8)
def _order(problem: Problem, seed: int, sweep: int) -> np.ndarray:
    """Return the order in which the free microphones are moved in a sweep."""
    return np.random.default_rng([seed, 1, sweep]).permutation(problem.free)


def _lattice(problem: Problem, order_offset: int) -> PlaneLattice | SpaceLattice:
    """Return the candidates: the lattice of the search domain, of two or three dimensions."""
    from ..cost import lattice  # imported here: it loads the compiler

    made = lattice.space_lattice if problem.array_dimension == 3 else lattice.plane_lattice
    return made(problem, order_offset)


def _fits(problem: Problem, lattice: PlaneLattice | SpaceLattice, state: State, n: int):
    """Return W (Eq. 4) of each mode in use, and the fit of its pressures without microphone `n`."""
    modes, weights = state.modes, known_weights(problem, state.settings.known_weight)
    W = lattice.dictionary(state.positions, state.centre, range(len(lattice.orders))[modes])
    return W, leave_one_out_fits(W, problem.pressures[modes], n, weights)


def _cost(problem: Problem, state: State) -> float:
    """Return Eq. 7 over the modes in use, by a fit without the first free microphone; the formula is in `eq7`."""
    n = int(problem.free[0])
    W, fits = _fits(problem, _lattice(problem, state.order_offset), state, n)
    return float(sum(fit.cost_of(w[n : n + 1])[0] for fit, w in zip(fits, W, strict=True)))


def use_modes(problem: Problem, state: State, first: int, last: int, automatic: bool) -> State:
    """Return `state` with modes `first` to `last` in use, counted from 1; the solver continues from its positions.

    Raises InputError if these modes were not measured, or if the microphones are too few for their expansion.
    """
    require_range(problem, first, last)
    require_modes(problem, state.settings.order_offset, last)
    changed = replace(state, first=first, last=last, automatic=automatic, finished=False, converged=False)
    changed = replace(changed, turn=0, stage_sweeps=0, changed=False)  # convergence needs a whole sweep
    return replace(changed, cost=_cost(problem, changed))


def landscape(problem: Problem, state: State, n: int, modes: slice, search: Search | None = None) -> np.ndarray:
    """Return the cost that a step on microphone `n` minimises, mode by mode over the lattice : (modes, ny, nx) float64.

    In three dimensions the lattice is the layer at the height of the microphone. `search` may be another lattice.
    """
    numbers, weight = range(1, len(problem.pressures) + 1)[modes], state.settings.known_weight
    return descent_maps(problem, state.positions, n, numbers, state.order_offset, weight, state.centre, search)


def result(problem: Problem, state: State) -> Estimate:
    """Return what descent has found; its uncertainty comes from the likelihood, because Eq. 7 does not model noise."""
    return estimate_at(problem, state.settings, state.positions, state.modes, state.finished)


def usable_modes(problem: Problem, settings: SolverSettings) -> int:
    """Return how many of the lowest modes the microphones carry (`eq7.usable_modes`)."""
    return eq7.usable_modes(problem, settings.order_offset)


def _require_solvable(problem: Problem, settings: SolverSettings) -> None:
    """Raise InputError for a problem or settings that descent cannot work on."""
    if settings.known != "all":
        message = f'solver.known = "{settings.known}" leaves descent without the known microphones that it needs'
        raise InputError(message, "use <known> all, or <solver> joint", key="known")
    if problem.dimension != problem.array_dimension:
        raise InputError(
            "descent needs a two-dimensional field or an array in space; this measurement of an array in a plane has"
            " dimension = 3",
            "use <solver> joint",
        )
    search, known, count = eq7.search_domain(problem), problem.known.tolist(), problem.pressures.shape[1]
    if not fixes_gauge(problem.known_positions):
        message = f"known = {known} does not fix translation, rotation and mirror image"
        raise InputError(message, f"descent needs at least {MIN_KNOWN[problem.array_dimension]}", key="known")
    if np.prod(search.shape) < count:
        message = f"search.step = {search.step:g} m leaves {np.prod(search.shape)} candidates for {count} microphones"
        raise InputError(message, "use a smaller step or a larger search.size", key="search.step")
    low, high = np.array(search.origin) - search.radius, np.add(search.origin, search.size) + search.radius
    far = np.flatnonzero(np.any((problem.known_positions < low) | (problem.known_positions > high), axis=1))
    if len(far):
        fault = (
            f"known microphone {known[far[0]]} at {problem.known_positions[far[0]].tolist()} m is further than"
            f" search.radius = {search.radius:g} m from the search domain"
        )
        raise InputError(fault, "move search.origin", key="search.origin")
