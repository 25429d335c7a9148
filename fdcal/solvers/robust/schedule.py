"""Where a run begins, and what follows a stage: the next one, another round, another restart, or the end.

deformation, deformation, free, gains (rounds)    one restart, from one start
another restart                                   until two agree, or one explains all
final (rounds)                                    from the likeliest optimum, then the end

What follows which stage, and on what condition, stands in one table at the end, `TRANSITIONS`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

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

BEFORE_PLAN = -1  # number of the restart at positions that a run is begun with: every start of the plan follows it


def begin(
    Kind: type[State], problem: Problem, settings: SolverSettings, seed: int, positions: np.ndarray | None
) -> State:
    """Return the first state, of the class of a preset, at the first start or at `positions` (N, D), metres."""
    problem, N = objectives.in_unit_power(problem), problem.pressures.shape[1]
    here = np.zeros((N, problem.array_dimension)) if positions is None else np.asarray(positions, float)
    empty = Kind(
        positions=here,
        settings=settings,
        seed=seed,
        stage=-1,  # `begin_stage` counts the first
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
    """Return positions (N, D), metres, with those that are given exactly in place, and the others moved along."""
    known, places = problem.known, problem.known_positions
    if not len(known) or objectives.first_known_sigma(problem, settings) > 0:
        return positions
    x = positions + objectives.interpolation(positions, known) @ (places - positions[known])
    x[known] = places
    return x


MAX_RESTARTS = 6  # starts tried at most


def next_restart(problem: Problem, state: State, restart: int) -> State:
    """Return the first restart, from number `restart` on, that has a start, or the last stage if there is none left."""
    reported = noise.given_noise(problem, state)
    level = None if reported is None else float(np.median(reported[state.modes]))
    plan = starts.plan(problem, state.last, state.quick)
    for number, one in enumerate(plan[:MAX_RESTARTS]):
        if number < restart:
            continue
        try:
            positions = starts.start(problem, state.last, level, *one)
        except (InputError, np.linalg.LinAlgError):  # this start needs more than the modes show
            if state.optima or number + 1 < MAX_RESTARTS:
                continue
            raise
        return begin_restart(problem, state, positions, number)
    return begin_final(problem, state)


def likeliest(state: State) -> LocalOptimum:
    """Return the optimum of the least score."""
    return min(state.optima, key=lambda one: one.score)


# distance of every microphone in one optimum from its place in another, over the shortest wavelength, within which
# the two agree
SAME_PLACE = 0.03


def optima_agree(problem: Problem, state: State) -> bool:
    """Return whether another restart has ended where the likeliest did; their scores may differ by rounding."""
    best, *others = sorted(state.optima, key=lambda one: one.score)
    wavelength = 2 * np.pi / float(np.real(problem.wavenumbers[state.modes]).max())
    healthy = noise.healthy(best.model)
    for other in others:
        if np.isfinite(other.score):
            away = np.linalg.norm(align(other.positions, best.positions) - best.positions, axis=1)
            if away[healthy].max(initial=0.0) < SAME_PLACE * wavelength:
                return True
    return False


# fraction of the power, of the array and of one channel: a restart that leaves no more unexplained of a measurement
# without noise is the last; without it simulated arrays take up to twice the time
LOW_NOISE = 1e-7
LOW_CHANNEL_NOISE = 1e-5
# noise over the reported one, where channels are matched and positions exact; without it such arrays take 1.4
# times the time
REPORTED_NOISE = 1.2


def explains_all(problem: Problem, state: State) -> bool:
    """Return whether the array explains all but the reported noise by healthy channels, so that the search may end.

    Of a measurement without noise, in a wrong basin no array does so. With noise some do, so that this is evidence
    only where the model has nothing else to bend: channels are matched, and exact given positions hold the size.
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
    """Go on from the likeliest optimum; only now, with all in place, can the directions of the field be learned."""
    best = likeliest(state)
    progress = replace(state.progress, rounds=0, stage=FINAL)
    at_best = replace(state, positions=best.positions, shape=best.positions, gains=best.gains, offsets=best.offsets)
    state = replace(at_best, model=best.model, progress=progress)
    state = noise.with_silent_inside(problem, relocated(problem, state, local=True)[0])
    state = given.resolved(problem, state)
    return refined(problem, noise.with_last_field(problem, state))


