"""Solvers: `init` and `step` over frozen states, found by their module's or package's name.

May import: model, acoustics and cost.

A solver is a module here, or a subpackage with a module `solver`, that has `init` and `step`. A name with "+" is a
chain of solvers (`fdcal.solvers.chain`).
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from functools import cache

from ..model.validation import require_choice

# Modules here that are no solvers.
HELPERS = (
    "chain",
    "identifiability",
    "initial_positions",
    "joint_state",
    "levenberg_marquardt",
    "noise_schedule",
    "warmup",
)
CHAINS = ("descent+joint",)


def names() -> list[str]:
    """Names of the solvers, chains among them."""
    modules = [module.name for module in pkgutil.iter_modules(__path__) if module.name not in HELPERS]
    return sorted([*modules, *CHAINS])


@cache
def _member(name: str):
    module = importlib.import_module(f"{__name__}.{name}")
    return importlib.import_module(f"{module.__name__}.solver") if hasattr(module, "__path__") else module


def load(name: str):
    """Solver `name`, a module or a chain of them; InputError if there is none."""
    require_choice("solver.name", name, names())
    members = tuple(_member(part) for part in name.split("+"))
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
