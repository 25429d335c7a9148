"""The requirements on a measurement whose microphones are to be found, and the number of modes in a calibration.

mode_count      default number of modes in use: all measured ones, within three limits
check_solvable  requirements of every calibration: enough equations, and microphones that are not on one line
require_modes   additional requirements of the solvers that minimise a likelihood
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from ..acoustics.coherence import SINGLE_WAVE, SINGLE_WAVE_REMEDY, array_radius, is_single_wave
from ..acoustics.dictionary import f_max
from ..model.gauge import fixes_gauge
from ..model.problem import Problem
from ..model.validation import LIMITS, InputError
from .starts import singular_vectors


def mode_count(problem: Problem, usable: int, interpolates: bool) -> int:
    """Return how many of the lowest modes a calibration uses by default.

    Their number is limited by the number `usable` that the solver can use, by memory and, if the solver `interpolates`
    the field between microphones, by Eq. 9.
    """
    measured, microphones = problem.pressures.shape
    count = min(measured, usable or measured, int(LIMITS.pairs // microphones**2))
    if interpolates:
        count = min(count, int(np.sum(problem.frequencies <= highest_frequency(problem))) or count)
    return max(1, count)


RADIUS_FACTOR = 1.5  # factor by which the radius from the coherence may be too large


def highest_frequency(problem: Problem) -> float:
    """Return f_max (Eq. 9), Hz, for the smallest array that fits the coherence; infinite if no radius follows from it.

    The limit is only accurate to a factor of 1.5; the verdict is based on the array that is found.
    """
    radius = array_radius(problem.pressures, problem.wavenumbers, problem.dimension)
    if radius is None:
        return float("inf")
    radius /= RADIUS_FACTOR
    if len(problem.known) > 1:
        known = problem.known_positions
        radius = max(radius, float(np.linalg.norm(known[:, None] - known, axis=-1).max()) / 2)
    planar = problem.array_dimension < problem.dimension
    return f_max(problem.pressures.shape[1], radius, problem.sound_speed, problem.dimension, planar)


def min_microphones(dimension: int) -> int:
    """Return the smallest number of microphones of an array in a field of two or three dimensions.

    A field of the lowest order has `dimension` + 1 functions. In the plane the same number of equations must remain for
    the positions; in space fewer microphones suffice if there are several takes (`check_solvable`).
    """
    return 6 if dimension == 2 else 4


def require_range(problem: Problem, first: int, last: int) -> None:
    """Raise InputError unless modes `first` to `last`, counted from 1, were measured."""
    if not 1 <= first <= last:
        fault = f"{first} to {last} is not a range of frequencies"
        raise InputError(fault, "give two numbers from 1 up, the lower one first", key="modes")
    measured = len(problem.pressures)
    if last > measured:
        message = f"solver.modes = {last}, but {measured} frequencies were measured"
        raise InputError(message, f"use at most {measured} frequencies (<modes>), or measure more", key="modes")


MIN_MODES = {2: 6, 3: 12}  # smallest number of modes, by the dimension of the sound field


def require_modes(problem: Problem, count: int) -> None:
    """Raise InputError unless `count` modes were measured and are enough for the unknown coordinates."""
    require_range(problem, 1, count)
    microphones, enough = problem.pressures.shape[1], min_microphones(problem.dimension)
    if microphones < enough:
        raise InputError(f"{microphones} microphones are too few to find", f"use {enough} or more", key="pressures")
    equations = max(1, 2 * (microphones - problem.dimension - 1))  # real equations of a row after the fit of a field
    unknowns = problem.array_dimension * len(problem.free)
    needed = max(MIN_MODES[problem.dimension], -(-unknowns // equations) + 1)
    if count < needed:
        message = f"{count} frequencies are too few for {unknowns} unknown coordinates"
        raise InputError(message, f"use at least {needed} frequencies (<modes>)", key="modes")


def check_solvable(problem: Problem, modes: int, names: Sequence[str]) -> None:
    """Raise InputError for a problem that no solver can work on with its lowest `modes` modes.

    The reasons are two known microphones at the same position, too few microphones, takes or modes, microphones on one
    line (in space, on one plane), and pressures of a single wave.
    """
    for (a, place), (b, other) in combinations(zip(problem.known, problem.known_positions, strict=True), 2):
        if np.array_equal(place, other):
            message = f'known microphones "{names[a]}" and "{names[b]}" have the same given position {place.tolist()} m'
            raise InputError(message, "correct known_positions", key="known_positions")
    (measured, N), D, takes = problem.pressures.shape, problem.array_dimension, len(np.unique(problem.takes))
    # Without given positions the array is only sought up to a rigid motion.
    unknowns = D * len(problem.free) - (0 if len(problem.known) else D * (D + 1) // 2)
    # A standing wave is real except for its phase, so that a row has one real equation for each microphone beyond the
    # number of functions of a field of the lowest order. If there are no such microphones, only the direct sound of a
    # take determines positions. It is one wave from an unknown direction, which leaves N - dimension equations per
    # take.
    needed = 1 if N > problem.dimension + 1 else -(-unknowns // max(1, N - problem.dimension))
    if N < min_microphones(problem.dimension):
        message = f"{N} microphones are too few: a field of the lowest order has {problem.dimension + 1} functions"
        raise InputError(message, f"use {min_microphones(problem.dimension)} microphones or more", key="pressures")
    if takes < needed:
        message = f"{N} microphones are too few with {takes} take{'s' if takes > 1 else ''}"
        remedy = f"record {needed} takes with the source at different places, or use {problem.dimension + 2} or more"
        raise InputError(message, f"{remedy} microphones", key="pressures")
    needed, used = -(-unknowns // max(1, N - D - 1)), min(modes, measured)
    if used < needed:
        fault = (
            f"{used} frequencies are too few for {unknowns} unknown coordinates of {len(problem.free)} microphones;"
            f" at least {needed} are needed"
        )
        remedy = "measure more" if measured < needed else f"use <modes> {needed} or more"
        raise InputError(fault, remedy, key="modes")
    if fixes_gauge(problem.known_positions):
        return
    if is_single_wave(problem.pressures[:modes]):
        raise InputError(SINGLE_WAVE, SINGLE_WAVE_REMEDY, key="pressures")
    if seem_in_line(problem, modes):
        where = "on a line" if D == 2 else "on a plane"
        raise InputError(
            f"the pressures vary in {D - 1} independent direction{'s' if D > 2 else ''} only: the microphones seem to"
            f" stand {where}, or the sound came from few directions",
            f"record another take with the source elsewhere, {'set <array_dimension> 2, ' if D == 3 else ''}spread them"
            f" out, or name {D + 1} known ones that are not {where}",
            key="positions",
        )


# Microphones on a line have a second singular vector that is a polynomial of the first one.
LINE_DEGREE = 4  # degree of the polynomial in the plane
LINE_EXPLAINED = 0.97  # smallest fraction of the last singular vector that the polynomial explains
LINE_FLATNESS = 0.25  # largest ratio of the last to the first singular value


def seem_in_line(problem: Problem, modes: int) -> bool:
    """Return whether the microphones seem to stand on one line (in space, in one plane).

    In that case the last singular vector is a polynomial of the others. The same happens for any array if the sound
    only travels along one line or plane, because the pressures do not change perpendicular to it: 18 of 60 arrays of 16
    microphones in fields of three waves are refused.
    """
    N, D = problem.pressures.shape[1], problem.array_dimension
    shape, values, _ = singular_vectors(problem, modes)
    first, last = shape[:, :-1] / np.abs(shape[:, :-1]).max(axis=0), shape[:, -1]
    powers = np.indices((LINE_DEGREE + 1,) * (D - 1)).reshape(D - 1, -1)
    powers = powers[:, powers.sum(axis=0) <= (LINE_DEGREE if D == 2 else 2)]
    if 2 * powers.shape[1] > N:
        return False
    terms = np.asarray(np.prod(first[:, :, None] ** powers, axis=1))
    left = last - terms @ np.linalg.lstsq(terms, last, rcond=None)[0]
    polynomial = np.sum(left**2) < (1 - LINE_EXPLAINED) * np.sum(last**2)
    return bool(polynomial and values[-1] < LINE_FLATNESS * values[0])
