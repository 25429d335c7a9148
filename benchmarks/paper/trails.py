"""Runs of solvers, kept in the cache as the positions after every sweep.

A cached run is used again if the problem, the settings, the start and the code of fdcal are the same.
"""

import hashlib
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

import numpy as np

from fdcal.model.problem import Problem
from fdcal.model.settings import SolverSettings
from fdcal.model.storage import cache_key, load_or_make
from fdcal.session.study import code_version
from fdcal.solvers import load

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


def trail(
    problem: Problem, settings: SolverSettings, seed: int, progress: Callable[[float], None], positions=None
) -> Trail:
    """Return the run of a solver, from the cache if it is there.

    `settings`: of a single solver, no chain; `progress`: called with the fraction done; what it raises ends the run;
    `positions` (N, D) float64, where to begin, metres. Raises InputError: the solver cannot start.
    """
    start = None if positions is None else np.asarray(positions).tolist()
    fields = (problem.pressures, problem.wavenumbers, problem.known, problem.known_positions, problem.noise_power)
    seen = [None if field is None else _digest(np.asarray(field)) for field in fields]
    search = None if problem.search is None else asdict(problem.search)
    relevant = asdict(settings)
    ignores = load(settings.name).TRAITS.ignores
    relevant = {key: value for key, value in relevant.items() if key == "name" or not ignores(key)}
    parts = [seen, search, relevant, seed, start, code_version().source]

    def make() -> dict[str, np.ndarray]:
        return asdict(_computed(problem, settings, seed, progress, positions))

    name = f"{cache_key('trail', *parts)}.npz"
    return Trail(
        **load_or_make(name, make, lambda file: dict(np.load(file)), lambda file, table: np.savez(file, **table))
    )


def _computed(problem: Problem, settings: SolverSettings, seed: int, progress, positions) -> Trail:
    solver, begun = load(settings.name), time.process_time()
    given = {} if positions is None else {"positions": positions}
    state = solver.init(problem, settings, seed, **given)
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
