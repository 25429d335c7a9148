"""What is kept of a run of a solver: the positions after every sweep. The cache gives the same run a second time.

A run is the same if the solver sees the same, is set alike, begins alike, and its own code is what it was.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from ..measurement import Problem
from ..scene import Solver
from ..solvers import load
from ..store import cached_arrays

PACKAGE = Path(__file__).parent.parent
# The code and the settings that decide where descent goes, whose runs are long: nothing else makes them anew.
DESCENT = ("candidates.py", "cost.py", "dictionary.py", "solvers/descent.py")
SETTINGS = ("modes", "first_modes", "order_offset", "ample_modes", "known_weight", "max_sweeps", "start", "known")
DIGITS = 6


@dataclass(frozen=True)
class Trail:
    """A run, sweep by sweep; the first of S + 1 entries is the start.

    Attributes
    ----------
    positions : (S + 1, N, D) float64, metres
    modes : (S + 1,) int64, in use during the sweep
    seconds : (S + 1,) float64, processor time from the start
    converged : () bool, whether it ended because nothing moved any more
    """

    positions: np.ndarray
    modes: np.ndarray
    seconds: np.ndarray
    converged: np.ndarray

    @property
    def sweeps(self) -> int:
        """Number of sweeps."""
        return len(self.modes) - 1

    def end_of(self, modes: int) -> int:
        """The last sweep with so many modes, which is where a run with no more of them ends."""
        return int(np.flatnonzero(self.modes == modes)[-1])

    def errors(self, truth) -> np.ndarray:
        """Distance of each microphone from `truth` (N, D), metres, after every sweep : (S + 1, N) float64, metres."""
        return np.linalg.norm(self.positions - truth, axis=2)


def trail(problem: Problem, settings: Solver, seed: int, progress: Callable[[float], None], positions=None) -> Trail:
    """The run of `settings.name`, a single solver, from `positions` (N, D), metres, where given.

    `progress` is told the part that is done, and may raise to stop it. Raises InputError as the solver does.
    """
    start = None if positions is None else np.asarray(positions).tolist()
    fields = (problem.pressures, problem.wavenumbers, problem.known, problem.known_positions, problem.noise_power)
    seen = [None if field is None else _digest(np.asarray(field)) for field in fields]
    search = None if problem.search is None else asdict(problem.search)
    told = asdict(settings)
    if settings.name == "descent":
        told = {key: told[key] for key in ("name", *SETTINGS)}
    parts = [seen, search, told, seed, start, _code(settings.name)]
    return Trail(**cached_arrays("trail", parts, lambda: asdict(_made(problem, settings, seed, progress, positions))))


def _made(problem: Problem, settings: Solver, seed: int, progress, positions) -> Trail:
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


def shortened(settings: Solver, name: str, modes: int) -> Solver:
    """`settings` for solver `name` with `modes` modes at the end."""
    return replace(settings, name=name, modes=modes, first_modes=min(settings.first_modes, modes))


def _digest(values: np.ndarray) -> str:
    """Of numbers to DIGITS digits of the greatest: a room that is simulated once more differs by rounding."""
    scaled = values / max(np.abs(values).max(initial=0.0), np.finfo(float).tiny)
    return hashlib.sha256(np.round(scaled, DIGITS) + 0.0).hexdigest()  # 0.0 makes zeros of minus zeros


def _code(name: str) -> str:
    """Digest of the code of a solver: descent's own, all of the numerics for another."""
    files = [PACKAGE / file for file in DESCENT] if name == "descent" else [*PACKAGE.glob("*.py"), *_solvers()]
    return hashlib.sha256(b"".join(file.read_bytes() for file in sorted(files))).hexdigest()


def _solvers() -> list[Path]:
    return list((PACKAGE / "solvers").glob("*.py"))
