"""What follows a row of the schedule: the next row, another round of the same, or the end of the attempt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...model.problem import Problem
from . import hyperparameters, kernels
from .attempts import begin_row, end_attempt, end_final, end_noiseless, is_low_noise_end
from .channel_fit import ChannelStep
from .objective import Objective
from .relocation import relocated
from .settings import RULES, SCHEDULE
from .state import State

__all__ = ["begin_row", "end_row"]


def end_row(problem: Problem, state: State, goal: Objective, trial: ChannelStep, settled: bool) -> State:
    """Return the state that follows the last step `trial` of a row; `goal` is what that step minimised."""
    row = SCHEDULE[state.progress.row]
    if trial.terms is None and row.name == "final":
        return replace(state, finished=True, converged=False)
    if trial.terms is None:
        return end_attempt(problem, state, np.inf, False)
    if not state.automatic:
        return replace(state, finished=True, converged=settled)
    if row.name == "final":
        return end_final(problem, state, settled)
    if row.name == "noiseless":
        return end_noiseless(problem, state)
    before = state.model.share
    kernel = "diffuse" if row.degree else kernels.kernel_of(problem, state)
    state = replace(state, model=replace(state.model, kernel=kernel), shape=state.positions)
    if row.degree:
        return _end_deformation(problem, state)
    state = hyperparameters.with_noise(problem, state, rough=row.name != "gains")
    if is_low_noise_end(problem, state):
        return end_attempt(problem, state, hyperparameters.score(problem, state, goal, trial), settled)
    moved = False
    if state.progress.rounds <= RULES.searches:
        state, moved = relocated(problem, state)
    if row.name == "free":
        return begin_row(problem, state, state.progress.row + 1)
    if (not moved and _settled_noise(problem, state, before)) or state.progress.rounds + 1 >= RULES.rounds:
        return end_attempt(problem, state, hyperparameters.score(problem, state, goal, trial), settled)
    return begin_row(problem, _next_round(state), state.progress.row)


def _end_deformation(problem: Problem, state: State) -> State:
    """Begin the next row, with the noise that its modes show; after the last deformation outliers are moved."""
    row = state.progress.row
    ahead = hyperparameters.with_noise(problem, _at_row(state, row + 1))
    state = _at_row(ahead, row)
    if not SCHEDULE[row + 1].degree:
        state, _ = relocated(problem, state)
    return begin_row(problem, state, row + 1)


def _settled_noise(problem: Problem, state: State, before: float) -> bool:
    """Whether the noise has hardly changed and explains more than the error of the positions."""
    k = float(np.real(problem.wavenumbers[state.modes]).max())
    rough = (k * state.model.spread) ** 2 / problem.dimension > state.model.share
    return not rough and bool(abs(np.log(state.model.share / before)) < RULES.settled_noise)


def _at_row(state: State, row: int) -> State:
    return replace(state, progress=replace(state.progress, row=row))


def _next_round(state: State) -> State:
    return replace(state, progress=replace(state.progress, rounds=state.progress.rounds + 1))
