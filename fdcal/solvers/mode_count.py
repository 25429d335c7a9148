"""How many modes a calibration uses unless their number is given: all that were measured, with three limits.

- what the array can interpolate (Eq. 9), for the radius that its coherence and its known microphones show. The radius
  is good to a factor of 1.5, and so are the frequencies above the limit; the verdict checks the array that was found;
- what the solver can use;
- what fits into memory.
"""

from __future__ import annotations

import numpy as np

from ..acoustics.coherence import array_radius
from ..acoustics.fourier_bessel import f_max
from ..model.limits import LIMITS
from ..model.problem import Problem

RADIUS_FACTOR = 1.5  # by which the radius of `array_radius` may be too large


def mode_count(problem: Problem, usable: int) -> int:
    """Return how many of the lowest modes a calibration uses unless their number is given.

    Parameters
    ----------
    problem : Problem
    usable : int
        Number of modes that the solver can use.
    """
    measured, microphones = problem.pressures.shape
    interpolated = int(np.sum(problem.frequencies <= highest_frequency(problem)))
    return max(1, min(measured, usable or measured, interpolated or measured, int(LIMITS.pairs // microphones**2)))


def highest_frequency(problem: Problem) -> float:
    """Return f_max of the smallest array that the measurement speaks for, Hz; infinite where nothing tells.

    Parameters
    ----------
    problem : Problem
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
