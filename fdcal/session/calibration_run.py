"""Run a solver to its end and return a `Calibration`: for the command line and for Python.

The input is checked, the solver runs, and its last state is assessed.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ..acoustics.compiled import OutOfTime, check_deadline, deadline
from ..assessment.assess import ARGUMENTS, Assessment, assess
from ..assessment.calibration import Calibration, Run
from ..cost.eq7 import reference_cost_of
from ..model.gauge import move_to_frame, principal_axes, turn_to_frame
from ..model.measurement import Measurement, check_channels, microphone_index
from ..model.problem import Problem
from ..model.quantities import Metres, Seconds
from ..model.settings import SolverSettings, search_around
from ..model.validation import InputError, convert, frozen_array
from ..solvers import load, run, with_mode_count
from ..solvers.interface import RunState, ended_early, time_limit
from ..solvers.requirements import check_solvable
from .process import interrupts, one_blas_thread
from .sources import CalibrationInput, ProgressReport


def require_possible(inputs: CalibrationInput, problem: Problem) -> None:
    """Raise InputError if the solver cannot succeed, for example if a microphone is outside of the search domain."""
    measurement = inputs.measurement
    truth, search = measurement.positions, measurement.search
    if inputs.distance is not None:
        if len(problem.known):
            raise InputError("distance is for arrays without known microphones", "leave out <distance>", key="distance")
        convert(inputs.distance[2], Metres, "distance")
        distance_pair(inputs)
    if truth is not None and search is not None and load(inputs.settings.name).TRAITS.needs_search:
        free = np.setdiff1d(np.arange(measurement.count), measurement.known)
        low, high = np.array(search.origin) - search.step, np.add(search.origin, search.size) + search.step
        outside = free[np.any((truth[free] < low) | (truth[free] > high), axis=1)]
        if len(outside):
            fault = (
                f"microphone {measurement.names[outside[0]]} stands at {truth[outside[0]].tolist()} m, outside the"
                f" search domain of origin {list(search.origin)} m and size {list(search.size)} m"
            )
            raise InputError(fault, "enlarge or move the domain", key="search")
    check_channels(measurement.pressures, measurement.names)
    check_solvable(problem, inputs.settings.modes, measurement.names)


def assess_state(
    inputs: CalibrationInput, problem: Problem, state, wording: Mapping[str, str] = ARGUMENTS
) -> Assessment:
    """Return the assessment of the last state of a run; `wording`: names of the arguments in the verdict's text."""
    estimate, scale = load(inputs.settings.name).result(problem, state), None
    if inputs.distance is not None:  # size and sound speed change by the ratio of the given distance to the one found
        pair = distance_pair(inputs)
        apart = float(np.linalg.norm(np.subtract(*np.asarray(state.positions)[list(pair)])))
        if not apart > 0:
            both = " and ".join(inputs.measurement.names[i] for i in pair)
            raise InputError(f"microphones {both} coincide", "name others: <distance>", key="distance")
        scale = inputs.distance[2] / apart
    given, unused = inputs.measurement, {}
    if 0 < len(given.known) < given.count and not len(problem.known):  # positions of all microphones are for `--check`
        unused = dict(zip(given.known.tolist(), given.known_positions, strict=True))
    found = replace(assess(estimate, given.names, scale, unused), wording=wording)
    if problem.frame is None:
        return found
    rotation = turn_to_frame(found.positions, problem.frame)  # a run that was stopped may have ended in another frame
    positions = frozen_array(move_to_frame(found.positions, problem.frame), float)
    return replace(found, positions=positions, covariance=frozen_array(rotation.T @ found.covariance @ rotation, float))


def distance_pair(inputs: CalibrationInput) -> tuple[int, int]:
    """Return the numbers of the two microphones whose distance is given.

    Raises InputError for a name that no microphone has, or for one microphone named twice.
    """
    assert inputs.distance is not None
    names = inputs.measurement.names
    first, second = (microphone_index(text, names, "distance") for text in inputs.distance[:2])
    if first == second:
        raise InputError(f"distance names microphone {names[first]} twice", "name two microphones", key="distance")
    return first, second


