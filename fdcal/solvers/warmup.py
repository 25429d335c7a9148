"""Calls of everything that is compiled, on small arrays, so that it is compiled before somebody waits for it.

A calibration by the likelihood compiles nothing. What is compiled: the search of solver `descent` over its lattice, the
local minima of a map, and the simulation of a scene (`fdcal warm` calls that, too). The first run on a machine compiles
for some seconds; later runs read the machine code from disk. What is compiled depends on the types of the arrays, not
on their sizes.
"""

from collections.abc import Callable

import numpy as np

from ..model.problem import Problem
from ..model.settings import Search, SolverSettings
from ..model.validation import frozen_array
from . import load

Piece = tuple[str, Callable[[], object]]  # what is compiled, in words, and the call that compiles it


def warmup_calls(solver: str) -> list[Piece]:
    """Return what a solver and the maps of its page need, in the order in which a run needs it."""
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

    basins_of(np.add.outer(np.arange(3.0), np.arange(3.0)), 0.1)  # finds the minima, too


SEARCH: Piece = ("search of solver descent", _search)
MINIMA: Piece = ("local minima of a map", _minima)
