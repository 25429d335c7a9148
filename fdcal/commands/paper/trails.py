"""Runs of solvers, kept in the cache as the positions after every sweep.

A cached run is used again if the problem, the settings, the start and the code of the solver are the same.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import pkgutil
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from ...model.problem import Problem
from ...model.settings import SolverSettings
from ...model.storage import cached_arrays
from ...solvers import load

# The packages whose code decides what a solver does; its inputs are part of the key anyway.
NUMERICS = ("fdcal.acoustics.", "fdcal.cost.", "fdcal.solvers.")
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
    parts = [seen, search, relevant, seed, start, _code(settings.name)]
    return Trail(
        **cached_arrays("trail", parts, lambda: asdict(_computed(problem, settings, seed, progress, positions)))
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


def _code(name: str) -> str:
    """Return a digest of the numerical code of a solver without comments and docstrings."""
    return hashlib.sha256("".join(_without_docstrings(file) for file in sources(name)).encode()).hexdigest()


def sources(name: str) -> list[Path]:
    """Return the files that solver `name` runs: its own and what these import of NUMERICS, directly or not."""
    waiting = [f"fdcal.solvers.{part}" for part in name.split("+")]
    found: dict[str, Path] = {}
    while waiting:
        module = waiting.pop()
        spec = importlib.util.find_spec(module)
        if module in found or spec is None or spec.origin is None:
            continue
        found[module] = Path(spec.origin)
        waiting += [f"{module}.{inner.name}" for inner in pkgutil.iter_modules(spec.submodule_search_locations or [])]
        waiting += [imported for imported in _imports(module, found[module]) if imported.startswith(NUMERICS)]
    return sorted(found.values())


def _imports(module: str, file: Path) -> Iterator[str]:
    """Yield the absolute names that a module imports relatively: modules and the modules of packages."""
    package = module if file.name == "__init__.py" else module.rpartition(".")[0]
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names if _is_module(f"{base}.{alias.name}"))


def _is_module(name: str) -> bool:
    parent, _, last = name.rpartition(".")
    spec = importlib.util.find_spec(parent)
    folders = None if spec is None else spec.submodule_search_locations
    return folders is not None and any(inner.name == last for inner in pkgutil.iter_modules(folders))


def _without_docstrings(file: Path) -> str:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and ast.get_docstring(node) is not None:
            node.body[0] = ast.Pass()
    return ast.dump(tree)