def refined(problem: Problem, state: State) -> State:
    """Return the beginning of a round of the last stage, with new noise, and filters where the channels differ."""
    begun = begin_stage(problem, noise.with_noise(problem, replace(state, shape=state.positions), rough=False), FINAL)
    updates = DIRECTION_UPDATES if begun.model.directions is None else 0
    begun = noise.with_directions(problem, begun, objectives.used_modes(problem, begun), updates)
    return noise.with_filters(problem, begun)


def finished(problem: Problem, state: State) -> State:
    """Return the end of a run: the array in its frame, and the directions of the field there."""
    framed = state.positions if problem.frame is None else move_to_frame(state.positions, problem.frame)
    positions = given.anchored(problem, state) if problem.frame is None else frozen_array(framed, float)
    ended = replace(state, positions=positions, shape=positions, finished=True)
    return noise.with_directions(problem, ended, objectives.used_modes(problem, ended), DIRECTION_UPDATES)


@dataclass(frozen=True)
class Turn:
    """Where a stage has ended, or a restart."""

    problem: Problem
    place: str  # name of the stage, or "restart" where the optimum of one has been added to the state
    state: State
    objective: objectives.Objective  # what the last step minimised
    trial: objectives.ChannelStep  # that step
    within_tolerance: bool  # whether it changed hardly anything

    @cached_property
    def estimated(self) -> State:
        """The state with the noise, and the damping of an isotropic field, that it calls for."""
        damped = noise.is_damped(self.problem, self.state)
        model = replace(self.state.model, damped=damped, directional=False)
        state = replace(self.state, model=model, shape=self.state.positions)
        return noise.with_noise(self.problem, state, rough=self.place == "free")

    @cached_property
    def searched(self) -> tuple[State, bool]:
        """The state of `estimated` with outliers moved, and whether any was."""
        return relocated(self.problem, self.estimated)


def following(turn: Turn) -> State:
    """Return what follows: the first row of TRANSITIONS that applies, and the one after it where it ends a restart."""
    while True:
        after = next(then(turn) for place, when, then in TRANSITIONS if place in ("any", turn.place) and when(turn))
        if not isinstance(after, Turn):
            return after
        turn = after


def _always(turn: Turn) -> bool:
    return True


def _singular(turn: Turn) -> bool:
    return turn.trial.terms is None


NOISE_TOLERANCE = 0.15  # change of the logarithm of the noise after which a round is the last


def _noise_within_tolerance(turn: Turn) -> bool:
    """The noise has hardly changed and explains more than the error of the positions, and no outlier was moved."""
    state, moved = turn.searched
    k = float(np.real(turn.problem.wavenumbers[state.modes]).max())
    rough = (k * state.model.spread) ** 2 / turn.problem.dimension > state.model.noise_fraction
    change = abs(np.log(state.model.noise_fraction / turn.state.model.noise_fraction))
    return not moved and not rough and bool(change < NOISE_TOLERANCE)


MAX_ROUNDS = 8  # of stage "gains" at most in one restart, and of stage "final"


def _modes_chosen(turn: Turn) -> bool:
    return not turn.state.automatic


def _begin_final(turn: Turn) -> State:
    return begin_final(turn.problem, turn.state)


def _stop(turn: Turn) -> State:
    return replace(turn.state, finished=True, converged=turn.within_tolerance)


def _next_deformation(turn: Turn) -> State:
    """Begin the next stage, with the noise that its modes show; after the last deformation outliers are moved."""
    stage = turn.state.progress.stage
    state = replace(turn.state, model=replace(turn.state.model, damped=False), shape=turn.state.positions)
    ahead = replace(state, progress=replace(state.progress, stage=stage + 1))  # of whose modes the noise is
    state = replace(noise.with_noise(turn.problem, ahead), progress=state.progress)
    if not STAGES[stage + 1].degree:
        state, _ = relocated(turn.problem, state)
    return begin_stage(turn.problem, state, stage + 1)


def _next_round(turn: Turn) -> State:
    state = turn.searched[0]
    ahead = replace(state, progress=replace(state.progress, rounds=state.progress.rounds + 1))
    return begin_stage(turn.problem, noise.with_filters(turn.problem, ahead), state.progress.stage)


