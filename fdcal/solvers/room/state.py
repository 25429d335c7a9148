"""What the solver of known rooms carries from step to step, and what a measurement must hold for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...model.power import mode_power
from ...model.problem import Problem
from ...model.settings import SolverSettings
from ...model.validation import InputError
from ..interface import RunState

GUESS = 1e-4  # noise's share of the power where none is told
LEAST_NOISE = 1e-6  # likewise where it is told that there is none
ROUGH = 1e-3  # of the power, taken for noise until the walls are known
MOST_NUMBERS = 1e7  # of the response of the exact model, complex
HIGHEST = 26.0, 19.0  # rad/m, about where its sum ends, in 2-D and 3-D


@dataclass(frozen=True)
class State(RunState):
    """Everything `step` needs to go on.

    Attributes
    ----------
    positions : (N, D) float64, metres, read-only
    settings : SolverSettings; its `room` is the size
    seed : int, unused: nothing is drawn
    step, sweep, stage : steps taken (twice), stages completed
    moved : -1, since all microphones move
    first, last : modes in use, counted from 1, both included
    automatic : whether the phases follow one another by themselves
    phase : "search", "near", "source", "rough", "again" or "exact"
    arrays : of `roomsearch.arrays`, those left to try
    sources : of `roomsearch.sources`, likewise
    walls : (D + 2,) float64, source, metres, and admittance, real and imaginary part
    width : rad/m, half that of a resonance, of the first model
    round : which of SPREADS
    stage_steps : steps taken in the present stage
    damping : of the next step
    best : (positions, walls, cost, settled) of the attempts before, or None
    hopeless : (positions, walls, cost) of the best of those that ended before phase "exact", or None
    noise_power : (M,) float64, of all modes measured, told or estimated, in the unit of abs(problem.pressures)**2
    noise_told : whether it was told
    cost : squared residuals over the noise in phase "exact"; before, -log likelihood
    finished : nothing is left to do
    converged : finished because nothing moved any more, not because steps ran out
    """

    solver: ClassVar[str] = "room"

    phase: str
    arrays: tuple
    sources: tuple
    walls: np.ndarray
    width: float
    round: int
    stage_steps: int
    damping: float
    best: tuple | None
    hopeless: tuple | None
    noise_power: np.ndarray
    noise_told: bool

    @property
    def theta(self) -> np.ndarray:
        """The unknowns of the exact model."""
        return np.concatenate([self.positions.ravel(), self.walls])


def freedom(modes: int, count: int, D: int) -> float:
    """Complex numbers that the exact model leaves to the noise."""
    return max(modes * (count - 1) - (count * D + D + 2) / 2, 1.0)


def noise_of(problem: Problem, settings: SolverSettings) -> tuple[np.ndarray, bool]:
    """Noise power (M,) that the settings tell, or a guess."""
    power = mode_power(problem.pressures)
    if settings.snr_db is not None:
        return power / (1 + 10 ** (settings.snr_db / 10)), True
    told = problem.noise_power if settings.noise == "reported" else None
    if told is not None and np.all(told > 0):  # free of noise, a simulation is still no exact room
        return told, True
    return GUESS * power, False


def scaled(problem: Problem, state: State, modes: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pressures of unit RMS (modes, N), their noise (modes,) and wavenumbers."""
    p = problem.pressures[modes]
    power = mode_power(p)
    noise = np.maximum(state.noise_power[modes] / power, LEAST_NOISE)
    return p / np.sqrt(power)[:, None], noise, problem.wavenumbers[modes]


def require_enough(count: int, D: int, modes: int) -> None:
    """InputError where the pressures of `count` microphones are fewer than what is sought."""
    needed = -(-(count * D + D + 2) // max(count - 1, 1))
    if count < 2 or modes < needed:
        raise InputError(
            f"{modes} modes of {count} microphones are too few for a known room; use {needed} modes or more, and"
            " two microphones at least"
        )


def require_room(problem: Problem, settings: SolverSettings) -> tuple[float, ...]:
    """The size of the room; InputError where there is none, or one that the measurement does not fit."""
    size, D, (measured, N) = settings.room, problem.dimension, problem.pressures.shape
    if size is None:
        raise InputError(
            'solver "room" needs the size of the room: --room LxW, or LxWxH for a field of three dimensions'
        )
    text = "x".join(f"{length:g}" for length in size)
    if len(size) != D:
        raise InputError(f"--room {text} has {len(size)} lengths; the sound field has {D} dimensions, give as many")
    if problem.array_dimension != D:
        raise InputError("a known room gives all three coordinates; set array_dimension = 3 in the measurement")
    if settings.modes > measured:
        raise InputError(f"solver.modes = {settings.modes}, but {measured} modes were measured; use at most {measured}")
    require_enough(N, D, settings.modes)
    k = np.real(problem.wavenumbers[: settings.modes])
    if k.max() < np.pi / max(size):
        lowest = problem.sound_speed / 2 / max(size)
        raise InputError(
            f"--room {text}: a room so small has its first resonance at {lowest:.4g} Hz, above all frequencies in use"
        )
    top = HIGHEST[D - 2] / np.pi
    if settings.modes * np.prod([1 + top * length for length in size]) > MOST_NUMBERS:
        raise InputError(f"--room {text}: a room so large has too many modes; give its size in metres")
    outside = np.any((problem.known_positions < 0) | (problem.known_positions > np.asarray(size)), axis=1)
    if outside.any():
        n = int(np.flatnonzero(outside)[0])
        raise InputError(
            f"--room {text}: known microphone {problem.known[n]} at {problem.known_positions[n].tolist()} m stands"
            " outside; give positions from a corner of the room, or --known none"
        )
    return size
