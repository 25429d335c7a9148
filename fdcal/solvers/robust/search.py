"""The search for starts: starts are fitted from low to high frequencies until several end at the most likely array.

At low frequency the cost has few local minima. A start is fitted to a few of the lowest modes, then to twice as many,
and so on, so that each fit begins in the basin of the fit before. The arrays that are found are ordered by the
likelihood of all modes. Each step of the search fits one start. Channels that are clearly inverted at the lowest modes
begin with a phase of pi: otherwise they seem independent of the others, and are placed far outside the array.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ...model.gauge import align
from ...model.problem import Problem
from ...model.validation import InputError, frozen_array
from .. import starts
from . import noise, windows
from . import objective as objectives
from .channels import relocated
from .stages import begin_restart, begin_stage, in_frame, moved_once
from .state import FREE, GAINS, SEARCH, FittedStart, State

MAX_RESTARTS = 4  # largest number of different arrays that are refined
# The search ends when this number of starts have ended at the most likely array. With 3 instead of 4, the arrays of two
# of 18 cases of the suite `benchmarks field` are not found. Two starts are enough if no start has ended elsewhere: in
# 231 such cases no other array was more likely.
AGREEING = 4
WORSE = 100.0  # nats; an array whose cost is higher than the lowest one by more than this is not refined
# Two arrays are different if the positions of a healthy microphone in them differ by more than this, in units of the
# shortest wavelength or of the RMS diameter of the array, whichever is smaller. If only the wavelength counted, the
# error of one of 12 arrays of 10 cm would be 8.6 instead of 3.9 mm.
DIFFERENT = 0.02


def begin(problem: Problem, state: State) -> State:
    """Return `state` at the first start that can be computed, before it is fitted.

    Microphones with given positions are placed at these. Raises InputError if no start can be computed.
    """
    number, one, x = next(_starts(problem, replace(state, starts=()), 0))
    x = np.array(in_frame(problem, state.settings, x, one.given))
    x[problem.known] = problem.known_positions  # for display only: `step` computes the start again
    x = frozen_array(x, float)
    progress = replace(state.progress, stage=SEARCH, rounds=0, steps=number)
    return replace(state, stage=state.stage + 1, positions=x, stage_start=x, starts=(), progress=progress)


def step(problem: Problem, state: State) -> State:
    """Return `state` after the fit of the next start, at the most likely array so far.

    Raises InputError or LinAlgError if no start can be computed.
    """
    failure = None
    for number, one, x in _starts(problem, state, state.progress.steps):
        try:
            found = _with_start(problem, state, one, x)
        except (InputError, np.linalg.LinAlgError) as error:  # the modes do not determine this start
            failure = error
            continue
        best, progress = found[0].positions, replace(state.progress, steps=number + 1)
        return replace(state, positions=best, stage_start=best, starts=found, progress=progress)
    if failure is not None and not state.starts:
        raise failure
    return replace(state, progress=replace(state.progress, steps=len(starts.plan(problem, state.last))))


def is_complete(problem: Problem, state: State) -> bool:
    """Return whether enough starts have ended at the most likely array, or none is left that should be tried."""
    found: tuple[FittedStart, ...] = state.starts or ()
    if found and found[0].hits >= (2 if len(found) == 1 else AGREEING):
        return True
    plan = starts.plan(problem, state.last)
    if _windows_suffice(problem, found):
        plan = [one for one in plan if one.kind != "random"]
    return state.progress.steps >= len(plan)


def likely(problem: Problem, state: State) -> tuple[FittedStart, ...]:
    """Return the arrays that are worth refining, the most likely first."""
    found: tuple[FittedStart, ...] = state.starts or ()
    limit = min((one.cost for one in found), default=0.0) + WORSE
    count = 1 if _windows_suffice(problem, found) else MAX_RESTARTS
    return tuple(one for one in found if one.cost <= limit)[:count]  # <= also keeps them if all costs are infinite


def _windows_suffice(problem: Problem, found: tuple[FittedStart, ...]) -> bool:
    """Return whether the short windows alone determine the array, which must be small and have no given positions."""
    if not found or len(problem.known):
        return False
    return windows.usable(problem, found[0].positions, found[0].healthy)


def _starts(problem: Problem, state: State, first: int) -> Iterator[tuple[int, starts.Start, np.ndarray]]:
    """Yield number, kind and positions (N, D), metres, of the starts from number `first` on that can be computed.

    They are computed from the pressures after the sign of clearly inverted channels is corrected.
    Raises InputError or LinAlgError if the modes determine none of them, and no array was found before.
    """
    reported, plan = noise.given_noise(problem, state), starts.plan(problem, state.last)
    level = None if reported is None else float(np.median(reported[state.modes]))
    corrected = replace(problem, pressures=np.where(starts.inverted(problem), -1, 1) * problem.pressures)
    for number, one in list(enumerate(plan))[first:]:
        try:
            x = starts.start(corrected if one.given else starts.without_given(corrected), state.last, level, one)
        except (InputError, np.linalg.LinAlgError):
            if number + 1 == len(plan) and not state.starts:
                raise
        else:
            yield number, one, x


def _with_start(problem: Problem, state: State, one: starts.Start, x: np.ndarray) -> tuple[FittedStart, ...]:
    """Return all arrays found, including that at which the start at `x` (N, D), metres, ends, the most likely first.

    A start that does not depend on the given positions is only aligned with them after its fit, so that a wrong given
    position does not deform it.
    """
    found, chosen = state.starts or (), problem if one.given else starts.without_given(problem)
    ended = fitted(chosen, state, x, one.lowest, found)
    if any(ended is other for other in found):
        return tuple(replace(other, hits=other.hits + (other is ended)) for other in found)
    ended = replace(ended, positions=in_frame(problem, state.settings, ended.positions, one.given))
    return tuple(sorted((*found, ended), key=lambda other: other.cost))


FIT_STEPS = 6  # largest number of steps at each number of modes
FIT_PRESSURES = 4000  # approximate number of pressures in a fit; if there are more, evenly spaced modes are used
FIT_MODES = 24  # smallest number of modes in a fit, if so many are available
FIT_TOLERANCE = 3e-3  # metres; a fit ends when no coordinate moves further than this in a step
FIT_NATS = 1.0  # nats; a fit also ends when a step lowers the cost by less than this


def fitted(
    problem: Problem, state: State, positions: np.ndarray, lowest: int, found: tuple[FittedStart, ...] = ()
) -> FittedStart:
    """Return the array at which a start at `positions` (N, D), metres, ends.

    It is fitted first to the `lowest` modes, then to more. The fits to all modes also find the gains and the gross
    faults of the channels; there are two of them, because the first one assumes too much noise. If the fit reaches an
    array of `found`, that array is returned, because the fit would continue as before.
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
        for one in found:
            if same_array(problem, one, here.positions):
                return one
    used = objectives.used_modes(problem, here, cap)
    objective = objectives.objective_of(problem, here, used)
    cost = replace(objective, priors=objective.priors.without_given()).finite_cost(objectives.unknowns_of(here))
    cost += noise.hyper_cost(objective.field, objectives.corrected(problem, here, used))
    cost += len(positions) * float(np.log(here.model.gain_sigma * here.model.phase_sigma))
    here = noise.with_silent_inside(problem, here)
    return FittedStart(here.positions, noise.healthy(here.model), cost, hits=1)


def same_array(problem: Problem, one: FittedStart, positions: np.ndarray) -> bool:
    """Return whether an array agrees with `positions` (N, D), metres, at its healthy channels.

    The result is False if fewer than half of all channels are healthy.
    """
    apart = np.linalg.norm(align(one.positions, positions) - positions, axis=1)[one.healthy]
    length = min(
        2 * np.pi / float(np.real(problem.wavenumbers).max()), 2 * float(np.linalg.norm(np.std(positions, axis=0)))
    )
    return bool(2 * len(apart) >= len(positions) and apart.max() < DIFFERENT * length)
