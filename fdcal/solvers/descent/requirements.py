"""What a problem needs so that descent can search its lattice."""

from __future__ import annotations

import numpy as np

from ...model.gauge import fixes_gauge
from ...model.problem import Problem
from ...model.settings import Search, SolverSettings
from ...model.validation import InputError


def require_solvable(problem: Problem, settings: SolverSettings) -> None:
    """Raise InputError for a problem that descent cannot work on."""
    if settings.known != "all":
        raise InputError(
            f'solver.known = "{settings.known}" leaves descent without the known microphones that it needs',
            "use <known> all, or <solver> joint",
            key="known",
            value=settings.known,
        )
    if problem.dimension != problem.array_dimension:
        raise InputError(
            "descent works on two-dimensional fields and on arrays in space; this measurement of an array in a plane"
            " has dimension = 3",
            "use <solver> joint",
        )
    if problem.search is None:
        raise InputError("the measurement has no search domain", "give <search> and <radius>", key="search")
    if not fixes_gauge(problem.known_positions):
        raise InputError(
            f"known = {problem.known.tolist()} does not fix translation, rotation and mirror",
            "descent needs at least three known microphones that are not on one line"
            if problem.array_dimension == 2
            else "descent needs at least four known microphones that are not in one plane",
            key="known",
            value=problem.known.tolist(),
        )
    _require_lattice(problem, problem.search)


def _require_lattice(problem: Problem, search: Search) -> None:
    """Raise InputError for a search domain with too few points, or too far from a known microphone."""
    count = problem.pressures.shape[1]
    if np.prod(search.shape) < count:
        raise InputError(
            f"search.step = {search.step:g} m leaves {np.prod(search.shape)} candidates for {count} microphones",
            "use a smaller step or a larger search.size",
            key="search.step",
            value=search.step,
        )
    low, high = np.array(search.origin) - search.radius, np.add(search.origin, search.size) + search.radius
    far = np.flatnonzero(np.any((problem.known_positions < low) | (problem.known_positions > high), axis=1))
    if len(far):
        raise InputError(
            f"known microphone {problem.known[far[0]]} at {problem.known_positions[far[0]].tolist()} m is further than"
            f" search.radius = {search.radius:g} m from the search domain",
            "move search.origin",
            key="search.origin",
        )
