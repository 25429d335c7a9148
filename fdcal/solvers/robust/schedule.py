"""Where a run begins, and what follows a stage: the next one, another round, another restart, or the end.

    search    starts, each fitted from low to high frequencies, until several end at the likeliest array
    restart   from one of the likeliest of them: the stages free, and gains in several rounds
    final     in several rounds from the likeliest optimum; then the run ends

`after_stage` decides what follows a stage.
"""

from dataclasses import dataclass, replace

import numpy as np

from ...model.gauge import align, move_to_frame
from ...model.problem import Problem
from ...model.settings import SolverSettings
from ...model.validation import InputError, frozen_array
from .. import starts
from . import given, noise, windows
from . import objective as objectives
from .channels import relocated
from .spread import claim_of
from .state import (
    DIRECTION_UPDATES,
    FINAL,
    FREE,
    GAINS,
    SEARCH,
    STAGE_DAMPING,
    STAGES,
    FittedStart,
    LocalOptimum,
    StageProgress,
    State,
)

MAX_RESTARTS = 4  # different starts that are refined at most
# starts that end at the likeliest array, after which no other is tried; with 3, two of 18 field cases are lost
AGREEING = 4
WORSE = 100.0  # nats; a start that is less likely by more is not refined
# two arrays are different if some healthy microphone stands further apart in them, in units of the shortest wavelength
DIFFERENT = 0.02


def begin(
    Kind: type[State], problem: Problem, settings: SolverSettings, seed: int, positions: np.ndarray | None
) -> State:
    """Return the first state, an instance of `Kind`, at the first start or at `positions` (N, D), metres."""
    problem, N = objectives.in_unit_power(problem), problem.pressures.shape[1]
    here = np.zeros((N, problem.array_dimension)) if positions is None else np.array(positions, float)
    empty = Kind(
        positions=here,
        settings=settings,
        seed=seed,
        stage=-1,  # `begin_stage` adds 1
        last=settings.modes,
        gains=np.zeros((N, 2)),
        offsets=np.zeros((N, 2)),
        model=objectives.first_model(problem, settings),
        progress=StageProgress(restart=-1, stage=SEARCH, rounds=0, steps=0, damping=0.0),
        shape=here,
        starts=None,
        optima=(),
    )
    return begin_search(problem, empty) if positions is None else begin_restart(problem, empty, here)


def begin_search(problem: Problem, state: State) -> State:
    """Return `state` at the first start that can be computed, before its fit; InputError if there is none."""
    plan = starts.plan(problem, state.last)
    for number, one in enumerate(plan):
        try:
            x = start_at(problem if one.given else starts.without_given(problem), state, one)
        except (InputError, np.linalg.LinAlgError):  # the modes do not determine this start
            if number + 1 < len(plan):
                continue
            raise
        x = in_frame(problem, state.settings, x, one.given)
        progress = replace(state.progress, stage=SEARCH, rounds=0, steps=number)
        return replace(state, stage=state.stage + 1, positions=x, shape=x, starts=(), progress=progress)
    raise AssertionError("a plan has one start at least")


def start_at(problem: Problem, state: State, one: starts.Start) -> np.ndarray:
    """Return the positions (N, D), metres, of a start; InputError or LinAlgError if the modes do not determine it."""
    reported = noise.given_noise(problem, state)
    return starts.start(problem, state.last, None if reported is None else float(np.median(reported[state.modes])), one)


def begin_stage(problem: Problem, state: State, stage: int) -> State:
    """Return `state` at the beginning of a stage of the schedule."""
    progress = replace(state.progress, stage=stage, steps=0, damping=STAGE_DAMPING)
    if state.model.arrival_sigma is None:
        state = noise.with_arrivals(problem, state)
    return replace(state, stage=state.stage + 1, progress=progress, shape=state.positions)


def begin_restart(problem: Problem, state: State, positions: np.ndarray) -> State:
    """Return `state` at the beginning of a restart at `positions` (N, D), metres."""
    x, zero = in_frame(problem, state.settings, positions), frozen_array(np.zeros((len(positions), 2)), float)
    model = objectives.first_model(problem, state.settings)
    progress = StageProgress(restart=state.restart + 1, stage=FREE, rounds=0, steps=0, damping=0.0)
    begun = replace(state, positions=x, shape=x, gains=zero, offsets=zero, model=model, progress=progress)
    return begin_stage(problem, noise.with_noise(problem, begun), FREE)