def _next_final(turn: Turn) -> State:
    """Return another round of the last stage if it would assume another noise, field or given positions, or the end.

    Short windows of the recordings, which determine small arrays far better, count from the second round on. Damped
    waves are taken where the noise is now so low that these count.
    """
    problem, state, progress = turn.problem, turn.state, turn.state.progress
    if state.model.window_positions is None and (beside := with_windows(problem, state)) is not None:
        return beside
    model, ahead = state.model, replace(progress, rounds=progress.rounds + 1)
    if model.directional and noise.is_damped(problem, state):
        model = replace(model, damped=True)
    again = refined(problem, given.resolved(problem, replace(state, model=model, progress=ahead)))
    a, b = state.model, again.model
    change = abs(np.log(float(np.median(b.noise)) / float(np.median(a.noise))))
    other = a.damped != b.damped or bool(change > NOISE_TOLERANCE) or not given.same_given(state, again)
    other = other or not (turn.within_tolerance or objectives.is_converged(problem, state))
    return again if other and again.progress.rounds < MAX_ROUNDS else finished(problem, state)


def with_windows(problem: Problem, state: State) -> State | None:
    """Return the last stage with the short windows of the recordings beside the long rows; None where they say nothing.

    It begins where the windows have found the array. The likelihood of the long rows then counts as much as its
    covariance claims.
    """
    if problem.windows is None:
        return None
    model = state.model
    heard = model.noise_fraction * model.channel_noise < windows.MAX_NOISE
    if model.delay_sigma == 0:  # otherwise small arrays put errors of their size into the delays of all channels
        heard &= np.abs(model.filters[:, 0]) < windows.MAX_DELAY
    if not windows.usable(problem, state.positions, heard):
        return None
    term = windows.window_term(problem, state.positions, state.offsets[:, 1], heard)
    if term is None:
        return None
    claim = claim_of(problem, state)
    ratio = term.disagreement(state.positions, claim.spread.covariance)
    fitted = replace(
        model,
        window_positions=term.positions,
        window_precision=term.precision / ratio,
        window_ratio=ratio,
        tempering=model.tempering * claim.excess * ratio,
        # Rows that count too much show delays of all channels that are none, and these take up what arrivals say of
        # the positions; `refined` looks for them again, with this weight.
        delay_sigma=0.0,
        corner_sigma=0.0,
        filters=np.zeros_like(model.filters),
    )
    # Given positions have led to the right basin, and stay in place.
    x = state.positions if len(problem.known) else frozen_array(term.positions, float)
    progress = replace(state.progress, rounds=0, steps=0)
    return refined(problem, replace(state, positions=x, shape=x, model=fitted, progress=progress))


def _ended(turn: Turn, state: State) -> Turn:
    """End a restart: add its optimum to `state`. Its score ranks it; one whose covariance is singular ranks last."""
    lost = turn.trial.terms is None
    reached = np.inf if lost else float(noise.score(turn.problem, state, turn.objective, turn.trial))
    converged = bool(turn.within_tolerance and np.isfinite(reached))
    found = LocalOptimum(state.positions, state.gains, state.offsets, state.model, reached, converged)
    return replace(turn, place="restart", state=replace(state, optima=(*state.optima, found)))


def _explained(turn: Turn) -> Turn:
    """End with the evidence at the noise found: that of the last step was far more, and any other would outdo it."""
    state = turn.estimated
    objective = objectives.objective_of(turn.problem, state, objectives.used_modes(turn.problem, state))
    cost = objective.finite_cost(turn.trial.unknowns)
    return _ended(replace(turn, objective=objective), replace(state, cost=cost))


TRANSITIONS: tuple[tuple[str, Callable[[Turn], bool], Callable[[Turn], Turn | State]], ...] = (
    # where          when                     then
    ("restart", lambda turn: optima_agree(turn.problem, turn.state), _begin_final),
    ("restart", lambda turn: explains_all(turn.problem, turn.state), _begin_final),
    ("restart", _always, lambda turn: next_restart(turn.problem, turn.state, turn.state.progress.restart + 1)),
    ("final", _singular, _stop),
    ("any", _singular, lambda turn: _ended(turn, turn.state)),
    ("any", _modes_chosen, _stop),
    ("deformation", _always, _next_deformation),
    ("free", lambda turn: explains_all(turn.problem, turn.estimated), _explained),
    ("free", _always, lambda turn: begin_stage(turn.problem, turn.searched[0], turn.state.progress.stage + 1)),
    ("gains", lambda turn: explains_all(turn.problem, turn.estimated), _explained),
    ("gains", _noise_within_tolerance, lambda turn: _ended(turn, turn.searched[0])),
    ("gains", lambda turn: turn.state.progress.rounds + 1 >= MAX_ROUNDS, lambda turn: _ended(turn, turn.searched[0])),
    ("gains", _always, _next_round),
    ("final", _always, _next_final),
)
