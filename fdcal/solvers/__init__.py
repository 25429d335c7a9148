"""Solvers: every module here with an `init` and a `step` over frozen states is one, found by its file name."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator

from ..checks import require_choice

HELPERS = ("newton", "starts")  # modules here that are no solvers


def names() -> list[str]:
    """Names of the solvers."""
    return sorted(module.name for module in pkgutil.iter_modules(__path__) if module.name not in HELPERS)


def load(name: str):
    """Module of the solver `name`; InputError if there is none."""
    require_choice("solver.name", name, names())
    return importlib.import_module(f"{__name__}.{name}")


def run(problem, settings, seed: int) -> Iterator:
    """States of the solver `settings.name` from the start to the end."""
    solver = load(settings.name)
    state = solver.init(problem, settings, seed)
    yield state
    while not state.finished:
        state = solver.step(problem, state)
        yield state
