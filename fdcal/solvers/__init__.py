"""Solvers: `init` and `step` over frozen states, found by the name of their module.

May import: model, acoustics and cost.

Every module inside this package but those of SHARED is a solver, a `fdcal.solvers.interface.Solver`; of a package it is
the module `solver`. A name with "+" is a chain of solvers (`fdcal.solvers.interface.Chain`).
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, cast

from ..model.problem import Problem
from ..model.settings import ALL_MODES, SolverSettings
from ..model.validation import require_choice

if TYPE_CHECKING:
    from .interface import RunState, Solver

SHARED = {"estimate", "interface", "levenberg_marquardt", "requirements", "starts", "warmup"}
CHAINS = ("descent+joint",)


@cache
def modules() -> dict[str, str]:
    """Return the module of each solver, inside this package, without importing any."""
    found = [module for module in pkgutil.iter_modules(__path__) if module.name not in SHARED]
    return {module.name: f"{module.name}.solver" if module.ispkg else module.name for module in found}


def names() -> list[str]:
    """Return the names of the solvers and of the chains, without importing any."""
    return sorted([*modules(), *CHAINS])


@cache
def load(name: str) -> Solver:
    """Return the solver or the chain called `name`."""
    require_choice("solver.name", name, names())
    members = tuple(importlib.import_module(f"{__name__}.{modules()[part]}") for part in name.split("+"))
    if len(members) == 1:
        return cast("Solver", members[0])
    from .interface import Chain

    return Chain(members)


def with_mode_count(problem: Problem, settings: SolverSettings) -> SolverSettings:
    """Return settings with a number of modes, where they ask for all."""
    if settings.modes != ALL_MODES:
        return settings
    from .requirements import mode_count

    modes = mode_count(problem, load(settings.name).usable_modes(problem, settings))
    return replace(settings, modes=modes, first_modes=min(settings.first_modes, modes))


def run(problem: Problem, settings: SolverSettings, seed: int) -> Iterator[RunState]:
    """Yield the states of the solver `settings.name` from the start to the end.

    A microphone that leaves what the frequencies can resolve ends the run (`fdcal.solvers.interface`). Where the
    settings ask for all modes, their number follows (`fdcal.solvers.requirements`).
    """
    from .interface import bounded, require_affordable

    solver, settings = load(settings.name), with_mode_count(problem, settings)
    require_affordable(problem, settings, solver.TRAITS)
    state = solver.init(problem, settings, seed)
    yield state
    while not state.finished:
        state = bounded(problem, state, solver.step(problem, state))
        yield state