def healthy_microphones(sought: np.ndarray, names: Sequence[str], found: Assessment | None) -> np.ndarray:
    """Return the microphones whose errors are averaged: those sought, without the faulty channels of an assessment."""
    faulty = set() if found is None else found.channels.faulty
    kept = np.array([n for n in sought if names[n] not in faulty], np.int64)
    return kept if len(kept) else sought


def counted_microphones(inputs: CalibrationInput, state) -> np.ndarray:
    """Return the numbers (K,) of the microphones whose errors are averaged: those sought with healthy channels."""
    everything = np.arange(inputs.measurement.count)
    free = np.setdiff1d(everything, inputs.given)
    found = None if state.channels is None else assess_state(inputs, problem_of(inputs), state)
    return healthy_microphones(free if len(free) else everything, inputs.measurement.names, found)


LONGER = 10.0  # the message for a time limit that was too short proposes this multiple of the limit


def problem_of(inputs: CalibrationInput) -> Problem:
    """Return what the solver gets of a measurement, with the known microphones that the settings allow."""
    return inputs.measurement.problem(inputs.settings.weights, inputs.settings.known)


def states_of(
    inputs: CalibrationInput, progress: ProgressReport | None = None, problem: Problem | None = None
) -> Iterator:
    """Check the inputs and return an iterator over every state of the solver, from the start to the end.

    `progress` is called with the fraction done, 0 to 1, or 0 if it is unknown, and a note. If it raises an exception,
    the run ends.
    """
    problem = problem_of(inputs) if problem is None else problem
    inputs = replace(inputs, settings=with_mode_count(problem, inputs.settings))
    last, adds_modes = inputs.settings.modes, load(inputs.settings.name).TRAITS.adds_modes
    require_possible(inputs, problem)

    def shown(state: RunState) -> RunState:
        if progress is not None:  # the number of sweeps is not known before the end
            progress((state.last - 1) / last if adds_modes else 0.0, f"{state.last} frequencies, sweep {state.sweep}")
        return state

    return map(shown, run(problem, inputs.settings, inputs.seed))


def solve(
    inputs: CalibrationInput,
    progress: ProgressReport | None = None,
    wording: Mapping[str, str] = ARGUMENTS,
    clock: Callable[[], float] = time.process_time,
    keep: bool = False,
) -> Calibration:
    """Run the solver to its end, with one thread of BLAS, and return the calibration.

    If `keep` is set, `show` can play the run. `clock` measures the time of the solver, s. `progress` is that of
    `states_of`, `wording` that of `assess_state`. An interrupt ends the solver, as `inputs.time_limit` does: the best
    positions so far are assessed, with the verdict "not_converged".
    """
    inputs = with_needed_domain(inputs)
    problem = problem_of(inputs)
    inputs = replace(inputs, settings=with_mode_count(problem, inputs.settings))
    if inputs.time_limit is not None:
        convert(inputs.time_limit, Seconds, "time_limit")
    start = time.perf_counter()
    with one_blas_thread():
        state, stopped = last_state(inputs, progress, problem, clock)
        with interrupts():  # an interrupt must not discard the positions that were found
            found = assess_state(inputs, problem, state, wording)
        found = replace(found, verdict="not_converged", message=stopped) if stopped else found
        if progress is not None:
            progress(1.0, "done")
    measurement = inputs.measurement
    positions, covariance = found.positions, found.covariance
    blind = problem.frame is None and not len(problem.known)
    if blind and np.isfinite(positions).all():  # the axes are those of the array itself: see `Calibration.frame`
        axes = principal_axes(positions)
        positions, covariance = (positions - positions.mean(axis=0)) @ axes, axes.T @ covariance @ axes
    again = partial(run, problem, inputs.settings, inputs.seed)
    return Calibration(
        positions=positions,
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
        aligned=blind,
        sound_speed=found.problem.sound_speed,
        sound_speed_sigma=found.sound_speed_sigma,
        verdict=found.verdict,
        verdict_text=found.verdict_text,
        uncertainty=found.uncertainty,
        covariance=covariance,
        evidence=found.evidence,
        channels=found.channels,
        run=Run(measurement, problem, inputs.settings, inputs.seed, int(state.step), again) if keep else None,
    ).compared_with(measurement, inputs.given)


