"""Checks that a measurement can determine the positions of its microphones at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..acoustics import single_wave
from ..acoustics.single_wave import is_single_wave
from ..model.gauge import fixes_gauge
from ..model.problem import Problem
from ..model.validation import InputError
from .starts import singular_vectors


@dataclass(frozen=True)
class LineLimits:
    """When the microphones are taken to be on a line (on a plane, in space).

    Attributes
    ----------
    degree : greatest degree of the polynomials: the second singular vector of a line is a polynomial of its first
    explained : part of the last singular vector that is a polynomial of the others
    flat : singular value of the last vector over that of the first
    """

    degree: int = 4
    explained: float = 0.97
    flat: float = 0.25


LINE = LineLimits()


def least_microphones(dimension: int) -> int:
    """Return the number of microphones below which no array of D = `dimension` coordinates can be found.

    A field of the lowest order has D + 1 functions; as many equations again must be left for the positions.
    """
    return 2 * dimension + 2


def check_solvable(problem: Problem, modes: int, names: Sequence[str]) -> None:
    """Raise InputError for a problem that no solver can work on; it names microphones if it can.

    Parameters
    ----------
    problem : Problem
    modes : int, lowest modes that the solver may use
    names : names of the microphones

    Raises
    ------
    InputError
        For two known microphones at one place, too few microphones or modes, or microphones on a line or plane.
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
                    f'known microphones "{names[problem.known[j]]}" and "{names[problem.known[i]]}" have the same given'
                    f" position {places[i].tolist()} m",
                    "correct known_positions",
                    key="known_positions",
                )


def _check_count(problem: Problem, modes: int) -> None:
    """Compare real equations with unknowns: a standing wave is real up to its phase; D + 1 of its numbers are free."""
    (measured, N), D = problem.pressures.shape, problem.array_dimension
    unknowns = D * len(problem.free) - (0 if len(problem.known) else D * (D + 1) // 2)
    each = N - D - 1
    if each <= 0:
        raise InputError(
            f"{N} microphones are too few: a field of the lowest order has {D + 1} functions",
            f"use {least_microphones(D)} microphones or more",
            key="pressures",
        )
    needed, used = -(-unknowns // each), min(modes, measured)
    if used < needed:
        remedy = "measure more" if measured < needed else f"use <modes> {needed} or more"
        raise InputError(
            f"{used} frequencies are too few for {unknowns} unknown coordinates of {len(problem.free)} microphones;"
            f" at least {needed} are needed",
            remedy,
            key="modes",
            value=used,
        )


def _check_line(problem: Problem, modes: int) -> None:
    """On a line (a plane, in space) the last singular vector is a polynomial of the others."""
    N, D = problem.pressures.shape[1], problem.array_dimension
    if fixes_gauge(problem.known_positions):
        return
    if is_single_wave(problem.pressures[:modes]):
        raise InputError(single_wave.PROBLEM, single_wave.REMEDY, key="pressures")
    shape, values, _ = singular_vectors(problem, modes)
    first, last = shape[:, :-1] / np.abs(shape[:, :-1]).max(axis=0), shape[:, -1]
    powers = np.indices((LINE.degree + 1,) * (D - 1)).reshape(D - 1, -1)
    powers = powers[:, powers.sum(axis=0) <= (LINE.degree if D == 2 else 2)]
    if 2 * powers.shape[1] > N:
        return
    terms = np.prod(first[:, :, None] ** powers, axis=1)
    left = last - terms @ np.linalg.lstsq(terms, last, rcond=None)[0]
    if np.sum(left**2) < (1 - LINE.explained) * np.sum(last**2) and values[-1] < LINE.flat * values[0]:
        where = "on a line" if D == 2 else "on a plane"
        raise InputError(
            f"the microphones seem to stand {where}: the pressures vary in {D - 1} independent direction"
            f"{'s' * (D > 2)} alone",
            f"{'set array_dimension = 2, or ' if D == 3 else ''}spread them out, or name {D + 1} known ones that are"
            f" not {where}",
            key="positions",
        )
