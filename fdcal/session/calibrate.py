"""Run a solver to its end and return a `Calibration`: for the command line and for Python."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

from ..assessment.assess import ARGUMENTS, Assessment
from ..assessment.calibration import Calibration
from ..assessment.findings import MIN_MODES, modes_below_limit
from ..model.channels import check_channels
from ..model.problem import Problem
from ..model.validation import require_positive
from ..solvers import load
from ..solvers.bounds import OutOfTime, check_deadline, deadline, ended_early, time_limit
from ..solvers.interface import RunState
from ..solvers.requirements import check_solvable
from .assess import assess
from .blas_threads import one_blas_thread
from .input_checks import require_inside_search, require_length, require_room_for_array
from .shared_cost import cost_in_decibels
from .sources import CalibrationInput, Progress

FREE_SOUND_SPEED = 0.05  # one sigma of a sound speed that is to be estimated, relative: 30 K in air


def with_free_sound_speed(inputs: CalibrationInput) -> CalibrationInput:
    """Return `inputs` with an uncertain sound speed, where a solver is to estimate it that has a sigma of it."""
    settings = inputs.settings
    free = inputs.estimate_sound_speed and inputs.distance is None and settings.sound_speed_sigma is None
    if not free or load(settings.name).TRAITS.needs_room:
        return inputs
    return replace(inputs, settings=replace(settings, sound_speed_sigma=FREE_SOUND_SPEED))


def problem_of(inputs: CalibrationInput) -> Problem:
    """Return what the solver sees of a measurement, with the known microphones that the settings leave it."""
    return inputs.measurement.problem(inputs.settings.weights, inputs.settings.known)


def states_of(inputs: CalibrationInput, progress: Progress | None = None, problem: Problem | None = None) -> Iterator:
    """Yield every state of the solver, from the start to the end.

    Parameters
    ----------
    inputs : CalibrationInput
    progress : callable, optional
        Called with the fraction done, 0 to 1, and a note; what it raises ends the run.
    problem : Problem, optional
        The one of `problem_of`, if already made.

    Raises
    ------
    InputError
        The solver cannot start.
    """
    from ..solvers import run

    require_inside_search(inputs)
    problem, last = problem_of(inputs) if problem is None else problem, inputs.settings.modes
    check_channels(inputs.measurement.pressures, inputs.measurement.names)
    if load(inputs.settings.name).TRAITS.needs_room:
        require_room_for_array(inputs.measurement, inputs.settings)
    else:
        check_solvable(problem, last, inputs.measurement.names)
    for state in run(problem, inputs.settings, inputs.seed):
        if progress is not None:
            progress(state.last / last, f"{state.last} modes, sweep {state.sweep}")
        yield state


def solve(
    inputs: CalibrationInput,
    progress: Progress | None = None,
    wording: Mapping[str, str] = ARGUMENTS,
    clock: Callable[[], float] = time.process_time,
) -> Calibration:
    """Run the solver to its end and assess the positions, with one thread of BLAS.

    Parameters
    ----------
    inputs : CalibrationInput
    progress : callable, optional
        As of `states_of`.
    wording : mapping of str to str
        How the verdict's text calls the arguments that it mentions; by their names in Python unless given.
    clock : callable
        Seconds by which the solver's time is limited; those of the processor unless given.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        The solver cannot start.
    KeyboardInterrupt
        Before the solver has started. An interrupt of the solver ends it, as `inputs.time_limit` does: the best
        positions so far are assessed, with the verdict "not_converged".
    """
    inputs = with_free_sound_speed(inputs)
    problem = problem_of(inputs)
    require_length(inputs, problem)
    if inputs.time_limit is not None:
        require_positive("time_limit", inputs.time_limit, "s")
    start = time.perf_counter()
    with one_blas_thread():
        inputs, state, found = _assessed(inputs, progress, problem, wording, clock)
    measurement = inputs.measurement
    return Calibration(
        positions=found.positions,
        names=tuple(measurement.names),
        known=() if inputs.settings.known == "none" else tuple(measurement.names[n] for n in measurement.known),
        excluded=tuple(inputs.excluded),
        solver=inputs.settings.name,
        seed=inputs.seed,
        frequencies=found.problem.frequencies[state.first - 1 : state.last],
        cost=float(state.cost),
        cost_db=cost_in_decibels(found),
        sweeps=int(state.sweep),
        elapsed=time.perf_counter() - start,
        converged=bool(state.converged),
        aligned=problem.frame is None and not len(problem.known) and found.room is None,
        sound_speed=found.problem.sound_speed,
        sound_speed_sigma=found.sound_speed_sigma,
        verdict=found.verdict,
        verdict_text=found.verdict_text,
        uncertainty=found.uncertainty,
        covariance=found.covariance,
        evidence=found.evidence,
        room=found.room,
        channels=found.channels,
    ).compared_with(measurement, inputs.given)


def _assessed(
    inputs: CalibrationInput,
    progress: Progress | None,
    problem: Problem,
    wording: Mapping[str, str],
    clock: Callable[[], float],
) -> tuple[CalibrationInput, RunState, Assessment]:
    """Return the end of a run and what it is worth; of a second run where the array found cannot carry all modes.

    Before the first run nothing but the coherence speaks for the size of the array. The second run takes the modes
    that the array found interpolates, if their number was left open and as much time is left as the first run took.
    """
    limit = inputs.time_limit or time_limit(problem, inputs.settings.modes)
    state, stopped, end = last_state(inputs, progress, problem, clock)
    found = assess(inputs, problem, state, wording)
    if stopped:
        return inputs, state, replace(found, verdict="not_converged", message=stopped)
    left = end - clock()
    if not inputs.all_modes or found.verdict != "undersampled" or left < limit / 2:
        return inputs, state, found
    fewer = modes_below_limit(problem, found.positions)
    if not MIN_MODES <= fewer < inputs.settings.modes:
        return inputs, state, found
    settings = replace(inputs.settings, modes=fewer, first_modes=min(inputs.settings.first_modes, fewer))
    inputs = replace(inputs, settings=settings, all_modes=False, time_limit=left)
    inputs, state, found = _assessed(inputs, progress, problem, wording, clock)
    above = f"{len(problem.frequencies) - fewer} modes above {problem.frequencies[fewer - 1]:.0f} Hz are left out"
    text = f"{found.message}; {above}, since the array found cannot interpolate all of them (Eq. 9)"
    return inputs, state, replace(found, message=text)


def last_state(
    inputs: CalibrationInput, progress: Progress | None, problem: Problem, clock: Callable[[], float]
) -> tuple[RunState, str, float]:
    """Return the state at the end of a run, why it ended before the solver did ("" if it did not), and its deadline.

    The start is not interrupted, since there are no positions before it.
    """
    limit = inputs.time_limit
    if limit is None:
        limit = time_limit(problem, inputs.settings.modes)
    end, states = clock() + limit, states_of(inputs, progress, problem)
    state = next(states)
    try:
        with deadline(end, clock):
            while not state.finished:
                check_deadline()
                state = next(states)
    except OutOfTime:
        why = f"the solver was stopped after {limit:g} s of processor time; use fewer <modes> or a longer"
        return ended_early(state), f"{why} <time_limit>", end
    except KeyboardInterrupt:
        return ended_early(state), "the solver was interrupted; these are the best positions so far", end
    return state, "", end
