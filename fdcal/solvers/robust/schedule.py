"""The beginning of a run, and what follows a stage: the next stage, another round, another restart, or the end.

    search    fits starts from low to high frequencies (`search`)
    restart   begins at one of the most likely arrays: stage "free", then stage "gains" in several rounds
    final     begins at the most likely optimum and takes several rounds; then the run ends

`after_stage` decides what follows a stage.
"""

from dataclasses import dataclass, replace

import numpy as np

from ...model.gauge import move_to_frame
from ...model.problem import Problem
from ...model.settings import SolverSettings
from ...model.validation import frozen_array
from .. import starts
from ..interface import CONTRADICTION
from . import given, noise, search, windows
from . import objective as objectives
from .channels import relocated
from .spread import Claim, claim_of
from .stages import begin_restart, begin_stage
from .state import DIRECTION_UPDATES, FINAL, SEARCH, STAGES, LocalOptimum, StageProgress, State


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
        stage=-1,  # `begin_stage` and `search.begin` add 1
        last=settings.modes,
        gains=np.zeros((N, 2)),
        offsets=np.zeros((N, 2)),
        model=objectives.first_model(problem, settings),
        progress=StageProgress(restart=-1, stage=SEARCH, rounds=0, steps=0, damping=0.0),
        stage_start=here,
        starts=None,
        optima=(),
    )
    return search.begin(problem, empty) if positions is None else begin_restart(problem, empty, here)


def next_restart(problem: Problem, state: State) -> State:
    """Return the beginning of the next part of a run.

    If there was no search yet, the search begins. Otherwise a restart begins at the most likely of the remaining
    starts or, if none remains, the last stage begins.
    """
    if state.starts is None:
        return search.begin(problem, state)
    if not state.starts:
        # The last stage begins at the most likely optimum, because directions can only be learned reliably there.
        best = likeliest(state)
        progress = replace(state.progress, rounds=0, stage=FINAL)
        state = replace(state, positions=best.positions, stage_start=best.positions, model=best.model)
        state = replace(state, gains=best.gains, offsets=best.offsets, progress=progress)
        state = noise.with_silent_inside(problem, relocated(problem, state, local=True)[0])
        return refined(problem, noise.with_last_field(problem, given.resolved(problem, state)))
    first, *others = state.starts
    return begin_restart(problem, replace(state, starts=tuple(others)), first.positions)


def likeliest(state: State) -> LocalOptimum:
    """Return the optimum with the lowest score."""
    return min(state.optima, key=lambda one: one.score)


def refined(problem: Problem, state: State) -> State:
    """Return the beginning of a round of the last stage, with a new estimate of the noise.

    Directions and filters are estimated as well if the state has none.
    """
    here = replace(state, stage_start=state.positions)
    begun = begin_stage(problem, noise.with_noise(problem, here, rough=False), FINAL)
    if begun.model.directions is None:
        begun = noise.with_directions(problem, begun, objectives.used_modes(problem, begun), DIRECTION_UPDATES)
    return noise.with_filters(problem, begun)


def finished(problem: Problem, state: State) -> State:
    """Return the last state of a run: the array is moved into its frame, and the directions are learned there."""
    framed = state.positions if problem.frame is None else move_to_frame(state.positions, problem.frame)
    positions = given.anchored(problem, state) if problem.frame is None else frozen_array(framed, float)
    ended = replace(state, positions=positions, stage_start=positions, finished=True)
    return noise.with_directions(problem, ended, objectives.used_modes(problem, ended), DIRECTION_UPDATES)


@dataclass(frozen=True)
class StageEnd:
    """The end of a stage."""

    problem: Problem
    state: State
    objective: objectives.Objective  # what the last step minimised
    trial: objectives.ChannelStep  # the last step; without `terms` if a covariance was singular
    within_tolerance: bool  # whether the last step changed hardly anything


