"""All microphones at once: Levenberg-Marquardt on the likelihood, from the affine start, in stages.

    step   one damped Gauss-Newton step of all free microphones
    sweep  the same: every free microphone has moved once
    stage  steps of one phase, until none moves a microphone:

    deformation    the array moves along polynomials of second, then third degree
                   (`fdcal.solvers.polynomial_deformation`), with the low modes and then with all; the whole residual
                   counts as noise, which is much at first and widens the basin
    free           every microphone moves by itself, with the noise estimated again
    refinement     the noise of the measurement, reported or estimated, is assumed, deflated by `noise_deflation`; if
                   there is little of it, with complex wavenumbers, if they are complex, and with sources near the
                   array allowed for (`fdcal.cost.low_rank_covariance`)
    angular_prior  in the plane and in noise: the field is not diffuse but has a directional distribution estimated
                   from the pressures (`fdcal.cost.angular_prior`), which is updated three times

The noise that a stage assumes: `noise_schedule`. What follows a stage: `acceptance`.

If the residual is more than noise, another affine start is tried, and the likeliest end is kept (`multistart`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...cost.noise_model import NOISE
from ...model.power import mode_power
from ...model.problem import Problem
from ...model.settings import Search, SolverSettings
from ...model.validation import InputError
from .. import initial_positions
from ..interface import AssessmentMethod, Traits
from ..levenberg_marquardt import DAMPING
from ..polynomial_deformation import polynomial_deformations
from ..position_fit import position_step
from ..residual_noise import noise_at
from . import acceptance, noise_schedule
from .multistart import finish, first_modes
from .requirements import require_modes
from .stages import begin, begin_angular_prior, begin_free, in_frame
from .state import Attempt, FieldAssumptions, Phase, State
from .thresholds import PHASES, PRIOR, STAGES

TRAITS = Traits(
    moves_all=True,
    needs_search=False,
    needs_room=False,
    adds_modes=True,
    starts=("affine", "random"),
    draws_order=False,
    takes_positions=True,
    settings=None,
    assessment=AssessmentMethod.LIKELIHOOD,
    uses_likelihood=True,
)


def init(problem: Problem, settings: SolverSettings, seed: int, positions: np.ndarray | None = None) -> State:
    """Return the first state, at the start that `settings.start` names.

    Parameters
    ----------
    problem : Problem
    settings : SolverSettings
    seed : int, of a random start
    positions : (N, D) float64, metres, optional
        Start with phase "free" at these positions.

    Raises
    ------
    InputError
        For too few modes, known microphones that do not fix the gauge, or microphones on a line.
    """
    require_modes(problem, settings.modes)
    given, random = positions is not None, settings.start == "random"
    if positions is None and random:
        positions = initial_positions.random(problem, np.random.default_rng([seed, 0]))
    elif positions is None:
        positions = initial_positions.affine(problem, settings.modes)
    none = np.zeros(0)
    state = State(
        positions=positions,
        settings=settings,
        seed=seed,
        step=0,
        sweep=0,
        stage=0,
        moved=-1,
        first=1,
        last=settings.modes if given else first_modes(problem, settings),
        automatic=True,
        cost=0.0,
        finished=False,
        converged=False,
        phase=Phase("free" if given or random else "deformation", 2, positions, 0, DAMPING.first),
        field=FieldAssumptions(none, none, False, False, 0.0, None, 0),
        attempt=Attempt(0, 0, None),
    )
    return begin(problem, state)


def step(problem: Problem, state: State) -> State:
    """Return `state` after one damped step of all free microphones; the same state if it is finished."""
    if state.finished:
        return state
    phase, limits = state.phase, PHASES[state.phase.name]
    p, field = noise_schedule.stage_model(problem, state)
    wavelength = 2 * np.pi / float(np.real(field.wavenumbers).max())
    basis = _directions(problem, state)
    trial = position_step(state.positions, p, field, basis, phase.damping, STAGES.stride * wavelength, limits.settled)
    moved = replace(
        state,
        positions=in_frame(problem, trial.unknowns),
        step=state.step + 1,
        sweep=state.sweep + 1,
        phase=replace(phase, steps=phase.steps + 1, damping=trial.damping),
        cost=trial.cost,
    )
    fall = trial.fall if field.log_det else trial.fall / float(np.median(field.noise))
    late = phase.name in ("refinement", "angular_prior")
    if late and np.abs(trial.unknowns - phase.origin).max() > STAGES.diverged * wavelength:
        return finish(problem, replace(moved, positions=phase.origin, stage=state.stage + 1), settled=False)
    settled = trial.moved < limits.settled or fall < limits.negligible
    return _end(problem, moved, settled) if settled or moved.phase.steps >= STAGES.steps else moved


def use_modes(problem: Problem, state: State, first: int, last: int, automatic: bool) -> State:
    """Return `state` with modes `first` to `last` in use, counted from 1; the solver continues from its positions.

    Raises
    ------
    InputError
        For modes that are not there, or too few.
    """
    if not 1 <= first <= last:
        raise InputError(f"modes {first} to {last} are not a range", "use 1 or more, the lower one first", key="modes")
    require_modes(problem, last)
    name = state.phase.name if state.phase.name == "deformation" else "free"
    changed = replace(
        state,
        first=first,
        last=last,
        automatic=automatic,
        phase=replace(state.phase, name=name),
        field=replace(state.field, near_field=False, prior=None, prior_updates=0),  # the prior is that of other modes
        attempt=replace(state.attempt, best=None),
        finished=False,
        converged=False,
    )
    return begin(problem, changed)


def landscape(problem: Problem, state: State, n: int, modes: slice, search: Search | None = None) -> np.ndarray:
    """Return the likelihood's cost of microphone `n` over the search lattice, mode by mode.

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

    power = mode_power(problem.pressures[modes])
    least = NOISE.diffuse_floor * power  # with less, as the near-field model has it, the kernel is singular
    noise = np.maximum(state.field.noise[modes], least)
    return likelihood_maps(problem, state.positions, n, modes, noise, search)


