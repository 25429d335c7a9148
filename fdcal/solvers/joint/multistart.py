"""Attempts of the joint solver: where the next one starts, and which end is kept."""

from __future__ import annotations

from dataclasses import replace

from ...cost.noise_model import NoiseEstimate
from ...model.problem import Problem
from ...model.settings import SolverSettings
from .. import initial_positions
from ..position_fit import finite_cost
from ..residual_noise import noise_at
from . import acceptance, noise_schedule
from .stages import begin
from .state import Attempt, AttemptEnd, State
from .thresholds import STAGES


def first_modes(problem: Problem, settings: SolverSettings) -> int:
    """Return the modes of the first deformation: all if no microphone is known, as the low ones leave the size open."""
    return min(STAGES.first_modes, settings.modes) if len(problem.known) else settings.modes


def finish(problem: Problem, state: State, settled: bool, residual: NoiseEstimate | None = None) -> State:
    """Return the finished state, or the start of another attempt if the residual is more than noise."""
    if settled and acceptance.accepted(problem, state):
        return replace(state, finished=True, converged=True)
    if residual is None or acceptance.low_noise(problem, state) is not None:  # attempts are compared by the real kernel
        residual = noise_at(problem, state.positions, state.modes)
    here, best = _end_of(state, settled, residual), state.attempt.best
    better_before = best is not None and best.cost <= residual.cost
    best = best if best is not None and better_before else here
    tries = acceptance.attempts(problem, state)
    number = state.attempt.number + 1
    last = state.settings.start == "random" or number >= len(tries)
    if last or acceptance.confirmed(problem, state, residual):
        ended = replace(state, finished=True, converged=best.settled)
        return _restored(problem, ended, best) if better_before else ended
    return _attempt(problem, replace(state, attempt=Attempt(number, 0, best)), *tries[number])


def _end_of(state: State, settled: bool, residual: NoiseEstimate) -> AttemptEnd:
    field = state.field
    ends = field.noise, field.noise_power, field.near_field
    return AttemptEnd(residual.cost, settled, state.positions, state.phase.origin, *ends)


def _restored(problem: Problem, state: State, best: AttemptEnd) -> State:
    """`state` at the end of the best attempt."""
    noise = {"noise": best.noise, "noise_power": best.noise_power, "near_field": best.near_field}
    again = replace(
        state,
        positions=best.positions,
        phase=replace(state.phase, origin=best.origin),
        field=replace(state.field, prior=None, **noise),
    )
    return replace(again, cost=finite_cost(best.positions, *noise_schedule.stage_model(problem, again)))


def _attempt(problem: Problem, state: State, kind: str, value: float) -> State:
    """The start of one of `initial_positions.attempts`; `state` holds the best end before."""
    if kind in ("lowest", "gradual"):
        positions = initial_positions.affine(problem, state.settings.modes, int(value))
    elif kind == "redirected":
        positions = initial_positions.redirected(problem, state.settings.modes)
    else:
        best = state.positions if state.attempt.best is None else state.attempt.best.positions
        positions = best.mean(axis=0) + value * (best - best.mean(axis=0))
    started = replace(
        state,
        positions=positions,
        last=first_modes(problem, state.settings),
        phase=replace(state.phase, name="deformation", degree=2),
        field=replace(state.field, near_field=False, prior=None, prior_updates=0),
    )
    return begin(problem, started)
