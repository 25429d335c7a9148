"""What the paper states about its two arrays, and runs of descent and of joint from several seeds.

A run is exact if every microphone ends on its true cell of the search lattice. Runs are kept in the cache as the
positions after every sweep: one is used again if the problem, the settings, the start and the code of fdcal are the
same.
"""

import contextlib
import hashlib
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace

import numpy as np

from fdcal.model.measurement import Measurement
from fdcal.model.problem import Problem
from fdcal.model.settings import Search, SolverSettings
from fdcal.model.storage import cache_key, load_or_make
from fdcal.model.validation import InputError
from fdcal.session.sources import CalibrationInput
from fdcal.solvers import load
from fdcal_bench.code import code_version


@dataclass(frozen=True)
class Printed:
    """What the paper states about an array; not the time, the number of runs or the total of iterations."""

    title: str  # what the paper calls the array
    modes: int  # number of modes needed for exact positions
    highest: float  # frequency of the highest of them, Hz
    iteration: int  # the one that Fig. 2 shows, before the end


PRINTED = {
    "array1_circle": Printed("Array 1", 57, 328.0, 60),
    "array2_random": Printed("Array 2", 39, 262.0, 120),
}
ARRAYS = tuple(PRINTED)
LANDSCAPE = "fig1_square", 16, (20, 40, 57)  # the scene of Fig. 1, the microphone that is moved, modes from 1


def title_of(name: str) -> str:
    """Return what a figure calls the array of scene `name`."""
    return PRINTED[name].title if name in PRINTED else name


DIGITS = 6  # of the inputs of a solver, relative to the greatest


@dataclass(frozen=True)
class Trail:
    """A run, sweep by sweep; the first of S + 1 entries is the start."""

    positions: np.ndarray  # (S + 1, N, D) float64, metres
    modes: np.ndarray  # (S + 1,) int64, in use during the sweep
    seconds: np.ndarray  # (S + 1,) float64, processor time from the start
    converged: np.ndarray  # () bool, whether the solver converged

    @property
    def sweeps(self) -> int:
        """Number of sweeps."""
        return len(self.modes) - 1

    def end_of(self, modes: int) -> int:
        """Return the last sweep with so many modes, where a run with no more of them would end."""
        return int(np.flatnonzero(self.modes == modes)[-1])

    def errors(self, truth) -> np.ndarray:
        """Return the distances from `truth` (N, D), metres, after every sweep : (S + 1, N) float64, metres."""
        return np.linalg.norm(self.positions - truth, axis=2)


def trail(problem: Problem, settings: SolverSettings, seed: int, progress: Callable[[float], None]) -> Trail:
    """Return the run of a solver, from the cache if it is there.

    `progress`: called with the fraction done; what it raises ends the run. Raises InputError: the solver cannot start.
    """
    fields = (problem.pressures, problem.wavenumbers, problem.known, problem.known_positions, problem.noise_power)
    seen = [None if field is None else _digest(np.asarray(field)) for field in fields]
    search = None if problem.search is None else asdict(problem.search)
    relevant = asdict(settings)
    used = load(settings.name).TRAITS.settings
    relevant = {key: value for key, value in relevant.items() if key == "name" or key in used}
    parts = [seen, search, relevant, seed, code_version().source]

    def make() -> dict[str, np.ndarray]:
        return asdict(_computed(problem, settings, seed, progress))

    name = f"{cache_key('trail', *parts)}.npz"
    return Trail(
        **load_or_make(name, make, lambda file: dict(np.load(file)), lambda file, table: np.savez(file, **table))
    )


def _computed(problem: Problem, settings: SolverSettings, seed: int, progress) -> Trail:
    solver, begun = load(settings.name), time.process_time()
    state = solver.init(problem, settings, seed)
    kept = [(state.positions, state.last, 0.0)]
    while not state.finished:
        before, state = state, solver.step(problem, state)
        if state.sweep > before.sweep:
            kept.append((state.positions, before.last, time.process_time() - begun))
            progress(min(1.0, state.last / settings.modes))
    places, modes, seconds = zip(*kept, strict=True)
    return Trail(np.array(places), np.array(modes), np.array(seconds), np.array(state.converged))