def usable_modes(problem: Problem, settings: SolverSettings) -> int:
    """Return the number of modes measured: the likelihood can use all of them."""
    return len(problem.frequencies)


def _directions(problem: Problem, state: State) -> np.ndarray | None:
    """Basis (N D, F) in which the positions may move; None if all may move."""
    if state.phase.name == "deformation":
        return polynomial_deformations(state.phase.origin, problem.known, state.phase.degree)
    if not len(problem.known):
        return None
    N, D = problem.pressures.shape[1], problem.array_dimension
    return np.eye(N * D)[:, (D * problem.free[:, None] + np.arange(D)).ravel()]


def _end(problem: Problem, state: State, settled: bool) -> State:
    """The next stage, or the end."""
    done, phase, rounds = replace(state, stage=state.stage + 1), state.phase, state.attempt.rounds
    if not state.automatic:
        return replace(done, finished=True, converged=settled)
    if phase.name == "deformation":
        if phase.degree == 2:
            return begin(problem, replace(done, phase=replace(phase, degree=3), last=state.settings.modes))
        return begin_free(problem, done)
    if state.last < state.settings.modes:
        return begin(problem, replace(done, phase=replace(phase, name="free"), last=state.settings.modes))
    residual = noise_at(problem, state.positions, state.modes, state.field.near_field)
    if phase.name == "free":
        if not settled and acceptance.worse_than_best(problem, state):
            return finish(problem, done, settled, residual)
        if rounds < STAGES.free and acceptance.needs_free_stage(problem, state, residual):
            return begin_free(problem, done, residual)
        return begin(problem, replace(done, phase=replace(phase, name="refinement")), residual)
    if phase.name == "angular_prior" or acceptance.prior_helps(problem, state):
        if state.field.prior_updates < PRIOR.updates:
            return begin_angular_prior(problem, done)
        return finish(problem, done, settled, residual)
    refined = replace(done, attempt=replace(done.attempt, rounds=rounds + 1))
    refined = noise_schedule.with_noise(problem, refined, residual)
    if rounds < STAGES.free + STAGES.refinement and acceptance.noise_differs(problem, state, refined):
        return begin(problem, refined, residual)
    return finish(problem, done, settled, residual)
