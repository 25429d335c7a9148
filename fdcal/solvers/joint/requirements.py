"""What a measurement must hold for the joint solver."""

from __future__ import annotations

from ...model.problem import Problem
from ...model.validation import InputError

MIN_MODES = {2: 6, 3: 12}  # by dimension of the field: with fewer modes no array is sought


def require_modes(problem: Problem, count: int) -> None:
    """Raise InputError unless `count` modes were measured and are enough for the unknown coordinates."""
    measured, microphones = problem.pressures.shape
    D = problem.array_dimension
    if count > measured:
        raise InputError(
            f"solver.modes = {count}, but {measured} modes were measured",
            f"use at most {measured} modes (<modes>), or measure more",
            key="modes",
            value=count,
        )
    if microphones < 2 * D + 2:
        raise InputError(f"{microphones} microphones are too few to find", f"use {2 * D + 2} or more", key="pressures")
    unknowns = D * len(problem.free)
    equations = 2 * (microphones - problem.dimension - 1)  # real ones a mode, less those that its field takes up
    least = max(MIN_MODES[problem.dimension], -(-unknowns // equations) + 1)
    if count < least:
        raise InputError(
            f"{count} modes are too few for {unknowns} unknown coordinates",
            f"use at least {least} modes (<modes>)",
            key="modes",
            value=count,
        )
