"""Which modes the microphones and the search domain carry: the checks before Eq. 7 is evaluated on a lattice."""

from __future__ import annotations

import functools

import numpy as np

from ..acoustics.fourier_bessel import max_order
from ..acoustics.lattice_dictionary import LatticeDictionary
from ..model.problem import Problem
from ..model.validation import InputError
from .field_expansion import functions


@functools.lru_cache(maxsize=3)
def search_lattice(problem: Problem, order_offset: int) -> LatticeDictionary:
    """Return the lattice of the search domain, with every mode that the microphones can carry.

    Parameters
    ----------
    order_offset : added to the order of Eq. 3

    Raises
    ------
    InputError
        The problem has no search domain, or too few microphones for its lowest mode.
    """
    if problem.search is None:
        raise InputError("the measurement has no search domain", "give <search> and <radius>", key="search")
    require_plane_field(problem)
    require_modes(problem, order_offset, 1)
    orders = max_order(problem.wavenumbers, problem.search.radius, order_offset)
    usable = usable_modes(problem, order_offset)
    return LatticeDictionary(problem.search, problem.wavenumbers[:usable], orders[:usable])


def usable_modes(problem: Problem, order_offset: int) -> int:
    """Return how many of the lowest modes the microphones can carry with one of them left out.

    These are modes with fewer functions than microphones, in a plane 2L + 1 < N (Eq. 8). All modes without a search
    domain, because no lattice is searched then.

    Parameters
    ----------
    order_offset : added to the order of Eq. 3
    """
    if problem.search is None:
        return len(problem.pressures)
    orders = np.asarray(max_order(problem.wavenumbers, problem.search.radius, order_offset))
    carried = np.array([functions(problem, int(L)) for L in orders]) < problem.pressures.shape[1]
    return int(np.argmin(carried)) if not carried.all() else len(carried)


def require_plane_field(problem: Problem) -> None:
    """Raise InputError for a field of three dimensions, of which there is no lattice dictionary."""
    if problem.dimension != 2:
        raise InputError(
            "landscapes of this command need a two-dimensional field, and this one has dimension = 3",
            'use solver.name = "joint", and `fdcal view` for its maps',
            key="dimension",
            value=3,
        )


def require_modes(problem: Problem, order_offset: int, count: int) -> None:
    """Check that the field has `count` modes and that the microphones can carry them.

    Parameters
    ----------
    order_offset : added to the order of Eq. 3
    count : number of the lowest modes to use

    Raises
    ------
    InputError
        One of the two does not hold; the message says which, and what to change.
    """
    measured = len(problem.pressures)
    if count > measured:
        raise InputError(
            f"{count} modes asked for (solver.modes), but {measured} were measured",
            f"use at most {measured}",
            key="modes",
            value=count,
        )
    usable = usable_modes(problem, order_offset)
    if count > usable:
        raise _beyond_the_microphones(problem, order_offset, count, usable)


def _beyond_the_microphones(problem: Problem, order_offset: int, count: int, usable: int) -> InputError:
    """Return the error for the first mode with more functions than the microphones can carry."""
    if problem.search is None:
        raise ValueError("without a search domain every mode is usable")
    R = problem.search.radius
    L = int(max_order(problem.wavenumbers[usable], R, order_offset))
    remedies = [f"use at most {usable} modes (solver.modes; {count} asked for)"] if usable else []
    remedies += [f"a search.radius below {R:g} m"]
    remedies += [f"a solver.order_offset below {order_offset}"] if order_offset else []
    formula = "2L + 1" if problem.dimension == 2 else "(L + 1)(L + 2) / 2"
    formula = "(L + 1)^2" if problem.array_dimension == 3 else formula
    return InputError(
        f"mode {usable + 1} at {problem.frequencies[usable]:.4g} Hz has order L = ceil(k R) + solver.order_offset ="
        f" {L} with search.radius = {R:g} m and solver.order_offset = {order_offset}, that is {formula} ="
        f" {functions(problem, L)} functions for {problem.pressures.shape[1]} microphones",
        f"{'' if usable else 'use '}{', '.join(remedies)}, or more microphones",
        key="modes",
        value=count,
    )
