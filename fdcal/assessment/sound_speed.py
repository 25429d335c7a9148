"""The sound speed from the array itself, where known microphones or one known distance provide a length.

The cost depends on wavenumber times distance only. With all wavenumbers too small by the factor 1 + e, the array comes
out larger by 1 + e, known microphones included. So their common scale becomes one more unknown, and c is the given
speed over 1 + e.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..model.problem import Problem
from ..model.validation import InputError, frozen_array
from ..solvers.levenberg_marquardt import DAMPING
from ..solvers.position_fit import position_step
from .uncertainty import pressures_and_field

STEPS = 60  # at most
SETTLED = 1e-6  # metres: a shorter step ends the descent


@dataclass(frozen=True)
class SoundSpeedEstimate:
    """A sound speed and the array that goes with it.

    Attributes
    ----------
    sound_speed : float, m/s
    positions : (N, D) float64, metres
    problem : Problem, with its wavenumbers and sound speed corrected
    """

    sound_speed: float
    positions: np.ndarray
    problem: Problem


def from_known(problem: Problem, positions, modes: slice, noise: np.ndarray | None) -> SoundSpeedEstimate:
    """Return the sound speed and the positions of greatest likelihood, from the solution at the given speed.

    Parameters
    ----------
    positions : (N, D) float64, metres
    modes : slice, the modes in use
    noise : as of `fdcal.assessment.uncertainty.pressures_and_field`

    Raises
    ------
    InputError
        There are fewer than two known microphones.
    """
    known = problem.known
    if len(known) < 2:
        raise InputError(
            "the sound speed cannot be estimated without a length",
            "name two known microphones at least, or give <distance>",
            key="estimate_sound_speed",
        )
    p, field = pressures_and_field(problem, positions, modes, noise)
    N, D = positions.shape
    centre = problem.known_positions.mean(axis=0)
    larger = np.zeros((N, D))
    larger[known] = problem.known_positions - centre
    coordinates = (D * problem.free[:, None] + np.arange(D)).ravel()
    basis = np.column_stack([np.eye(N * D)[:, coordinates], larger.ravel()])
    x, damping = np.asarray(positions, float), DAMPING.first
    for _ in range(STEPS):
        trial = position_step(x, p, field, basis, damping)
        x, damping = trial.unknowns, trial.damping
        if trial.moved < SETTLED:
            break
    scale = np.sum((x[known] - centre) * larger[known]) / np.sum(larger[known] ** 2)
    found = centre + (x - centre) / scale
    found[known] = problem.known_positions
    return _corrected(problem, problem.sound_speed / scale, found)


def from_distance(problem: Problem, positions, pair: tuple[int, int], metres: float) -> SoundSpeedEstimate:
    """Return the sound speed for which two microphones of a blind solution have a given distance.

    Parameters
    ----------
    positions : (N, D) float64, metres
    pair : numbers of the two microphones
    metres : their distance

    Raises
    ------
    InputError
        Both microphones were estimated at the same position.
    """
    positions = np.asarray(positions, float)
    apart = float(np.linalg.norm(positions[pair[0]] - positions[pair[1]]))
    if not apart > 0:
        raise InputError(
            f"microphones {pair[0]} and {pair[1]} were estimated at the same position",
            "name another pair in <distance>",
            key="distance",
        )
    centre = positions.mean(axis=0)
    return _corrected(problem, problem.sound_speed * metres / apart, centre + (positions - centre) * (metres / apart))


def _corrected(problem: Problem, sound_speed: float, positions) -> SoundSpeedEstimate:
    found = at_sound_speed(problem, float(sound_speed))
    return SoundSpeedEstimate(float(sound_speed), frozen_array(positions, float), found)


def at_sound_speed(problem: Problem, sound_speed: float) -> Problem:
    """Return `problem` with another sound speed, m/s, and the wavenumbers that go with it."""
    slower = problem.sound_speed / sound_speed
    return replace(
        problem, wavenumbers=frozen_array(problem.wavenumbers * slower, complex), sound_speed=float(sound_speed)
    )
