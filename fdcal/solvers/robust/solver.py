"""Positions, channel gains and channel noise together: Levenberg-Marquardt on one likelihood, in stages.

    step   one damped Gauss-Newton step of everything that is free, and one round of the noise model's fixed point
    stage  one row of the schedule (`settings.SCHEDULE`): deformations of the whole array, then every microphone,
           then gains, too, the noise estimated anew after each
    attempt  the stages from one start (`starts.plan`); the likeliest end of several attempts is refined and kept
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...model.gauge import align, fixes_gauge, place
from ...model.measurement import Problem
from ...model.validation import InputError, frozen_array
from .. import initial_positions
from . import model as supposing
from . import outliers, starts
from .newton import damped_step, free_basis
from .settings import SCHEDULE, RobustSettings
from .state import End, State

NAMES = [row.name for row in SCHEDULE]
SAME_SCORE = 30.0  # nats between the ends of two attempts that are one
SAME_PLACE = 0.01  # of the shortest wavelength, likewise
SETTLED_NOISE = 0.15  # change of the logarithm of the noise after which a round is the last
SEARCH_MODES, MOST_SEARCHES = 16, 1  # modes of a search for other places; rounds after which there is none
OUTLIER = 3.0  # times the median deviation, or the spread, of the given positions
MOST_FINAL = 6  # rounds of the last stage
NEAR_GAIN = 0.5  # of what the series leaves unexplained, below which the near kernel is taken
NEAR_DEFLATION = 3.0  # noise that the near kernel leaves, over what is supposed


def init(problem: Problem, settings: RobustSettings | None = None, seed: int = 0, positions=None) -> State:
    """The first start, or `positions` (N, D), metres. Raises InputError where the modes show too few directions."""
    settings = RobustSettings() if settings is None else settings
    M, N = problem.pressures[: settings.modes].shape
    x = np.zeros((N, problem.array_dimension)) if positions is None else np.asarray(positions, float)
    empty = State(x, np.zeros((N, 2)), np.zeros((N, 2)), None, settings, seed)
    if positions is not None:
        return _begin_attempt(problem, empty, x)
    kind, lowest = starts.plan(problem, M)[0]
    return _begin_attempt(problem, empty, starts.start(problem, M, kind, lowest))


def step(problem: Problem, state: State) -> State:
    """`state` after one damped step; unchanged if finished."""
    if state.finished:
        return state
    row = SCHEDULE[state.row]
    used = supposing.used_modes(problem, state, row.modes)
    goal = supposing.objective(problem, state, used)
    free = _free(problem, state)
    furthest = state.settings.stride * 2 * np.pi / float(np.real(problem.wavenumbers[used]).max())
    trial = damped_step(state.positions, state.gains, goal, free, state.damping, furthest, not len(problem.known))
    moved = replace(
        state,
        positions=frozen_array(trial.positions, float),
        gains=trial.gains,
        step=state.step + 1,
        stage_steps=state.stage_steps + 1,
        damping=trial.damping,
        cost=trial.cost,
    )
    if trial.terms is None:
        return _end_attempt(problem, moved, np.inf, False)
    moved = supposing.with_power(moved, used, goal.field, trial.terms)
    settled = trial.moved < row.settled or trial.fall < row.negligible
    if row.gains and state.settings.gains != "fixed":
        moved = supposing.centred(supposing.with_spreads(problem, moved, trial.free, trial.matrix))
        settled = settled and supposing.same_spreads(state.model, moved.model)
    if settled or moved.stage_steps >= row.steps:
        return _end_row(problem, moved, goal.field, trial, settled)
    return moved


def _free(problem: Problem, state: State):
    """Directions in which the row lets the parameters move."""
    row = SCHEDULE[state.row]
    gains = row.gains and state.settings.gains != "fixed"
    bends = initial_positions.bends(state.shape, np.zeros(0, int), row.degree) if row.degree else None
    return free_basis(state.positions, bends, gains, gains)


def _begin_attempt(problem: Problem, state: State, positions) -> State:
    N = len(positions)
    zero = np.zeros((N, 2))
    begun = replace(state, positions=frozen_array(positions, float), gains=zero, offsets=zero, row=0, rounds=0)
    begun = replace(begun, model=supposing.first_model(problem, begun))
    return _begin_row(problem, supposing.with_noise(problem, replace(begun, shape=begun.positions)), 0)


def _begin_row(problem: Problem, state: State, row: int) -> State:
    damping = 1e-3 if SCHEDULE[row].degree else 1e-6
    return replace(state, row=row, stage=state.stage + 1, stage_steps=0, damping=damping, shape=state.positions)


def _end_row(problem: Problem, state: State, chosen, trial, settled: bool) -> State:
    """The next row, another round of the same, or the end of the attempt."""
    row = SCHEDULE[state.row]
    if row.name == "final":
        return _end_final(problem, state, settled)
    before = state.model.share
    kernel = supposing.kernel_of(problem, state, False) if not row.degree else "diffuse"
    state = replace(state, model=replace(state.model, kernel=kernel), shape=state.positions)
    ahead = replace(state, row=state.row + 1) if row.degree else state
    state = replace(supposing.with_noise(problem, ahead, rough=row.name != "gains"), row=state.row)
    if row.degree:
        state = _relocated(problem, state)[0] if state.row == 1 else state
        return _begin_row(problem, state, state.row + 1)
    state, moved = _relocated(problem, state) if state.rounds <= MOST_SEARCHES else (state, False)
    if row.name == "free":
        return _begin_row(problem, state, state.row + 1)
    k = float(np.real(problem.wavenumbers[supposing.modes_of(problem, state)]).max())
    rough = (k * state.model.spread) ** 2 / problem.dimension > state.model.share
    same = abs(np.log(state.model.share / before)) < SETTLED_NOISE
    if (same and not rough and not moved) or state.rounds + 1 >= state.settings.rounds:
        return _end_attempt(problem, state, supposing.score(problem, state, chosen, trial), settled)
    return _begin_row(problem, replace(state, rounds=state.rounds + 1), state.row)


def _relocated(problem: Problem, state: State) -> tuple[State, bool]:
    """Channels that do not fit, elsewhere or with another gain."""
    used = supposing.used_modes(problem, state, SEARCH_MODES)
    m = state.model
    x, gains, offsets, tau, moved = outliers.relocate(
        state.positions,
        state.gains,
        state.offsets,
        problem.pressures[used],
        problem.wavenumbers[used],
        m.power[used],
        m.noise[used],
        m.channel_noise,
        problem.dimension,
    )
    if not moved:
        return state, False
    model = replace(m, channel_noise=tau)
    elsewhere = replace(state, positions=frozen_array(x, float), gains=gains, offsets=offsets, model=model)
    return supposing.with_noise(problem, elsewhere, rough=state.row < 3), True


def _end_attempt(problem: Problem, state: State, score: float, settled: bool) -> State:
    """Another attempt, or the last stage from the likeliest end."""
    end = End(state.positions, state.gains, state.offsets, state.model, float(score), settled)
    state = replace(state, ends=(*state.ends, end))
    M = len(problem.pressures[: state.settings.modes])
    plan = starts.plan(problem, M)[: state.settings.attempts]
    if not _agreed(problem, state):
        for attempt in range(state.attempt + 1, len(plan)):
            try:
                x = starts.start(problem, M, *plan[attempt])
            except (InputError, np.linalg.LinAlgError):
                continue
            return _begin_attempt(problem, replace(state, attempt=attempt), x)
    return _begin_final(problem, state)


def _agreed(problem: Problem, state: State) -> bool:
    """Whether two attempts ended in the same place, and none better."""
    ends = sorted(state.ends, key=lambda end: end.score)
    if len(ends) < 2 or not np.isfinite(ends[1].score) or ends[1].score - ends[0].score > SAME_SCORE:
        return False
    wavelength = 2 * np.pi / float(np.real(problem.wavenumbers[supposing.modes_of(problem, state)]).max())
    other = align(ends[1].positions, ends[0].positions)
    sound = ends[0].model.channel_noise < outliers.SUSPICIOUS
    return bool(np.sqrt(np.mean((other - ends[0].positions)[sound] ** 2)) < SAME_PLACE * wavelength)


def _begin_final(problem: Problem, state: State) -> State:
    best = min(state.ends, key=lambda end: end.score)
    state = replace(
        state,
        positions=best.positions,
        gains=best.gains,
        offsets=best.offsets,
        model=best.model,
        shape=best.positions,
        rounds=0,
    )
    return _refined(problem, state)


def _refined(problem: Problem, state: State) -> State:
    """A round of the last stage: kernel and noise anew; the near kernel only where it leaves much less unexplained."""
    plain = _with_kernel(problem, state, state.model.kernel, 1.0)
    if state.model.kernel != "near" and supposing.kernel_of(problem, plain, True) == "near":
        near = _with_kernel(problem, state, "near", NEAR_DEFLATION)
        plain = near if near.model.share < NEAR_GAIN * plain.model.share else plain
    elif state.model.kernel == "near":
        plain = _with_kernel(problem, state, "near", NEAR_DEFLATION)
    return _begin_row(problem, plain, len(SCHEDULE) - 1)


def _with_kernel(problem: Problem, state: State, kernel: str, deflation: float) -> State:
    chosen = replace(state, model=replace(state.model, kernel=kernel), shape=state.positions)
    return supposing.with_noise(problem, chosen, deflation, rough=False)


def _end_final(problem: Problem, state: State, settled: bool) -> State:
    before = state.model.share, state.model.kernel
    again = _refined(problem, replace(state, rounds=state.rounds + 1))
    changed = abs(np.log(again.model.share / before[0])) > SETTLED_NOISE or again.model.kernel != before[1]
    if changed and again.rounds < MOST_FINAL:
        return again
    return _finished(problem, state, settled)


def _finished(problem: Problem, state: State, settled: bool) -> State:
    x = state.positions if problem.frame is None else place(state.positions, problem.frame)
    x = _anchored(problem, state) if len(problem.known) else x
    return replace(state, positions=frozen_array(x, float), finished=True, converged=settled)


def _anchored(problem: Problem, state: State) -> np.ndarray:
    """Positions moved as a whole onto the given ones, which the pressures leave open; outliers among them left out.

    Where hardly any noise is left the last steps do not see the weak pull of the given positions.
    """
    x, known, places = state.positions, problem.known, problem.known_positions
    away = np.linalg.norm(x[known] - places, axis=1)
    near = away <= max(OUTLIER * float(np.median(away)), OUTLIER * state.model.known_sigma)
    if np.sum(near) <= x.shape[1] or not fixes_gauge(places[near]):
        return x
    moved = starts.onto(x, known[near], places[near])
    before, after = (np.sum((y[known[near]] - places[near]) ** 2) for y in (x, moved))
    return moved if after < before else x
