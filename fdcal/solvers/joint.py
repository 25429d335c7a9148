"""All microphones at once: Levenberg-Marquardt on the likelihood, from the affine start, frequencies added in stages.

    step   one damped Gauss-Newton step of all free microphones
    sweep  the same: every free microphone has moved once
    stage  steps with one set of modes, until none moves a microphone; then more modes are added

The noise is taken as what the positions cannot explain, estimated anew at each stage. So it is large while the
positions are poor, which widens the basin, and falls to the measurement's own noise, where that is known, at the end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..checks import InputError, frozen_array
from ..likelihood import LEAST_NOISE, DiffuseField, diffuse_field, likelihood, likelihood_landscape, noise_ratio
from ..measurement import Problem
from ..scene import Solver
from . import starts
from .newton import FIRST_DAMPING, damped_step

FIRST_MODES = 28  # of the first stage; fewer low modes do not hold the soft directions of the array
SETTLED = 1e-5  # metres: a stage ends when no microphone moves further
MOST_STEPS = 60  # of one stage


@dataclass(frozen=True)
class State:
    """Everything `step` needs to go on, so that any state can be gone on from.

    Attributes
    ----------
    positions : (N, D) float64, metres, read-only; up to rotation, translation and mirror without known microphones
    settings : Solver
    seed : int, not used: nothing is drawn
    step, sweep, stage : steps taken (twice), stages completed
    moved : -1, since all microphones move
    first, last : modes in use, counted from 1, both included
    automatic : whether modes are added when settled
    stage_steps : steps taken in the present stage
    damping : of the next step
    noise : (M,) float64, noise power supposed, in the unit of abs(pressures)**2, read-only
    cost : -log likelihood over the modes in use, up to a constant, dimensionless
    finished : nothing is left to do
    converged : finished because no microphone moved any more, not because steps ran out
    """

    positions: np.ndarray
    settings: Solver
    seed: int
    step: int
    sweep: int
    stage: int
    moved: int
    first: int
    last: int
    automatic: bool
    stage_steps: int
    damping: float
    noise: np.ndarray
    cost: float
    finished: bool
    converged: bool

    @property
    def modes(self) -> slice:
        """Indices of the modes in use."""
        return slice(self.first - 1, self.last)


def init(problem: Problem, settings: Solver, seed: int) -> State:
    """The affine start, with the lowest modes in use.

    Raises InputError for too few modes, known microphones that do not fix the gauge, microphones on a line.
    """
    _require_modes(problem, settings.modes)
    positions = starts.affine(problem)
    state = State(
        positions=frozen_array(positions, float),
        settings=settings,
        seed=seed,
        step=0,
        sweep=0,
        stage=0,
        moved=-1,
        first=1,
        last=min(FIRST_MODES, settings.modes),
        automatic=True,
        stage_steps=0,
        damping=FIRST_DAMPING,
        noise=np.zeros(0),
        cost=0.0,
        finished=False,
        converged=False,
    )
    return _begin_stage(problem, state)


def step(problem: Problem, state: State) -> State:
    """`state` after one damped step of all free microphones; unchanged if finished."""
    if state.finished:
        return state
    p, field = _model(problem, state)
    trial = damped_step(state.positions, p, field, _free_directions(problem), state.damping)
    moved = replace(
        state,
        positions=frozen_array(trial.positions, float),
        step=state.step + 1,
        sweep=state.sweep + 1,
        stage_steps=state.stage_steps + 1,
        damping=trial.damping,
        cost=trial.cost,
    )
    settled = trial.moved < SETTLED
    return _end_stage(problem, moved, settled) if settled or moved.stage_steps >= MOST_STEPS else moved


def use_modes(problem: Problem, state: State, first: int, last: int, automatic: bool) -> State:
    """`state` with modes `first` to `last` in use (from 1, both included) and the solver free to go on."""
    if not 1 <= first <= last:
        raise InputError(f"modes {first} to {last} are no range; the first is 1")
    _require_modes(problem, last)
    changed = replace(state, first=first, last=last, automatic=automatic, finished=False, converged=False)
    return _begin_stage(problem, changed)


def landscape(problem: Problem, state: State, n: int, modes: slice) -> np.ndarray:
    """The likelihood's cost of microphone `n` over the search lattice, mode by mode : (modes, ny, nx) float64.

    In space, over the horizontal layer at the microphone's own height.
    """
    search = problem.search
    if search is None:
        raise InputError("the measurement has no search domain; give --search ORIGIN,SIZE,STEP and --radius R")
    layer = search.layer(float(state.positions[n, -1]))
    p, field = _model(problem, state, modes)
    maps = likelihood_landscape(state.positions, n, layer.reshape(-1, layer.shape[-1]), p, field)
    return maps.reshape(-1, *layer.shape[:-1])


def _require_modes(problem: Problem, count: int) -> None:
    measured, microphones = problem.pressures.shape
    if count > measured:
        raise InputError(f"{count} modes asked for, but {measured} were measured; use at most {measured}")
    unknowns = problem.array_dimension * len(problem.free)
    least = starts.MODES
    if count < least:
        raise InputError(f"modes = {count} are too few for {unknowns} unknown coordinates; use at least {least}")
    if microphones < 2 * problem.array_dimension + 2:
        raise InputError(
            f"{microphones} microphones are too few to find; use {2 * problem.array_dimension + 2} or more"
        )


def _model(problem: Problem, state: State, modes: slice | None = None) -> tuple[np.ndarray, DiffuseField]:
    modes = state.modes if modes is None else modes
    p = problem.pressures[modes]
    return p, diffuse_field(p, problem.wavenumbers[modes], state.noise[modes], problem.dimension)


def _free_directions(problem: Problem) -> np.ndarray | None:
    """Basis (N D, F) of the coordinates that may move; None where all may."""
    if not len(problem.known):
        return None
    N, D = problem.pressures.shape[1], problem.array_dimension
    coordinates = (D * problem.free[:, None] + np.arange(D)).ravel()
    return np.eye(N * D)[:, coordinates]


def _begin_stage(problem: Problem, state: State) -> State:
    """The noise estimated from what the positions leave unexplained, never below what the measurement says."""
    p, k = problem.pressures, problem.wavenumbers
    ratio = noise_ratio(state.positions, p[state.modes], k[state.modes], problem.dimension)
    power = np.mean(np.abs(p) ** 2, axis=1)
    told = np.zeros(len(p)) if problem.noise_power is None else problem.noise_power
    noise = np.maximum(told, max(ratio, LEAST_NOISE) * power)
    if state.last >= state.settings.modes and np.any(told > 0) and state.stage > 0:
        noise = np.maximum(told, LEAST_NOISE * power)
    begun = replace(state, stage_steps=0, damping=FIRST_DAMPING, noise=frozen_array(noise, float))
    pressures, field = _model(problem, begun)
    return replace(begun, cost=float(likelihood(begun.positions, pressures, field).sum()))


def _end_stage(problem: Problem, state: State, settled: bool) -> State:
    """More modes, or another look at the noise, or the end."""
    if state.automatic and state.last < state.settings.modes:
        return _begin_stage(problem, replace(state, stage=state.stage + 1, last=state.settings.modes))
    again = _begin_stage(problem, replace(state, stage=state.stage + 1))
    if np.allclose(again.noise, state.noise, rtol=0.2) or state.stage > 10:
        return replace(state, finished=True, converged=settled)
    return again
