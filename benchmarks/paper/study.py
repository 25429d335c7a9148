"""What the figures and the table need of one array: descent from several seeds, joint after it, and joint only.

A run is exact if every microphone ends on its true cell of the search lattice. The runs are kept in the cache.
"""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from fdcal.model.measurement import Measurement
from fdcal.model.problem import Problem
from fdcal.model.settings import Search
from fdcal.model.validation import InputError
from fdcal.session.sources import CalibrationInput

from .trails import Trail, shortened, trail

NEAR = 0.05  # m: mean error up to which a run counts as near the true positions
QUICK_MODES, QUICK_SEEDS = 16, 2
STEPS = (4, 6, 8, 10, 12, 16, 20, 28, 40, 57)  # numbers of modes for which the error of solver joint is drawn

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Outcome:
    """Results of a solver over all seeds."""

    solver: str  # "descent", "descent+joint" or "joint"
    needed: int | None  # least number of modes with which every seed ends exact
    modes: int  # number of modes of what follows: `needed`, or else all
    highest: float  # highest frequency of these modes, Hz
    # exact, near, seeds: numbers of seeds that end exact, that end with a mean error within NEAR, and of all
    exact: int
    near: int
    seeds: int
    error: float  # median of the mean errors of the seeds, metres
    # sweeps, seconds: median over the seeds; processor time
    sweeps: float
    seconds: float


@dataclass(frozen=True)
class Array:
    """An array and the settings of its runs."""

    name: str
    measurement: Measurement
    problem: Problem
    inputs: CalibrationInput
    modes: int  # in use at the end of solver descent
    seeds: int

    @property
    def search(self) -> Search:
        """The lattice of candidate positions."""
        if self.problem.search is None:
            raise InputError(f"{self.name} has no search domain", "give <search> and <radius>", key="search")
        return self.problem.search

    @property
    def truth(self) -> np.ndarray:
        """True positions (N, D) float64, metres."""
        if self.measurement.positions is None:
            raise InputError(f"{self.name} has no true positions", "give a scene")
        return self.measurement.positions


def array_of(inputs: CalibrationInput, seeds: int, quick: bool) -> Array:
    """Return the array of a scene.

    `quick`: whether at most QUICK_MODES modes and QUICK_SEEDS seeds are used. Raises InputError: the scene has no
    search domain in a plane, which solver descent needs.
    """
    if seeds < 1:
        raise InputError(f"--seeds {seeds} must be at least 1")
    measurement = inputs.measurement
    if measurement.search is None or measurement.dimension != 2:
        raise InputError(f"{inputs.name} has no search domain in a field of two dimensions, which descent needs")
    modes = min(inputs.settings.modes, QUICK_MODES) if quick else inputs.settings.modes
    problem = measurement.problem(inputs.settings.weights)
    return Array(inputs.name, measurement, problem, inputs, modes, min(seeds, QUICK_SEEDS) if quick else seeds)


def descents(array: Array, count: int, progress: Progress) -> Iterator[Trail]:
    """Yield the runs of solver descent from seeds 0 to count - 1."""
    settings = shortened(array.inputs.settings, "descent", array.modes)
    for seed in range(count):
        yield _run_with_note(array, "descent", settings, seed, progress)


def joints(array: Array, modes: int, descents: list[Trail] | None, progress: Progress) -> Iterator[Trail]:
    """Yield the runs of solver joint with so many modes, from the ends of `descents` or from its own start.

    Raises InputError: there are too few modes for solver joint.
    """
    settings = replace(shortened(array.inputs.settings, "joint", modes), start=None)
    for seed in range(array.seeds):
        before = None if descents is None else descents[seed]
        start = None if before is None else before.positions[before.end_of(modes)]
        yield _run_with_note(array, f"joint, {modes} modes", settings, seed, progress, start)


def _run_with_note(array: Array, words: str, settings, seed: int, progress: Progress, start=None) -> Trail:
    note = f"{array.name}: {words}, seed {seed}"
    return trail(array.problem, settings, seed, lambda done: progress(done, note), start)


def outcomes(array: Array, progress: Progress) -> tuple[Outcome, ...]:
    """Return the outcomes of descent, joint after descent, and joint only."""
    first = list(descents(array, array.seeds, progress))
    lowest = array.inputs.settings.first_modes
    numbers = range(min(lowest, array.modes), array.modes + 1)
    ends = {M: [run.positions[run.end_of(M)] for run in first] for M in numbers}
    needed = next((M for M in numbers if all(is_exact(array, x) for x in ends[M])), None)
    at = needed or array.modes
    alone = [(ends[at][s], run.end_of(at), run.seconds[run.end_of(at)]) for s, run in enumerate(first)]
    return (
        _outcome(array, "descent", needed, at, alone),
        _least_modes_outcome(array, "descent+joint", numbers, first, progress),
        _least_modes_outcome(array, "joint", numbers, None, progress),
    )


def _least_modes_outcome(
    array: Array, solver: str, numbers: range, first: list[Trail] | None, progress: Progress
) -> Outcome:
    """Return the outcome with the least number of modes with which every seed ends exact, or with all modes."""
    needed = next((M for M in numbers if _all_exact(array, M, first, progress)), None)
    ends = []
    for s, run in enumerate(joints(array, needed or array.modes, first, progress)):
        sweep = 0 if first is None else first[s].end_of(needed or array.modes)
        seconds = 0.0 if first is None else first[s].seconds[sweep]
        ends.append((run.positions[-1], sweep + run.sweeps, seconds + run.seconds[-1]))
    return _outcome(array, solver, needed, needed or array.modes, ends)


def _all_exact(array: Array, modes: int, first: list[Trail] | None, progress: Progress) -> bool:
    """Return whether every seed ends exact; the first that does not ends the search."""
    try:
        return all(is_exact(array, run.positions[-1]) for run in joints(array, modes, first, progress))
    except InputError:  # too few modes
        return False


def _outcome(array: Array, solver: str, needed: int | None, modes: int, ends: list) -> Outcome:
    """Return the outcome of `ends`: positions (N, D), sweeps and seconds of each seed."""
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
    """Return whether every microphone is on its true cell of the lattice."""
    origin, step = np.array(array.search.origin), array.search.step
    found, truth = (np.round((x - origin) / step) for x in (positions, array.truth))
    return bool(np.array_equal(found, truth))


def mean_error(array: Array, positions) -> float:
    """Return the mean error over all microphones, metres."""
    return float(np.linalg.norm(positions - array.truth, axis=1).mean())


def joint_errors(array: Array, progress: Progress) -> tuple[list[int], list[float]]:
    """Return numbers of modes and the mean error of solver joint with them, metres; too small numbers are left out."""
    once, numbers, errors = replace(array, seeds=1), [], []
    for M in sorted({min(M, array.modes) for M in STEPS}):
        with contextlib.suppress(InputError):
            (run,) = joints(once, M, None, progress)
            numbers.append(M)
            errors.append(mean_error(array, run.positions[-1]))
    return numbers, errors