NOISE_TOLERANCE = 0.15  # if the logarithm of the noise changes by less than this, no further round follows
MAX_ROUNDS = 8  # largest number of rounds of stage "gains" in one restart, and of stage "final"


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
    estimated = replace(state, model=model, stage_start=state.positions)
    estimated = noise.with_noise(problem, estimated, rough=name == "free")
    searched, moved = relocated(problem, estimated)
    searched = noise.with_silent_inside(problem, searched)
    if name == "free":
        return begin_stage(problem, searched, stage + 1)
    # Another round follows if a channel was moved, if the noise has changed, or if the position error adds more to the
    # residual than the noise does.
    k = float(np.real(problem.wavenumbers[searched.modes]).max())
    rough = (k * searched.model.spread) ** 2 / problem.dimension > searched.model.noise_fraction
    change = abs(np.log(searched.model.noise_fraction / state.model.noise_fraction))
    rounds = state.progress.rounds + 1
    if rounds >= MAX_ROUNDS or (not moved and not rough and change < NOISE_TOLERANCE):
        return _after_restart(replace(end, state=searched))
    ahead = replace(searched, progress=replace(searched.progress, rounds=rounds))
    return begin_stage(problem, noise.with_filters(problem, ahead), stage)


def _after_restart(end: StageEnd) -> State:
    """Return the beginning of the next restart or of the last stage, with the optimum of this restart added."""
    problem, state, reached = end.problem, end.state, np.inf  # an optimum with a singular covariance ranks last
    if end.trial.terms is not None:
        reached = noise.score(problem, state, end.objective, end.trial)
    converged = bool(end.within_tolerance and np.isfinite(reached))
    found = LocalOptimum(state.positions, state.gains, state.offsets, state.model, reached, converged)
    return next_restart(problem, replace(state, optima=(*state.optima, found)))


def _next_final(end: StageEnd) -> State:
    """Return another round if noise, field or given positions changed or the stage did not converge, else the end.

    The short windows of the recordings determine small arrays far better than the long rows; they are used from the
    second round on. The damping of the waves is modelled as soon as the noise is low enough.
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
    """Return the last stage with a term of the short windows, at the array that they determine.

    The result is None if the windows do not determine the array. The likelihood of the long rows is divided by a factor
    that makes its weight agree with the covariance that the result states for these rows. This factor is computed at
    the array of the windows, where the noise can be a hundredth of that at the array of the rows.
    """
    model = state.model
    counted = model.noise_fraction * model.channel_noise < windows.MAX_NOISE
    if model.delay_sigma == 0:  # otherwise all delays are free, and also absorb position errors of healthy channels
        counted &= np.abs(model.filters[:, 0]) < windows.MAX_DELAY
    flat = windows.must_be_flat(state.positions)
    if not windows.usable(problem, state.positions, counted, flat):
        return None
    claim = _claim_of_rows(problem, state)
    if flat and windows.flat_evidence(state.positions, claim.spread.covariance) < windows.FLAT_NATS:
        return None
    term = windows.window_term(problem, state.positions, state.offsets[:, 1], counted, flat)
    if term is None:
        return None
    ratio = term.disagreement(state.positions, claim.spread.covariance)
    # If a microphone is far apart in the two estimates, they belong to different arrays, and either may be right.
    away = np.linalg.norm(term.laid_on(state.positions).positions - state.positions, axis=1)
    elsewhere = ratio > CONTRADICTION and bool(away[counted].max() > windows.APART / windows.LOW_BAND)
    fitted = replace(
        model,
        window_positions=term.positions,
        window_precision=term.precision / ratio,
        window_rival=state.positions if elsewhere else term.rival,
        window_ratio=ratio,
        tempering=claim.excess * ratio,
        # So far the long rows had too much weight. Delays that were found with this weight may be wrong and contradict
        # the arrival times. `refined` seeks delays again, with the new weight.
        delay_sigma=0.0,
        corner_sigma=0.0,
        filters=np.zeros_like(model.filters),
    )
    # With given positions, the array is already in the right basin and in their frame.
    x = state.positions if len(problem.known) else frozen_array(term.positions, float)
    progress = replace(state.progress, rounds=0, steps=0)
    placed = refined(problem, replace(state, positions=x, stage_start=x, model=fitted, progress=progress))
    tempering = _claim_of_rows(problem, placed).excess * ratio
    return replace(placed, model=replace(placed.model, tempering=tempering))


def _claim_of_rows(problem: Problem, state: State) -> Claim:
    """Return the claim of the long rows alone.

    It excludes the given positions, which help to determine the array and would hide how unreliable the pressures are.
    """
    alone = replace(state.model, contradicted=np.zeros(0, bool), places=np.zeros((0, problem.array_dimension)))
    alone = replace(alone, window_positions=None, tempering=1.0)
    return claim_of(starts.without_given(problem), replace(state, model=alone))
