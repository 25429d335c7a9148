"""What the figures and the table need of one array: descent from several seeds, joint after it, joint alone.

A run is exact if every microphone ends on its true cell of the search lattice. The runs are kept in the cache.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ...model.measurement import Measurement
from ...model.problem import Problem
from ...model.settings import Search
from ...model.validation import InputError
from ..sources import CalibrationInput
from .trails import Trail, shortened, trail

NEAR = 0.05  # metres
QUICK_MODES, QUICK_SEEDS = 16, 2
STEPS = (4, 6, 8, 10, 12, 16, 20, 28, 40, 57)  # numbers of modes for which joint's error is drawn

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Outcome:
    """A solver over the seeds.

    Attributes
    ----------
    solver : "descent", "descent+joint" or "joint"
    needed : least number of modes with which every seed ends exact, or None
    modes : number of modes of what follows: `needed`, or else all
    highest : Hz, of these modes
    exact, near, seeds : numbers of seeds: exact, of mean error within NEAR, all
    error : metres, median of the seeds' mean errors
    sweeps, seconds : median over the seeds; processor time
    """

    solver: str
    needed: int | None
    modes: int
    highest: float
    exact: int
    near: int
    seeds: int
    error: float
    sweeps: float
    seconds: float


@dataclass(frozen=True)
class Array:
    """An array, and the settings of its runs; `modes` are in use at the end of descent."""

    name: str
    measurement: Measurement
    problem: Problem
    inputs: CalibrationInput
    modes: int
    seeds: int

    @property
    def search(self) -> Search:
        """The lattice."""
        return self.problem.search


def array_of(inputs: CalibrationInput, seeds: int, quick: bool) -> Array:
    """The array of a scene. Raises InputError where descent has nothing to search, or the truth is not told."""
    if seeds < 1:
        raise InputError(f"--seeds {seeds} must be at least 1")
    measurement = inputs.measurement
    if measurement.search is None or measurement.dimension != 2:
        raise InputError(f"{inputs.name} has no search domain in a field of two dimensions, which descent needs")
    modes = min(inputs.settings.modes, QUICK_MODES) if quick else inputs.settings.modes
    problem = measurement.problem(inputs.settings.weights)
    return Array(inputs.name, measurement, problem, inputs, modes, min(seeds, QUICK_SEEDS) if quick else seeds)


def descents(array: Array, count: int, progress: Progress) -> Iterator[Trail]:
    """The runs of descent from seeds 0 to count - 1."""
    settings = shortened(array.inputs.settings, "descent", array.modes)
    for seed in range(count):
        yield _noted(array, "descent", settings, seed, progress)


def joints(array: Array, modes: int, descents: list[Trail] | None, progress: Progress) -> Iterator[Trail]:
    """The runs of joint with so many modes, each from the end of one of `descents`, or from its own start.

    Raises InputError where joint refuses so few modes.
    """
    settings = replace(shortened(array.inputs.settings, "joint", modes), start=None)
    for seed in range(array.seeds):
        before = None if descents is None else descents[seed]
        start = None if before is None else before.positions[before.end_of(modes)]
        yield _noted(array, f"joint, {modes} modes", settings, seed, progress, start)


def _noted(array: Array, words: str, settings, seed: int, progress: Progress, start=None) -> Trail:
    note = f"{array.name}: {words}, seed {seed}"
    return trail(array.problem, settings, seed, lambda done: progress(done, note), start)


def outcomes(array: Array, progress: Progress) -> tuple[Outcome, ...]:
    """Descent, joint after descent, and joint alone."""
    first = list(descents(array, array.seeds, progress))
    lowest = array.inputs.settings.first_modes
    numbers = range(min(lowest, array.modes), array.modes + 1)
    ends = {M: [run.positions[run.end_of(M)] for run in first] for M in numbers}
    needed = next((M for M in numbers if all(is_exact(array, x) for x in ends[M])), None)
    at = needed or array.modes
    alone = [(ends[at][s], run.end_of(at), run.seconds[run.end_of(at)]) for s, run in enumerate(first)]
    return (
        _outcome(array, "descent", needed, at, alone),
        _sought(array, "descent+joint", numbers, first, progress),
        _sought(array, "joint", numbers, None, progress),
    )


def _sought(array: Array, solver: str, numbers: range, first: list[Trail] | None, progress: Progress) -> Outcome:
    """The outcome with the least number of modes with which every seed ends exact, or with all modes."""
    needed = next((M for M in numbers if _all_exact(array, M, first, progress)), None)
    ends = []
    for s, run in enumerate(joints(array, needed or array.modes, first, progress)):
        sweep = 0 if first is None else first[s].end_of(needed or array.modes)
        seconds = 0.0 if first is None else first[s].seconds[sweep]
        ends.append((run.positions[-1], sweep + run.sweeps, seconds + run.seconds[-1]))
    return _outcome(array, solver, needed, needed or array.modes, ends)


def _all_exact(array: Array, modes: int, first: list[Trail] | None, progress: Progress) -> bool:
    """Whether every seed ends exact; ends with the first that does not."""
    try:
        return all(is_exact(array, run.positions[-1]) for run in joints(array, modes, first, progress))
    except InputError:  # too few modes
        return False


def _outcome(array: Array, solver: str, needed: int | None, modes: int, ends: list) -> Outcome:
    """Of `ends`, positions (N, D), sweeps and seconds, one a seed."""
    errors = np.array([mean_error(array, x) for x, _, _ in ends])
    return Outcome(
        solver=solver,
        needed=needed,
        modes=modes,
        highest=float(array.problem.frequencies[modes - 1]),
        exact=sum(is_exact(array, x) for x, _, _ in ends),
        near=int(np.sum(errors <= NEAR)),
        seeds=len(ends),
        error=float(np.median(errors)),
        sweeps=float(np.median([sweeps for _, sweeps, _ in ends])),
        seconds=float(np.median([seconds for _, _, seconds in ends])),
    )


def is_exact(array: Array, positions) -> bool:
    """Whether every microphone is on its true cell of the lattice."""
    origin, step = np.array(array.search.origin), array.search.step
    found, truth = (np.round((x - origin) / step) for x in (positions, array.measurement.positions))
    return bool(np.array_equal(found, truth))


def mean_error(array: Array, positions) -> float:
    """Metres, over all microphones."""
    return float(np.linalg.norm(positions - array.measurement.positions, axis=1).mean())


def joint_errors(array: Array, progress: Progress) -> tuple[list[int], list[float]]:
    """Numbers of modes, and the mean error of joint alone with them, metres; none where it refuses so few."""
    once, numbers, errors = replace(array, seeds=1), [], []
    for M in sorted({min(M, array.modes) for M in STEPS}):
        with contextlib.suppress(InputError):
            (run,) = joints(once, M, None, progress)
            numbers.append(M)
            errors.append(mean_error(array, run.positions[-1]))
    return numbers, errors
