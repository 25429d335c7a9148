"""All microphones at once: Levenberg-Marquardt on the likelihood, from the affine start, in stages.

    step   one damped Gauss-Newton step of all free microphones
    sweep  the same: every free microphone has moved once
    stage  steps towards one goal, until none moves a microphone:

    bend    the array bends as a whole (`starts.bends`), by polynomials of second and third degree, with the low modes
            and then with all; the noise is what the positions cannot explain, so it is large at first, which widens
            the basin
    free    every microphone for itself, the noise estimated anew
    sharp   the noise of the measurement, told or estimated, less `confidence`; where that is little, with complex
            wavenumbers, if they are, and with sources near the array allowed for (`fdcal.cost.low_rank_covariance`)

    learned in the plane and in noise, the field not diffuse but from directions learned from the pressures
            (`fdcal.cost.angular_prior`), three times anew

What noise is supposed at each stage, and what is made of its end: `fdcal.solvers.noise_schedule`.

If what remains unexplained is more than noise, another affine start is tried, and the likeliest end is kept.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...cost.likelihood import diffuse_field
from ...cost.noise_model import NOISE, NoiseEstimate
from ...model.gauge import move_to_frame
from ...model.power import mode_power
from ...model.problem import Problem
from ...model.settings import Search, SolverSettings
from ...model.validation import InputError, frozen_array
from .. import initial_positions
from ..interface import AssessmentMethod, Traits
from ..levenberg_marquardt import FIRST_DAMPING, damped_step, finite_cost
from . import noise_schedule
from .state import State

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

FIRST_MODES = 28  # of the first bend
LOW_DAMPING = 1e-7  # with which a stage begins that is near its end: damping holds back what the pressures hardly tell
SETTLED = {
    "bend": 2e-3,
    "free": 3e-4,
    "sharp": 1e-6,
    "learned": 1e-6,
}  # metres: a stage ends when nothing moves further
NEGLIGIBLE = {"bend": 1.0, "free": 1.0, "sharp": 1e-3, "learned": 0.3}  # or -log likelihood falls by no more
MOST_STEPS = 60  # of one stage
MOST_ROUNDS = 4  # stages of phase "free" in one attempt
MOST_SHARP = 4  # and about as many of phase "sharp"
LEARNED = (3, 5, 3.0)  # stages, rounds of learning in each, and `confidence` at most: the prior is better then
STRIDE = 0.125  # of the shortest wavelength: no microphone moves further in one step
FLED = 0.5  # of the shortest wavelength: a microphone that goes further in the last stages has left its basin
LEAST_MODES = {2: 6, 3: 12}  # of a sound field of two and three dimensions


def init(problem: Problem, settings: SolverSettings, seed: int, positions=None) -> State:
    """The start that `settings.start` names, or `positions` (N, D), metres, with the lowest modes in use.

    Raises InputError for too few modes, known microphones that do not fix the gauge, microphones on a line.
    """
    _require_modes(problem, settings.modes)
    given = positions is not None
    random = settings.start == "random"
    if not given and random:
        positions = initial_positions.random(problem, np.random.default_rng([seed, 0]))
    elif not given:
        positions = initial_positions.affine(problem, settings.modes)
    state = State(
        positions=positions,
        settings=settings,
        seed=seed,
        step=0,
        sweep=0,
        stage=0,
        moved=-1,
        first=1,
        last=settings.modes if given else _first_modes(problem, settings),
        automatic=True,
        phase="free" if given or random else "bend",
        prior=None,
        lessons=0,
        near=False,
        degree=2,
        shape=positions,
        attempt=0,
        best=None,
        rounds=0,
        stage_steps=0,
        damping=FIRST_DAMPING,
        noise=np.zeros(0),
        noise_power=np.zeros(0),
        noise_told=False,
        spread=0.0,
        cost=0.0,
        finished=False,
        converged=False,
    )
    return _begin(problem, state)


def step(problem: Problem, state: State) -> State:
    """`state` after one damped step of all free microphones; unchanged if finished."""
    if state.finished:
        return state
    p, field = noise_schedule.model(problem, state)
    wavelength = 2 * np.pi / float(np.real(field.wavenumbers).max())
    basis = _directions(problem, state)
    trial = damped_step(state.positions, p, field, basis, state.damping, STRIDE * wavelength, SETTLED[state.phase])
    moved = replace(
        state,
        positions=_placed(problem, trial.positions),
        step=state.step + 1,
        sweep=state.sweep + 1,
        stage_steps=state.stage_steps + 1,
        damping=trial.damping,
        cost=trial.cost,
    )
    fall = trial.fall if field.log_det else trial.fall / float(np.median(field.noise))
    if state.phase in ("sharp", "learned") and np.abs(trial.positions - state.shape).max() > FLED * wavelength:
        return _finish(problem, replace(moved, positions=state.shape, stage=state.stage + 1), settled=False)
    settled = trial.moved < SETTLED[state.phase] or fall < NEGLIGIBLE[state.phase]
    return _end(problem, moved, settled) if settled or moved.stage_steps >= MOST_STEPS else moved


def use_modes(problem: Problem, state: State, first: int, last: int, automatic: bool) -> State:
    """`state` with modes `first` to `last` in use (from 1, both included) and the solver free to go on."""
    if not 1 <= first <= last:
        raise InputError(f"modes {first} to {last} are no range; the first is 1")
    _require_modes(problem, last)
    phase = state.phase if state.phase == "bend" else "free"
    changed = replace(
        state,
        first=first,
        last=last,
        automatic=automatic,
        phase=phase,
        near=False,
        finished=False,
        converged=False,
        best=None,
    )
    return _begin(problem, changed)


def landscape(problem: Problem, state: State, n: int, modes: slice, search: Search | None = None) -> np.ndarray:
    """The likelihood's cost of microphone `n` over the search lattice, mode by mode : (modes, ny, nx) float64.

    In space, over the horizontal layer at the microphone's own height. `search` is another lattice over the same area.
    """
    if problem.search is None:
        raise InputError("the measurement has no search domain", "give <search> and <radius>", key="search")
    from ...cost.likelihood_maps import likelihood_maps  # compiled code is loaded with the first map

    power = mode_power(problem.pressures[modes])
    least = NOISE.diffuse_floor * power  # with less, as the near-field model has it, the kernel is singular
    noise = np.maximum(state.noise[modes], least)
    return likelihood_maps(problem, state.positions, n, modes, noise, search)


def usable_modes(problem: Problem, settings: SolverSettings) -> int:
    """Return the number of modes measured: the likelihood takes all of them."""
    return len(problem.frequencies)


def _require_modes(problem: Problem, count: int) -> None:
    """Raise InputError unless `count` modes were measured, and are enough for the coordinates sought."""
    measured, microphones = problem.pressures.shape
    D = problem.array_dimension
    if count > measured:
        raise InputError(
            f"solver.modes = {count}, but {measured} modes were measured; use at most {measured}, or measure more"
        )
    if microphones < 2 * D + 2:
        raise InputError(f"{microphones} microphones are too few to find; use {2 * D + 2} or more")
    unknowns = D * len(problem.free)
    equations = 2 * (microphones - problem.dimension - 1)  # real ones a mode, less the least that its field takes up
    least = max(LEAST_MODES[problem.dimension], -(-unknowns // equations) + 1)
    if count < least:
        raise InputError(
            f"{count} modes are too few for {unknowns} unknown coordinates; use at least {least} (--modes)"
        )


def _first_modes(problem: Problem, settings: SolverSettings) -> int:
    """Modes of the first bend: without known microphones all, since the low ones alone do not hold the scale."""
    return min(FIRST_MODES, settings.modes) if len(problem.known) else settings.modes


def _directions(problem: Problem, state: State) -> np.ndarray | None:
    """Basis (N D, F) in which the positions may move; None where all may."""
    if state.phase == "bend":
        return initial_positions.bends(state.shape, problem.known, state.degree)
    if not len(problem.known):
        return None
    N, D = problem.pressures.shape[1], problem.array_dimension
    return np.eye(N * D)[:, (D * problem.free[:, None] + np.arange(D)).ravel()]


def _placed(problem: Problem, positions) -> np.ndarray:
    """Positions in the frame of the least gauge, where there is one : read-only."""
    return frozen_array(positions if problem.frame is None else move_to_frame(positions, problem.frame), float)


def _begin(problem: Problem, state: State, rest: NoiseEstimate | None = None) -> State:
    """Start a stage."""
    positions = _placed(problem, state.positions)
    damping = FIRST_DAMPING if state.phase == "bend" else LOW_DAMPING
    placed = replace(state, positions=positions, shape=positions, stage_steps=0, damping=damping)
    begun = noise_schedule.supposing(problem, placed, rest)
    return replace(begun, cost=finite_cost(begun.positions, *noise_schedule.model(problem, begun)))


def _end(problem: Problem, state: State, settled: bool) -> State:
    """The next stage, or the end."""
    done = replace(state, stage=state.stage + 1)
    if not state.automatic:
        return replace(done, finished=True, converged=settled)
    if state.phase == "bend":
        if state.degree == 2:
            return _begin(problem, replace(done, degree=3, last=state.settings.modes))
        return _begin_free(problem, done)
    if state.last < state.settings.modes:
        return _begin(problem, replace(done, phase="free", last=state.settings.modes))
    rest = initial_positions.left_over(problem, state.positions, state.modes, state.near)
    if state.phase == "free" and not settled and noise_schedule.outdone(problem, state):
        return _finish(problem, done, settled, rest)  # it wanders, and there is a better one
    if state.phase == "free" and state.rounds < MOST_ROUNDS and noise_schedule.rough(problem, state, rest):
        return _begin_free(problem, done, rest)
    if state.phase == "free":
        return _begin(problem, replace(done, phase="sharp"), rest)
    if state.phase == "learned" or noise_schedule.worth_learning(problem, state):
        return _learn(problem, done) if state.lessons < LEARNED[0] else _finish(problem, done, settled, rest)
    sharper = noise_schedule.supposing(problem, replace(done, rounds=state.rounds + 1), rest)
    if state.rounds < MOST_ROUNDS + MOST_SHARP and noise_schedule.another(problem, state, sharper):
        return _begin(problem, sharper, rest)
    return _finish(problem, done, settled, rest)


def _begin_free(problem: Problem, state: State, rest: NoiseEstimate | None = None) -> State:
    """Every microphone for itself, those in a wrong basin put elsewhere first."""
    rest = initial_positions.left_over(problem, state.positions, state.modes) if rest is None else rest
    positions = initial_positions.rehomed(problem, state.positions, state.modes, rest)
    return _begin(problem, replace(state, phase="free", rounds=state.rounds + 1, positions=positions))


def _learn(problem: Problem, state: State) -> State:
    """A stage of phase "learned", the directions learned at the positions reached."""
    from ...cost.angular_prior import diffuse_prior, learned_prior

    p, k = problem.pressures[state.modes], problem.wavenumbers[state.modes]
    field = diffuse_field(p, k, state.noise_power[state.modes], 2)
    prior = diffuse_prior(state.positions, k)
    prior = learned_prior(state.positions, p, k, field.power, field.noise, prior, (state.lessons + 1) * LEARNED[1])
    less = np.minimum(noise_schedule.confidence(state.noise_power / mode_power(problem.pressures), problem), LEARNED[2])
    begun = replace(
        state,
        phase="learned",
        prior=frozen_array(prior, float),
        lessons=state.lessons + 1,
        shape=state.positions,
        stage_steps=0,
        damping=FIRST_DAMPING,
        noise=frozen_array(state.noise_power / less, float),
    )
    return replace(begun, cost=finite_cost(begun.positions, *noise_schedule.model(problem, begun)))


def _finish(problem: Problem, state: State, settled: bool, rest: NoiseEstimate | None = None) -> State:
    """The end, or another attempt where too much is left unexplained."""
    if settled and noise_schedule.certain(problem, state):
        return replace(state, finished=True, converged=True)
    if rest is None or noise_schedule.faint(problem, state) is not None:  # uncertain ends: by the real kernel
        rest = initial_positions.left_over(problem, state.positions, state.modes)
    here = rest.cost, settled, state.positions, state.shape, state.noise, state.noise_power, state.near
    before = state.best is not None and state.best[0] <= rest.cost
    best = state.best if before else here
    tries = noise_schedule.attempts(problem, state)
    last = state.settings.start == "random" or state.attempt + 1 >= len(tries)
    if last or noise_schedule.convincing(problem, state, rest):
        ended = replace(state, finished=True, converged=best[1])
        return _as_before(problem, ended) if before else ended
    return _try(problem, replace(state, attempt=state.attempt + 1, best=best), *tries[state.attempt + 1])


def _as_before(problem: Problem, state: State) -> State:
    """`state` at the end of the best attempt."""
    _, _, positions, shape, noise, noise_power, near = state.best
    again = replace(
        state, positions=positions, shape=shape, noise=noise, noise_power=noise_power, near=near, prior=None
    )
    return replace(again, cost=finite_cost(positions, *noise_schedule.model(problem, again)))


def _try(problem: Problem, state: State, how: str, value: float) -> State:
    """Another attempt, one of `starts.attempts`."""
    if how in ("lowest", "gentle"):
        positions = initial_positions.affine(problem, state.settings.modes, int(value))
    elif how == "redirected":
        positions = initial_positions.redirected(problem, state.settings.modes)
    else:
        best = state.best[2]
        positions = best.mean(axis=0) + value * (best - best.mean(axis=0))
    last = _first_modes(problem, state.settings)
    return _begin(
        problem,
        replace(
            state, positions=positions, phase="bend", near=False, prior=None, lessons=0, rounds=0, degree=2, last=last
        ),
    )
