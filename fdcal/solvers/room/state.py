"""State of the solver of known rooms, and what a measurement must hold for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from ...model.power import mode_power
from ...model.problem import Problem
from ...model.settings import SolverSettings
from ...model.validation import InputError, frozen_array
from ..interface import RunState
from .thresholds import NOISE, SIZES


@dataclass(frozen=True)
class ArrayCandidate:
    """An array that the search has found.

    Attributes
    ----------
    width : float, rad/m, half the width of a resonance
    positions : (N, D) float64, metres
    """

    width: float
    positions: np.ndarray


@dataclass(frozen=True)
class SourceCandidate:
    """A place of the source that the search has found: (D,) float64, metres, and the admittance of the walls."""

    place: np.ndarray
    admittance: float


PhaseName = Literal["search", "diffuse", "source", "rough", "relocated", "exact"]


@dataclass(frozen=True)
class Phase:
    """The present stage.

    Attributes
    ----------
    name : "search", "diffuse", "source", "rough", "relocated" or "exact", see `fdcal.solvers.room.solver`
    spread : int, index into the lattice errors that phase "diffuse" goes through
    steps : int, taken in this stage
    damping : float, of the next step
    """

    name: PhaseName
    spread: int
    steps: int
    damping: float


@dataclass(frozen=True)
class AttemptEnd:
    """Where an attempt has ended.

    Attributes
    ----------
    positions : (N, D) float64, metres
    walls : (D + 2,) float64, as of `State`
    cost : float
    settled : bool, whether it ended because nothing moved any more
    """

    positions: np.ndarray
    walls: np.ndarray
    cost: float
    settled: bool


@dataclass(frozen=True)
class Attempts:
    """What is left to try, and what was found.

    Attributes
    ----------
    arrays : candidates of `array_search`, the next first
    sources : candidates of `source_search` for the present array, the next first
    best : AttemptEnd or None, the best of the attempts that have ended with phase "exact"
    rejected : AttemptEnd or None, the best of those that have ended before, as too much was left unexplained
    """

    arrays: tuple[ArrayCandidate, ...]
    sources: tuple[SourceCandidate, ...]
    best: AttemptEnd | None
    rejected: AttemptEnd | None


@dataclass(frozen=True)
class MeasurementNoise:
    """Noise power (M,) of all modes measured, in the unit of abs(pressures)**2, and whether it was reported."""

    power: np.ndarray
    given: bool


@dataclass(frozen=True)
class State(RunState):
    """Everything `step` needs. A run can be continued from any state.

    The seed is not used: nothing is drawn.

    Attributes
    ----------
    phase : Phase
    attempts : Attempts
    noise : MeasurementNoise
    walls : (D + 2,) float64, source, metres, and admittance of the walls, real and imaginary part
    width : float, rad/m, half the width of a resonance, of the diffuse model
    cost : in phase "exact" the squared residuals over the noise; before, -log likelihood
    """

    solver: ClassVar[str] = "room"

    phase: Phase
    attempts: Attempts
    noise: MeasurementNoise
    walls: np.ndarray
    width: float

    @property
    def size(self) -> tuple[float, ...]:
        """Lengths of the room, metres."""
        if self.settings.room is None:
            raise ValueError("a state of this solver has settings with the size of the room")
        return self.settings.room

    @property
    def theta(self) -> np.ndarray:
        """The unknowns of the exact model : (N D + D + 2,) float64."""
        return np.concatenate([self.positions.ravel(), self.walls])


def freedom(modes: int, count: int, D: int) -> float:
    """Return the number of complex pressures less that of the unknowns of the exact model.

    Parameters
    ----------
    modes, count, D : numbers of modes, of microphones and of dimensions
    """
    return max(modes * (count - 1) - (count * D + D + 2) / 2, 1.0)


def noise_of(problem: Problem, settings: SolverSettings) -> MeasurementNoise:
    """Return the noise that the settings or the measurement report, or a guess."""
    power = mode_power(problem.pressures)
    if settings.snr_db is not None:
        return MeasurementNoise(frozen_array(power / (1 + 10 ** (settings.snr_db / 10)), float), True)
    given = problem.noise_power if settings.noise == "reported" else None
    if given is not None and np.all(given > 0):  # a simulation without noise is still no exact room
        return MeasurementNoise(frozen_array(given, float), True)
    return MeasurementNoise(frozen_array(NOISE.guess * power, float), False)


def scaled(problem: Problem, state: State, modes: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return pressures of unit RMS (modes, N), their noise power (modes,) and wavenumbers (modes,), rad/m."""
    p = problem.pressures[modes]
    power = mode_power(p)
    noise = np.maximum(state.noise.power[modes] / power, NOISE.least)
    return p / np.sqrt(power)[:, None], noise, problem.wavenumbers[modes]


def require_enough(count: int, D: int, modes: int) -> None:
    """Raise InputError if the pressures of `count` microphones are fewer than the unknowns."""
    needed = -(-(count * D + D + 2) // max(count - 1, 1))
    if count < 2 or modes < needed:
        raise InputError(
            f"{modes} modes of {count} microphones are too few for a known room",
            f"use {needed} modes (<modes>) or more, and two microphones at least",
            key="modes",
            value=modes,
        )


def require_room(problem: Problem, settings: SolverSettings) -> tuple[float, ...]:
    """Return the size of the room, metres.

    Raises
    ------
    InputError
        Without the size of the room, or for one that the measurement does not fit.
    """
    size, D, (measured, N) = settings.room, problem.dimension, problem.pressures.shape
    if size is None:
        raise InputError(
            'solver "room" needs the size of the room', "give <room> LxW, or LxWxH for a field of three dimensions"
        )
    text = "x".join(f"{length:g}" for length in size)
    room = {"key": "room", "value": size}
    if len(size) != D:
        raise InputError(
            f"room = {text} has {len(size)} lengths, but the sound field has {D} dimensions", "give as many", **room
        )
    if problem.array_dimension != D:
        raise InputError("a known room gives all three coordinates", "set array_dimension = 3 in the measurement")
    if settings.modes > measured:
        raise InputError(
            f"solver.modes = {settings.modes}, but {measured} modes were measured",
            f"use at most {measured} modes (<modes>)",
            key="modes",
            value=settings.modes,
        )
    require_enough(N, D, settings.modes)
    k = np.real(problem.wavenumbers[: settings.modes])
    if k.max() < np.pi / max(size):
        lowest = problem.sound_speed / 2 / max(size)
        raise InputError(
            f"room = {text}: a room so small has its first resonance at {lowest:.4g} Hz, above all frequencies in use",
            "give <room> in metres",
            **room,
        )
    top = SIZES.highest(D) / np.pi
    if settings.modes * np.prod([1 + top * length for length in size]) > SIZES.response:
        raise InputError(f"room = {text}: a room so large has too many modes", "give <room> in metres", **room)
    outside = np.any((problem.known_positions < 0) | (problem.known_positions > np.asarray(size)), axis=1)
    if outside.any():
        n = int(np.flatnonzero(outside)[0])
        raise InputError(
            f"room = {text}: known microphone {problem.known[n]} at {problem.known_positions[n].tolist()} m stands"
            " outside",
            "give positions from a corner of the room, or <known> none",
            **room,
        )
    return size
