"""Solvers: every module here with an `init` and a `step` over frozen states is one, found by its file name.

A name with "+" is a chain of them (`chain`).
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator

from ..checks import require_choice

# Modules here that are no solvers.
HELPERS = ("chain", "newton", "roomattempts", "roomfit", "roomsearch", "roomsource", "roomstate", "staging", "starts")
CHAINS = ("descent+joint",)


def names() -> list[str]:
    """Names of the solvers, chains among them."""
    modules = [module.name for module in pkgutil.iter_modules(__path__) if module.name not in HELPERS]
    return sorted([*modules, *CHAINS])


def load(name: str):
    """Solver `name`, a module or a chain of them; InputError if there is none."""
    require_choice("solver.name", name, names())
    members = tuple(importlib.import_module(f"{__name__}.{part}") for part in name.split("+"))
    if len(members) == 1:
        return members[0]
    from .chain import Chain

    return Chain(members)


def run(problem, settings, seed: int) -> Iterator:
    """States of the solver `settings.name` from the start to the end."""
    solver = load(settings.name)
    state = solver.init(problem, settings, seed)
    yield state
    while not state.finished:
        state = solver.step(problem, state)
        yield state
