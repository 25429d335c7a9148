"""A problem whose modes have unit power, which the solver `robust` works with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...model.power import mode_power
from ...model.problem import Problem


def in_unit_power(problem: Problem) -> Problem:
    """Return `problem` with every mode scaled to a mean power of 1, its noise likewise."""
    power = mode_power(problem.pressures)
    if np.allclose(power, 1.0, rtol=1e-9):
        return problem
    noise = None if problem.noise_power is None else problem.noise_power / power
    return replace(problem, pressures=problem.pressures / np.sqrt(power)[:, None], noise_power=noise)