def in_frame(problem: Problem, settings: SolverSettings, positions: np.ndarray, placed: bool = True) -> np.ndarray:
    """Return positions (N, D), metres, in the frame of the problem; exact given ones pull the others smoothly along.

    placed : whether the positions agree with the given ones already; otherwise the array is first aligned with these
    """
    x, known, places = positions, problem.known, problem.known_positions
    if len(known) and not placed:
        x = starts.aligned(problem, x)
    if problem.frame is not None:
        x = move_to_frame(x, problem.frame)
    if len(known) and objectives.first_known_sigma(problem, settings) == 0:
        x = x + objectives.interpolation(x, known) @ (places - x[known])
        x[known] = places
    return frozen_array(x, float)


# longest move of a microphone in one step, in shortest wavelengths; without it the error of a linear array in space
# grows from 1.3 to 2.1 mm
MAX_STEP = 0.125


def moved_once(
    problem: Problem, state: State, used: np.ndarray
) -> tuple[State, objectives.Objective, objectives.ChannelStep]:
    """Return `state` after one damped step and one update of power, noise and spreads, what it minimised, and the step.

    Where a covariance is singular, the state moves nowhere, and the step has no `terms`.
    """
    here, progress = objectives.unknowns_of(state), state.progress
    objective = objectives.objective_of(problem, state, used)
    max_step = MAX_STEP * 2 * np.pi / float(np.real(problem.wavenumbers[used]).max())
    trial = objectives.channel_step(here, objective, objective.free(here), progress.damping, max_step)
    moved = replace(
        objectives.with_unknowns(state, trial.unknowns),
        step=state.step + 1,
        sweep=state.sweep + 1,
        cost=trial.cost if np.isfinite(trial.cost) else state.cost,
        progress=replace(progress, steps=progress.steps + 1, damping=trial.damping),
    )
    if trial.terms is not None:
        moved = noise.with_power(moved, used, objective.field, trial.terms)
        moved = noise.with_directions(problem, moved, used, DIRECTION_UPDATES)
        if here.gains:
            moved = noise.centred(noise.with_spreads(problem, moved, trial))
        if moved.model.arrival_sigma is not None:
            moved = noise.with_arrival_sigma(problem, moved, trial)
    return moved, objective, trial


FIT_STEPS = 6  # steps at each number of modes in `continued` at most
FIT_PRESSURES = 4000  # approximate number of pressures in a fit; evenly spaced modes are used where there are more
FIT_MODES = 24  # least number of modes in a fit, if there are as many
FIT_TOLERANCE = 3e-3  # metres; a fit ends when no coordinate moves further
FIT_NATS = 1.0  # a fit also ends when the cost falls by less


