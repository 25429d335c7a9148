"""What follows a stage: the next stage, another round of it, another restart, or the end. One table, `TRANSITIONS`.

deformation, deformation, free, gains (rounds)    one restart, from one start
another restart                                   until two agree, or one explains all
noiseless                                         of a measurement without noise
final (rounds)                                    from the likeliest optimum, then the end
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...model.problem import Problem
from . import restarts
from .noise import isotropic_kernel, score, with_noise
from .objective import Objective
from .outliers import relocated
from .rules import SCHEDULE, STAGES
from .state import State
from .step import ChannelStep


@dataclass(frozen=True)
class Turn:
    """Where a stage has ended, or a restart.

    Attributes
    ----------
    place : name of the stage, or "restart" where the optimum of one has been added to the state
    state : State
    goal : Objective, what the last step minimised
    trial : ChannelStep, that step
    within_tolerance : whether it changed hardly anything
    """

    problem: Problem
    place: str
    state: State
    goal: Objective
    trial: ChannelStep
    within_tolerance: bool

    @cached_property
    def estimated(self) -> State:
        """The state with the noise, and the kernel of an isotropic field, that it calls for."""
        kernel = isotropic_kernel(self.problem, self.state)
        state = replace(self.state, model=replace(self.state.model, kernel=kernel), shape=self.state.positions)
        return with_noise(self.problem, state, rough=self.place == "free")

    @cached_property
    def searched(self) -> tuple[State, bool]:
        """The state of `estimated` with outliers moved in the first rounds, and whether any was."""
        if self.state.progress.rounds > SCHEDULE.searches:
            return self.estimated, False
        return relocated(self.problem, self.estimated)

    @cached_property
    def again(self) -> State:
        """Another round of the last stage."""
        return restarts.next_final(self.problem, self.state)


def following(turn: Turn) -> State:
    """Return what follows: the first row of TRANSITIONS that applies."""
    return next(then(turn) for place, when, then in TRANSITIONS if place in ("any", turn.place) and when(turn))


def _always(turn: Turn) -> bool:
    return True


def _singular(turn: Turn) -> bool:
    return turn.trial.terms is None


def _modes_chosen(turn: Turn) -> bool:
    return not turn.state.automatic


def _all_explained(turn: Turn) -> bool:
    return restarts.explains_all(turn.problem, turn.estimated)


def _noise_settled(turn: Turn) -> bool:
    """The noise has hardly changed and explains more than the error of the positions, and no outlier was moved."""
    state, moved = turn.searched
    k = float(np.real(turn.problem.wavenumbers[state.modes]).max())
    rough = (k * state.model.spread) ** 2 / turn.problem.dimension > state.model.share
    change = abs(np.log(state.model.share / turn.state.model.share))
    return not moved and not rough and bool(change < SCHEDULE.tolerance_noise)


def _last_round(turn: Turn) -> bool:
    return turn.state.progress.rounds + 1 >= SCHEDULE.rounds


def _confirmed(turn: Turn) -> bool:
    return restarts.optima_agree(turn.problem, turn.state) or restarts.explains_all(turn.problem, turn.state)


def _other_pose(turn: Turn) -> bool:
    tried = sum(one.regrouped for one in turn.state.optima)
    return bool(turn.state.progress.poses) and tried < SCHEDULE.restarts


def _regrouped_is_likeliest(turn: Turn) -> bool:
    return restarts.likeliest(turn.state).regrouped


def _nothing_else_free(turn: Turn) -> bool:
    """Channels are matched and given positions exact, or there are none."""
    soft = len(turn.problem.known) and turn.state.model.known_sigma > 0
    return turn.state.settings.gains == "fixed" and not soft


def _assumes_else(turn: Turn) -> bool:
    rounds = turn.again.progress.rounds
    return restarts.assumes_else(turn.state, turn.again) and rounds < SCHEDULE.final_rounds


def _stop(turn: Turn) -> State:
    return replace(turn.state, finished=True, converged=turn.within_tolerance)


def _next_deformation(turn: Turn) -> State:
    """Begin the next stage, with the noise that its modes show; after the last deformation outliers are moved."""
    stage = turn.state.progress.stage
    state = replace(turn.state, model=replace(turn.state.model, kernel="diffuse"), shape=turn.state.positions)
    state = _at_stage(with_noise(turn.problem, _at_stage(state, stage + 1)), stage)
    if not STAGES[stage + 1].degree:
        state, _ = relocated(turn.problem, state)
    return restarts.begin_stage(turn.problem, state, stage + 1)


def _seek_gains(turn: Turn) -> State:
    return restarts.begin_stage(turn.problem, turn.searched[0], turn.state.progress.stage + 1)


def _next_round(turn: Turn) -> State:
    state = turn.searched[0]
    ahead = replace(state, progress=replace(state.progress, rounds=state.progress.rounds + 1))
    return restarts.begin_stage(turn.problem, ahead, state.progress.stage)


def _end_lost(turn: Turn) -> State:
    return _restart_ended(turn, turn.state, np.inf)


def _end_explained(turn: Turn) -> State:
    return _restart_ended(turn, turn.estimated, score(turn.problem, turn.estimated, turn.goal, turn.trial))


def _end_settled(turn: Turn) -> State:
    state = turn.searched[0]
    return _restart_ended(turn, state, score(turn.problem, state, turn.goal, turn.trial))


def _restart_ended(turn: Turn, state: State, reached: float) -> State:
    converged = turn.within_tolerance and np.isfinite(reached)
    state = restarts.with_optimum(turn.problem, state, reached, bool(converged))
    return following(Turn(turn.problem, "restart", state, turn.goal, turn.trial, turn.within_tolerance))


def _at_stage(state: State, stage: int) -> State:
    return replace(state, progress=replace(state.progress, stage=stage))


TRANSITIONS: tuple[tuple[str, Callable[[Turn], bool], Callable[[Turn], State]], ...] = (
    # where          when                     then
    ("restart", _confirmed, lambda turn: restarts.begin_final(turn.problem, turn.state)),
    ("restart", _other_pose, lambda turn: restarts.next_pose(turn.problem, turn.state)),
    ("restart", _regrouped_is_likeliest, lambda turn: restarts.begin_final(turn.problem, turn.state)),
    ("restart", _always, lambda turn: restarts.next_restart(turn.problem, turn.state, turn.state.progress.restart + 1)),
    ("final", _singular, _stop),
    ("any", _singular, _end_lost),
    ("any", _modes_chosen, _stop),
    ("deformation", _always, _next_deformation),
    ("free", _all_explained, _end_explained),
    ("free", _always, _seek_gains),
    ("gains", _all_explained, _end_explained),
    ("gains", _noise_settled, _end_settled),
    ("gains", _last_round, _end_settled),
    ("gains", _always, _next_round),
    ("noiseless", _nothing_else_free, lambda turn: restarts.finished(turn.problem, turn.state)),
    ("noiseless", _always, lambda turn: restarts.after_noiseless(turn.problem, turn.state)),
    ("final", _assumes_else, lambda turn: turn.again),
    ("final", _always, lambda turn: restarts.finished(turn.problem, turn.state)),
)