def shortened(settings: SolverSettings, name: str, modes: int) -> SolverSettings:
    """Return `settings` for solver `name` with `modes` modes at the end."""
    return replace(settings, name=name, modes=modes, first_modes=min(settings.first_modes, modes))


def _digest(values: np.ndarray) -> str:
    """Return a digest of numbers, rounded to DIGITS digits: a repeated simulation of a room differs by rounding."""
    scaled = values / max(np.abs(values).max(initial=0.0), np.finfo(float).tiny)
    return hashlib.sha256(np.round(scaled, DIGITS) + 0.0).hexdigest()  # adding 0.0 turns -0.0 into 0.0


NEAR = 0.05  # m: mean error up to which a run counts as near the true positions
QUICK_MODES, QUICK_SEEDS = 16, 2
STEPS = (4, 6, 8, 10, 12, 16, 20, 28, 40, 57)  # numbers of modes for which the error of solver joint is drawn

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Outcome:
    """Results of a solver over all seeds."""

    solver: str  # "descent" or "joint"
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
    modes = min(inputs.settings.modes, len(measurement.frequencies), *([QUICK_MODES] if quick else []))
    problem = measurement.problem(inputs.settings.weights)
    return Array(inputs.name, measurement, problem, inputs, modes, min(seeds, QUICK_SEEDS) if quick else seeds)


def descents(array: Array, count: int, progress: Progress) -> Iterator[Trail]:
    """Yield the runs of solver descent from seeds 0 to count - 1."""
    settings = shortened(array.inputs.settings, "descent", array.modes)
    for seed in range(count):
        yield _run_with_note(array, "descent", settings, seed, progress)


def joints(array: Array, modes: int, progress: Progress) -> Iterator[Trail]:
    """Yield the runs of solver joint with so many modes.

    Raises InputError: there are too few modes for solver joint.
    """
    settings = replace(shortened(array.inputs.settings, "joint", modes), start=None)
    for seed in range(array.seeds):
        yield _run_with_note(array, f"joint, {modes} modes", settings, seed, progress)


def _run_with_note(array: Array, words: str, settings, seed: int, progress: Progress) -> Trail:
    note = f"{array.name}: {words}, seed {seed}"
    return trail(array.problem, settings, seed, lambda done: progress(done, note))


def outcomes(array: Array, progress: Progress) -> tuple[Outcome, ...]:
    """Return the outcomes of descent and of joint."""
    first = list(descents(array, array.seeds, progress))
    lowest = array.inputs.settings.first_modes
    numbers = range(min(lowest, array.modes), array.modes + 1)
    ends = {M: [run.positions[run.end_of(M)] for run in first] for M in numbers}
    needed = next((M for M in numbers if all(is_exact(array, x) for x in ends[M])), None)
    at = needed or array.modes
    alone = [(ends[at][s], run.end_of(at), run.seconds[run.end_of(at)]) for s, run in enumerate(first)]
    of_descent = _outcome(array, "descent", needed, at, alone)
    needed = next((M for M in numbers if _all_exact(array, M, progress)), None)
    ends = [(run.positions[-1], run.sweeps, run.seconds[-1]) for run in joints(array, needed or array.modes, progress)]
    return of_descent, _outcome(array, "joint", needed, needed or array.modes, ends)


def _all_exact(array: Array, modes: int, progress: Progress) -> bool:
    """Return whether every seed ends exact; the first that does not ends the search."""
    try:
        return all(is_exact(array, run.positions[-1]) for run in joints(array, modes, progress))
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
            (run,) = joints(once, M, progress)
            numbers.append(M)
            errors.append(mean_error(array, run.positions[-1]))
    return numbers, errors
