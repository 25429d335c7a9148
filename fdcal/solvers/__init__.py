"""Solvers: modules whose functions `init` and `step` return read-only states; `load` finds one by its name.

May import: model, acoustics and cost.

Every module and package inside this package, except those in SHARED, is a solver (`fdcal.solvers.interface.Solver`);
the name of the module is the name of the solver.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, cast

import numpy as np

from ..model.problem import Problem
from ..model.settings import ALL_MODES, Search, SolverSettings
from ..model.validation import frozen_array, require_choice

if TYPE_CHECKING:
    from .interface import RunState, Solver

PAPER = "descent"  # name of the paper's algorithm; a constant here, because the page needs it before it loads a solver
SHARED = {"interface", "levenberg_marquardt", "requirements", "starts"}


@cache
def names() -> list[str]:
    """Return the names of the solvers, without importing any."""
    return sorted({module.name for module in pkgutil.iter_modules(__path__)} - SHARED)


@cache
def load(name: str) -> Solver:
    """Return the solver called `name`."""
    require_choice("solver.name", name, names())
    return cast("Solver", importlib.import_module(f"{__name__}.{name}"))


def with_mode_count(problem: Problem, settings: SolverSettings) -> SolverSettings:
    """Return the settings, with ALL_MODES replaced by the number of modes that a calibration uses."""
    if settings.modes != ALL_MODES:
        return settings
    from .requirements import mode_count

    solver = load(settings.name)
    modes = mode_count(problem, solver.usable_modes(problem, settings), not solver.TRAITS.moves_all)
    return replace(settings, modes=modes, first_modes=min(settings.first_modes, modes))


def run(problem: Problem, settings: SolverSettings, seed: int) -> Iterator[RunState]:
    """Yield the states of the solver `settings.name` from the start to the end.

    The run ends if a microphone moves farther out than the frequencies can resolve (`fdcal.solvers.interface`). If the
    settings ask for all modes, `fdcal.solvers.requirements` determines their number. Raises InputError for a problem
    that needs too much memory, or that the solver cannot work on.
    """
    from .interface import bounded, require_affordable

    solver, settings = load(settings.name), with_mode_count(problem, settings)
    require_affordable(problem, settings, solver.TRAITS)
    state = solver.init(problem, settings, seed)
    yield state
    while not state.finished:
        state = bounded(problem, state, solver.step(problem, state))
        yield state


# The page makes the calls below in advance, so that no user waits for the compiler. They use small arrays, because
# compiled code depends on the types of the arrays, not on their sizes. On the first run on a machine they take some
# seconds; later runs read the machine code from disk. A calibration by the likelihood needs no compiled code.
Piece = tuple[str, Callable[[], object]]  # name of what is compiled, and the call that compiles it


def warmup_calls(solver: str) -> list[Piece]:
    """Return the compiled pieces that a solver and the maps on the page need, in the order of their use."""
    return [*([SEARCH] if load(solver).TRAITS.needs_search else []), MINIMA]


def _search() -> None:
    """Take one step of solver `descent`."""
    x = np.random.default_rng(0).uniform(0.0, 0.2, (9, 2)).round(2)
    k, search = np.array([2.0, 3.0, 4.0]), Search(origin=(0.0, 0.0), size=(0.2, 0.2), step=0.02, radius=0.2)
    pressures, known = np.exp(1j * np.multiply.outer(k, x[:, 0])), np.arange(3)
    problem = Problem(
        pressures=frozen_array(pressures, complex),  # read-only, as in a run
        wavenumbers=frozen_array(k, complex),
        frequencies=frozen_array(343 * k / (2 * np.pi), float),
        known=known,
        known_positions=frozen_array(x[known], float),
        search=search,
        noise_power=None,
        sound_speed=343.0,
        dimension=2,
        array_dimension=2,
    )
    descent = load("descent")
    descent.step(problem, descent.init(problem, SolverSettings(name="descent", start="random", modes=3), 0))


def _minima() -> None:
    from ..cost.basins import basins_of

    basins_of(np.add.outer(np.arange(3.0), np.arange(3.0)), 0.1)


SEARCH: Piece = ("search of solver descent", _search)
MINIMA: Piece = ("local minima of a map", _minima)