INTERRUPTED = "the solver was interrupted; these are the best positions so far"


def last_state(
    inputs: CalibrationInput, progress: ProgressReport | None, problem: Problem, clock: Callable[[], float]
) -> tuple[RunState, str]:
    """Return the last state of a run, and why it was stopped ("" if the solver finished).

    Raises InputError if the time is used up before there are positions.
    """
    limit = inputs.time_limit or time_limit(problem, inputs.settings.modes)
    end, states, state = clock() + limit, states_of(inputs, progress, problem), None
    try:
        with deadline(end, clock):
            state = next(states)
            while not state.finished:
                check_deadline()
                state = next(states)
    except OutOfTime:
        if state is None:
            fault = f"the {limit:g} s of processor time were used up before there were positions of microphones"
            remedy = f"use <time_limit> {LONGER * limit:g}, or fewer microphones (<exclude>)"
            raise InputError(fault, remedy, key="time_limit") from None
        why = f"the solver was stopped after {limit:g} s of processor time; use <time_limit> {LONGER * limit:g}"
        return ended_early(state), why
    except KeyboardInterrupt:
        if state is None:
            raise
        return ended_early(state), INTERRUPTED
    return state, ""


def cost_in_decibels(found: Assessment) -> float | None:
    """Return the reference cost of the positions found, dB (`fdcal.cost.eq7.ReferenceCost`).

    A problem without a search domain gets one around the positions found, as on the page. The result is None if a
    position is not finite, or if the microphones are too few for any mode.
    """
    problem = found.problem
    if not np.isfinite(found.positions).all():
        return None
    reference_cost = reference_cost_of(replace(problem, search=search_around(found.positions, problem.search)))
    cost = np.nan if reference_cost is None else reference_cost(found.positions, found.channels.correction)
    return cost if np.isfinite(cost) else None


def with_needed_domain(inputs: CalibrationInput) -> CalibrationInput:
    """Return the inputs with a search domain if the solver or its start needs one, see `with_estimated_domain`."""
    settings = inputs.settings
    if settings.start != "random" and not load(settings.name).TRAITS.needs_search:
        return inputs
    return replace(inputs, measurement=with_estimated_domain(inputs.measurement, settings, inputs.seed))


DOMAIN_SECONDS = 20.0  # largest processor time of the estimate, seconds


def with_estimated_domain(
    measurement: Measurement, settings: SolverSettings, seed: int, progress: ProgressReport | None = None
) -> Measurement:
    """Return a measurement with a search domain: its own, or one around an estimate of the positions.

    The solver of the run makes the estimate, so that the estimate has the same axes as the run. If that solver needs a
    search domain itself, the default solver makes the estimate. Without known microphones the estimate is moved onto
    the true positions, if there are any. If the estimate fails, the measurement is returned as it is.
    """
    if measurement.search is not None:
        return measurement
    needs_search = load(settings.name).TRAITS.needs_search
    chosen = replace(settings, name=SolverSettings().name if needs_search else settings.name, start=None)
    inputs = CalibrationInput(measurement=measurement, name="", scene=None, settings=chosen, seed=seed)
    try:
        problem = problem_of(inputs)
        inputs = replace(inputs, settings=with_mode_count(problem, chosen), time_limit=DOMAIN_SECONDS)
        with one_blas_thread():
            state, stopped = last_state(inputs, progress, problem, time.process_time)
        if stopped == INTERRUPTED:  # the user ends the command, not only the estimate
            raise KeyboardInterrupt
    except InputError:
        return measurement
    truth = measurement.positions if measurement.blind or settings.known == "none" else None
    return replace(measurement, search=search_around(state.best_positions, truth=truth))
