"""The beginning of a stage, for search and schedule, and one step of the solver."""

from dataclasses import replace

import numpy as np

from ...model.gauge import move_to_frame
from ...model.problem import Problem
from ...model.settings import SolverSettings
from ...model.validation import frozen_array
from .. import starts
from . import noise
from . import objective as objectives
from .state import DIRECTION_UPDATES, FREE, STAGE_DAMPING, StageProgress, State


def begin_stage(problem: Problem, state: State, stage: int) -> State:
    """Return `state` at the beginning of a stage of the schedule."""
    progress = replace(state.progress, stage=stage, steps=0, damping=STAGE_DAMPING)
    if state.model.arrival_sigma is None:
        state = noise.with_arrivals(problem, state)
    return replace(state, stage=state.stage + 1, progress=progress, stage_start=state.positions)


def begin_restart(problem: Problem, state: State, positions: np.ndarray) -> State:
    """Return `state` at the beginning of a restart at `positions` (N, D), metres."""
    x = in_frame(problem, state.settings, positions)
    inverted = starts.inverted(problem) & (state.settings.gains != "fixed")
    gains = frozen_array(np.pi * np.outer(inverted, [0, 1]), float)
    model = objectives.first_model(problem, state.settings)
    progress = StageProgress(restart=state.restart + 1, stage=FREE, rounds=0, steps=0, damping=0.0)
    begun = replace(state, positions=x, stage_start=x, gains=gains, offsets=gains, model=model, progress=progress)
    return begin_stage(problem, noise.with_noise(problem, begun), FREE)


def in_frame(problem: Problem, settings: SolverSettings, positions: np.ndarray, placed: bool = True) -> np.ndarray:
    """Return positions (N, D), metres, in the frame of the problem.

    placed : whether the array is already aligned with the given positions; otherwise it is first aligned with them.
    Microphones with an exact given position are moved to it, and the others are moved along smoothly.
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


# largest change of a coordinate in one step, in shortest wavelengths; without this limit the error of a linear array in
# space grows from 1.3 to 2.1 mm
MAX_STEP = 0.125


def moved_once(
    problem: Problem, state: State, used: np.ndarray
) -> tuple[State, objectives.Objective, objectives.ChannelStep]:
    """Return `state` after one damped step and one update of the model, the objective of the step, and the step.

    The update is that of the power, the noise and the prior sigmas, over the modes `used`. If a covariance is singular,
    the unknowns do not change, and the step has no `terms`.
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
