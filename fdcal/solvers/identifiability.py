"""What a measurement must hold before a search for its microphones makes sense."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..model.gauge import fixes_gauge
from ..model.problem import Problem
from ..model.validation import InputError
from .initial_positions import singular_vectors

BENT = 4  # greatest degree: a line's second singular vector is a polynomial of its first
FOLLOWS = 0.97  # part of the last singular vector that is a polynomial of the others
FLAT = 0.25  # singular value of the last one over the first's


def check_solvable(problem: Problem, modes: int, names: Sequence[str]) -> None:
    """Raise InputError, naming microphones where it can, for what no solver can work on.

    modes : the lowest ones that the solver may use
    """
    _check_known(problem, names)
    _check_count(problem, modes)
    _check_line(problem, modes)


def _check_known(problem: Problem, names) -> None:
    places = problem.known_positions
    for i in range(len(places)):
        for j in range(i):
            if np.array_equal(places[i], places[j]):
                raise InputError(
                    f'known microphones "{names[problem.known[j]]}" and "{names[problem.known[i]]}" are both told to'
                    f" stand at {places[i].tolist()} m; correct known_positions"
                )


def _check_count(problem: Problem, modes: int) -> None:
    """Real equations against unknowns: a standing wave is real but for its phase, and D + 1 numbers are the field's."""
    (measured, N), D = problem.pressures.shape, problem.array_dimension
    unknowns = D * len(problem.free) - (0 if len(problem.known) else D * (D + 1) // 2)
    each = N - D - 1
    if each <= 0:
        raise InputError(
            f"{N} microphones are too few: a field of the lowest order has {D + 1} functions; use {2 * D + 2}"
            " microphones or more"
        )
    needed, used = -(-unknowns // each), min(modes, measured)
    if used < needed:
        remedy = "measure more" if measured < needed else f"use --modes {needed} or more"
        raise InputError(
            f"{used} frequencies are too few for {unknowns} unknown coordinates of {len(problem.free)} microphones;"
            f" at least {needed} are needed: {remedy}"
        )


def _check_line(problem: Problem, modes: int) -> None:
    """On a line (a plane, in space) the last singular vector only bends along with the others."""
    N, D = problem.pressures.shape[1], problem.array_dimension
    if fixes_gauge(problem.known_positions):
        return
    shape, values, _ = singular_vectors(problem, modes)
    first, last = shape[:, :-1] / np.abs(shape[:, :-1]).max(axis=0), shape[:, -1]
    powers = np.indices((BENT + 1,) * (D - 1)).reshape(D - 1, -1)
    powers = powers[:, powers.sum(axis=0) <= (BENT if D == 2 else 2)]
    if 2 * powers.shape[1] > N:
        return
    terms = np.prod(first[:, :, None] ** powers, axis=1)
    left = last - terms @ np.linalg.lstsq(terms, last, rcond=None)[0]
    if np.sum(left**2) < (1 - FOLLOWS) * np.sum(last**2) and values[-1] < FLAT * values[0]:
        where = "on a line" if D == 2 else "on a plane"
        raise InputError(
            f"the microphones seem to stand {where}: the pressures vary in {D - 1} independent direction"
            f"{'s' * (D > 2)} alone; {'set array_dimension = 2, or ' if D == 3 else ''}spread them out, or name"
            f" {D + 1} known ones that are not {where}"
        )
