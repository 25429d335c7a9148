"""Where a run begins, and what follows a stage: the next one, another round, another restart, or the end.

    restart   from one start: the stages deformation, deformation, free, and gains in several rounds
    restarts  until two of them end at the same array, or one leaves no more than the reported noise
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
from .state import DIRECTION_UPDATES, FINAL, STAGE_DAMPING, STAGES, SUSPICIOUS, LocalOptimum, StageProgress, State

BEFORE_PLAN = -1  # number of a restart from positions that the caller gives; the starts of the plan follow it


def begin(
    Kind: type[State], problem: Problem, settings: SolverSettings, seed: int, positions: np.ndarray | None
) -> State:
    """Return the first state, an instance of `Kind`, at the first start or at `positions` (N, D), metres."""
    problem, N = objectives.in_unit_power(problem), problem.pressures.shape[1]
    here = np.zeros((N, problem.array_dimension)) if positions is None else np.asarray(positions, float)
    empty = Kind(
        positions=here,
        settings=settings,
        seed=seed,
        stage=-1,  # `begin_stage` adds 1
        last=settings.modes,
        gains=np.zeros((N, 2)),
        offsets=np.zeros((N, 2)),
        model=objectives.first_model(problem, settings),
        progress=StageProgress(restart=BEFORE_PLAN, stage=0, rounds=0, steps=0, damping=0.0),
        shape=here,
        optima=(),
    )
    return next_restart(problem, empty, 0) if positions is None else begin_restart(problem, empty, here, BEFORE_PLAN)


def begin_stage(problem: Problem, state: State, stage: int) -> State:
    """Return `state` at the beginning of a stage of the schedule."""
    progress = replace(state.progress, stage=stage, steps=0, damping=STAGE_DAMPING)
    if not STAGES[stage].degree and state.model.arrival_sigma is None:
        state = noise.with_arrivals(problem, state)
    return replace(state, stage=state.stage + 1, progress=progress, shape=state.positions)


def begin_restart(problem: Problem, state: State, positions: np.ndarray, restart: int) -> State:
    """Return `state` at the beginning of a restart at `positions` (N, D), metres."""
    placed = positions if problem.frame is None else move_to_frame(positions, problem.frame)
    placed = with_exact_in_place(problem, state.settings, placed)
    x, zero = frozen_array(placed, float), frozen_array(np.zeros((len(positions), 2)), float)
    model = objectives.first_model(problem, state.settings)
    progress = StageProgress(restart=restart, stage=0, rounds=0, steps=0, damping=0.0)
    begun = replace(state, positions=x, shape=x, gains=zero, offsets=zero, model=model, progress=progress)
    return begin_stage(problem, noise.with_noise(problem, begun), 0)


def with_exact_in_place(problem: Problem, settings: SolverSettings, positions: np.ndarray) -> np.ndarray:
    """Return positions (N, D), metres, with exact given positions in place, and the others moved smoothly along."""
    known, places = problem.known, problem.known_positions
    if not len(known) or objectives.first_known_sigma(problem, settings) > 0:
        return positions
    x = positions + objectives.interpolation(positions, known) @ (places - positions[known])
    x[known] = places
    return x


MAX_RESTARTS = 6  # starts tried at most


def next_restart(problem: Problem, state: State, restart: int) -> State:
    """Return the first restart from number `restart` on whose start can be computed, or else the last stage."""
    reported = noise.given_noise(problem, state)
    level = None if reported is None else float(np.median(reported[state.modes]))
    plan = starts.plan(problem, state.last, state.quick)
    for number, one in enumerate(plan[:MAX_RESTARTS]):
        if number < restart:
            continue
        try:
            positions = starts.start(problem, state.last, level, *one)
        except (InputError, np.linalg.LinAlgError):  # the modes do not determine this start
            if state.optima or number + 1 < MAX_RESTARTS:
                continue
            raise
        return begin_restart(problem, state, positions, number)
    return begin_final(problem, state)


def likeliest(state: State) -> LocalOptimum:
    """Return the optimum with the lowest score."""
    return min(state.optima, key=lambda one: one.score)


# two optima agree if each microphone has moved by less than this between them, in units of the shortest wavelength
SAME_PLACE = 0.03


def optima_agree(problem: Problem, state: State) -> bool:
    """Return whether another restart has ended at the same array as the likeliest one, whatever their scores."""
    best, *others = sorted(state.optima, key=lambda one: one.score)
    wavelength = 2 * np.pi / float(np.real(problem.wavenumbers[state.modes]).max())
    healthy = noise.healthy(best.model)
    for other in others:
        if np.isfinite(other.score):
            away = np.linalg.norm(align(other.positions, best.positions) - best.positions, axis=1)
            if away[healthy].max(initial=0.0) < SAME_PLACE * wavelength:
                return True
    return False


# Fractions of the power: for a measurement without noise the search ends with the first restart that leaves no more
# than LOW_NOISE unexplained, and no more than LOW_CHANNEL_NOISE in any channel. Without this rule simulated arrays take
# up to twice the time.
LOW_NOISE = 1e-7
LOW_CHANNEL_NOISE = 1e-5
# The search also ends where channels are matched, positions are exact, and the noise found is at most this multiple of
# the reported noise. Without this rule such arrays take 1.4 times the time.
REPORTED_NOISE = 1.2


def explains_all(problem: Problem, state: State) -> bool:
    """Return whether healthy channels leave no more than the reported noise unexplained, so that the search may end.

    Without noise no array in a wrong basin does so. With noise a wrong array can, unless the model has few other
    unknowns: then it counts only where channels are matched and exact given positions fix the size.
    """
    fraction, worst = state.model.noise_fraction, float(state.model.channel_noise.max())
    reported = noise.given_noise(problem, state)
    if reported is None:
        return False
    level = float(np.median(reported[state.modes]))
    if level <= LOW_NOISE:
        return fraction <= max(LOW_NOISE, 1.01 * state.model.min_noise) and fraction * worst <= LOW_CHANNEL_NOISE
    return state.quick and len(problem.known) > 0 and fraction <= REPORTED_NOISE * level and worst < SUSPICIOUS


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
    if name == "deformation":
        return _next_deformation(problem, state)
    if name == "final":
        return _next_final(end)
    model = replace(state.model, damped=noise.is_damped(problem, state), directional=False)
    estimated = replace(state, model=model, shape=state.positions)
    estimated = noise.with_noise(problem, estimated, rough=name == "free")
    if explains_all(problem, estimated):
        # The last step assumed far more noise than is left. The evidence is that at the noise found, so that another
        # restart, which assumed less, does not outrank this one.
        objective = objectives.objective_of(problem, estimated, objectives.used_modes(problem, estimated))
        estimated = replace(estimated, cost=objective.finite_cost(end.trial.unknowns))
        return _after_restart(replace(end, objective=objective, state=estimated))
    searched, moved = relocated(problem, estimated)
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
    state = replace(state, optima=(*state.optima, found))
    if optima_agree(problem, state) or explains_all(problem, state):
        return begin_final(problem, state)
    return next_restart(problem, state, state.progress.restart + 1)


def _next_deformation(problem: Problem, state: State) -> State:
    """Begin the next stage, with the noise that its modes show; outliers are moved before the first free stage."""
    stage = state.progress.stage
    state = replace(state, model=replace(state.model, damped=False), shape=state.positions)
    ahead = replace(state, progress=replace(state.progress, stage=stage + 1))  # selects the modes of the next stage
    state = replace(noise.with_noise(problem, ahead), progress=state.progress)
    if not STAGES[stage + 1].degree:
        state, _ = relocated(problem, state)
    return begin_stage(problem, state, stage + 1)


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