def continued(problem: Problem, state: State, positions: np.ndarray, lowest: int) -> tuple[State, float]:
    """Return `state` at positions fitted to the `lowest` modes, then to more and more, and its -log likelihood.

    At low frequency the cost has few local minima; each fit begins in the basin of the one before. With all modes gains
    and gross faults of the channels are sought too, twice, since the first of these fits assumes too much noise.
    """
    here, last = begin_restart(problem, state, positions), state.last
    cap = max(FIT_MODES, FIT_PRESSURES // len(positions))
    for count in (*(n for i in range(32) if (n := lowest * 2**i) < last), last, last):
        stage = FREE if count < last else GAINS
        here = replace(here, last=count, progress=replace(here.progress, stage=stage))
        here = begin_stage(problem, noise.with_noise(problem, here), stage)
        if count == last:
            here = relocated(problem, here)[0]
        for _ in range(FIT_STEPS):
            here, _, trial = moved_once(problem, here, objectives.used_modes(problem, here, cap))
            if trial.moved < FIT_TOLERANCE or trial.decrease < FIT_NATS:
                break
    used = objectives.used_modes(problem, here, cap)
    objective = objectives.objective_of(problem, here, used)
    cost = replace(objective, priors=objective.priors.without_given()).finite_cost(objectives.unknowns_of(here))
    cost += noise.hyper_cost(objective.field, objectives.corrected(problem, here, used))
    return here, cost + len(positions) * float(np.log(here.model.gain_sigma * here.model.phase_sigma))


def search(problem: Problem, state: State) -> State:
    """Return `state` after the fit of another start, at the likeliest so far, or the first restart after the last one.

    No further start is tried when `AGREEING` of them end at the likeliest array. Starts without given positions are
    aligned with these afterwards, so that a wrong given position deforms none of them. InputError if no start can be
    computed.
    """
    plan = starts.plan(problem, state.last)
    found: tuple[FittedStart, ...] = state.starts or ()
    for number in range(state.progress.steps, len(plan)):
        one = plan[number]
        chosen = problem if one.given else starts.without_given(problem)
        try:
            ended, cost = continued(chosen, state, start_at(chosen, state, one), one.lowest)
        except (InputError, np.linalg.LinAlgError):  # the modes do not determine this start
            if found or number + 1 < len(plan):
                continue
            raise
        ended = noise.with_silent_inside(chosen, ended)
        x = in_frame(problem, state.settings, ended.positions, one.given)
        fitted = FittedStart(x, noise.healthy(ended.model), cost)
        found = tuple(sorted((*found, fitted), key=lambda one: one.cost))
        best, progress = min(found, key=lambda one: one.cost), replace(state.progress, steps=number + 1)
        if sum(same_array(problem, best, other.positions) for other in found) >= AGREEING:
            break
        if number + 1 < len(plan):
            return replace(state, positions=best.positions, shape=best.positions, starts=found, progress=progress)
    different, limit = list[FittedStart](), min(one.cost for one in found) + WORSE
    for one in found:
        likely = len(different) < MAX_RESTARTS and one.cost < limit
        if likely and not any(same_array(problem, one, other.positions) for other in different):
            different.append(one)
    return next_restart(problem, replace(state, starts=tuple(different)))


def same_array(problem: Problem, one: FittedStart, positions: np.ndarray) -> bool:
    """Return whether the healthy channels of a start, at least half of all, stand as in `positions` (N, D), metres."""
    apart = np.linalg.norm(align(one.positions, positions) - positions, axis=1)[one.healthy]
    shortest = 2 * np.pi / float(np.real(problem.wavenumbers).max())
    return bool(2 * len(apart) >= len(positions) and apart.max() < DIFFERENT * shortest)


def next_restart(problem: Problem, state: State) -> State:
    """Return a restart at the likeliest start that is left, or the last stage; first the search, if there was none."""
    if state.starts is None:
        return begin_search(problem, state)
    if not state.starts:
        return begin_final(problem, state)
    first, *others = state.starts
    return begin_restart(problem, replace(state, starts=tuple(others)), first.positions)


def likeliest(state: State) -> LocalOptimum:
    """Return the optimum with the lowest score."""
    return min(state.optima, key=lambda one: one.score)


def begin_final(problem: Problem, state: State) -> State:
    """Begin the last stage at the likeliest optimum; only there is the array good enough to learn directions."""
    best = likeliest(state)
    progress = replace(state.progress, rounds=0, stage=FINAL)
    at_best = replace(state, positions=best.positions, shape=best.positions, gains=best.gains, offsets=best.offsets)
    state = replace(at_best, model=best.model, progress=progress)
    state = noise.with_silent_inside(problem, relocated(problem, state, local=True)[0])
    state = given.resolved(problem, state)
    return refined(problem, noise.with_last_field(problem, state))


def refined(problem: Problem, state: State) -> State:
    """Return the beginning of a round of the last stage, with new noise and directions; filters are sought again."""
    begun = begin_stage(problem, noise.with_noise(problem, replace(state, shape=state.positions), rough=False), FINAL)
    updates = DIRECTION_UPDATES if begun.model.directions is None else 0
    begun = noise.with_directions(problem, begun, objectives.used_modes(problem, begun), updates)
    return noise.with_filters(problem, begun)


def finished(problem: Problem, state: State) -> State:
    """Return the last state of a run: the array is moved into its frame, and the directions are learned there."""
    framed = state.positions if problem.frame is None else move_to_frame(state.positions, problem.frame)
    positions = given.anchored(problem, state) if problem.frame is None else frozen_array(framed, float)
    ended = replace(state, positions=positions, shape=positions, finished=True)
    return noise.with_directions(problem, ended, objectives.used_modes(problem, ended), DIRECTION_UPDATES)


@dataclass(frozen=True)
class StageEnd:
    """The end of a stage."""

    problem: Problem
    state: State
    objective: objectives.Objective  # what the last step minimised
    trial: objectives.ChannelStep  # the last step; without `terms` where a covariance was singular
    within_tolerance: bool  # whether the last step changed hardly anything


NOISE_TOLERANCE = 0.15  # change of the logarithm of the noise below which no further round follows
MAX_ROUNDS = 8  # rounds of stage "gains" in one restart, and of stage "final", at most


def after_stage(end: StageEnd) -> State:
    """Return the state after the end of a stage: in another round, stage or restart, or at the end of the run."""
    problem, state, stage = end.problem, end.state, end.state.progress.stage
    name, singular = STAGES[stage].name, end.trial.terms is None
    if singular and name != "final":
        return _after_restart(end)
    if singular or not state.automatic:  # the user has chosen the modes, or the last stage cannot go on
        return replace(state, finished=True, converged=end.within_tolerance)
    if name == "final":
        return _next_final(end)
    model = replace(state.model, damped=noise.is_damped(problem, state), directional=False)
    estimated = replace(state, model=model, shape=state.positions)
    estimated = noise.with_noise(problem, estimated, rough=name == "free")
    searched, moved = relocated(problem, estimated)
    searched = noise.with_silent_inside(problem, searched)
    if name == "free":
        return begin_stage(problem, searched, stage + 1)
    # Another round follows if a channel was moved, if the noise has changed, or if the error of the positions adds
    # more to the residual than the noise does.
    k = float(np.real(problem.wavenumbers[searched.modes]).max())
    rough = (k * searched.model.spread) ** 2 / problem.dimension > searched.model.noise_fraction
    change = abs(np.log(searched.model.noise_fraction / state.model.noise_fraction))
    rounds = state.progress.rounds + 1
    if rounds >= MAX_ROUNDS or (not moved and not rough and change < NOISE_TOLERANCE):
        return _after_restart(replace(end, state=searched))
    ahead = replace(searched, progress=replace(searched.progress, rounds=rounds))
    return begin_stage(problem, noise.with_filters(problem, ahead), stage)


def _after_restart(end: StageEnd) -> State:
    """Return the state after a restart, with its optimum added: in the last stage, or in the next restart."""
    problem, state, reached = end.problem, end.state, np.inf  # an optimum with a singular covariance ranks last
    if end.trial.terms is not None:
        reached = noise.score(problem, state, end.objective, end.trial)
    converged = bool(end.within_tolerance and np.isfinite(reached))
    found = LocalOptimum(state.positions, state.gains, state.offsets, state.model, reached, converged)
    return next_restart(problem, replace(state, optima=(*state.optima, found)))


def _next_final(end: StageEnd) -> State:
    """Return another round of the last stage if noise, field or given positions have changed, or else the end.

    The short windows of the recordings determine small arrays far better; they count from the second round on. The
    damping of the waves counts from the round on in which the noise is low enough.
    """
    problem, state, progress = end.problem, end.state, end.state.progress
    if state.model.window_positions is None and (with_term := with_windows(problem, state)) is not None:
        return with_term
    model, ahead = state.model, replace(progress, rounds=progress.rounds + 1)
    if model.directional and noise.is_damped(problem, state):
        model = replace(model, damped=True)
    again = refined(problem, given.resolved(problem, replace(state, model=model, progress=ahead)))
    a, b = state.model, again.model
    change = abs(np.log(float(np.median(b.noise)) / float(np.median(a.noise))))
    changed = a.damped != b.damped or bool(change > NOISE_TOLERANCE) or not given.same_given(state, again)
    changed = changed or not (end.within_tolerance or objectives.is_converged(problem, state))
    return again if changed and again.progress.rounds < MAX_ROUNDS else finished(problem, state)


def with_windows(problem: Problem, state: State) -> State | None:
    """Return the last stage with a term of the short windows, at the array that they show; None where they show none.

    The likelihood of the long rows is then divided so that it weighs as much as the covariance of the result says.
    """
    if problem.windows is None:
        return None
    model = state.model
    heard = model.noise_fraction * model.channel_noise < windows.MAX_NOISE
    if model.delay_sigma == 0:  # with all delays free, errors of a small array appear as delays of its channels
        heard &= np.abs(model.filters[:, 0]) < windows.MAX_DELAY
    if not windows.usable(problem, state.positions, heard):
        return None
    term = windows.window_term(problem, state.positions, state.offsets[:, 1], heard)
    if term is None:
        return None
    # Given positions determine the array beside the pressures, and would hide how unreliable these are.
    no_given = replace(model, contradicted=np.zeros(0, bool), places=np.zeros((0, problem.array_dimension)))
    claim = claim_of(starts.without_given(problem), replace(state, model=no_given))
    ratio = term.disagreement(state.positions, claim.spread.covariance)
    fitted = replace(
        model,
        window_positions=term.positions,
        window_precision=term.precision / ratio,
        window_ratio=ratio,
        tempering=model.tempering * claim.excess * ratio,
        # Before, the long rows weighed too much: delays found then may be false, and compete with the arrival times.
        # `refined` looks for delays again, with the new weight.
        delay_sigma=0.0,
        corner_sigma=0.0,
        filters=np.zeros_like(model.filters),
    )
    # With given positions the array is already in the right basin and in their frame.
    x = state.positions if len(problem.known) else frozen_array(term.positions, float)
    progress = replace(state.progress, rounds=0, steps=0)
    return refined(problem, replace(state, positions=x, shape=x, model=fitted, progress=progress))
