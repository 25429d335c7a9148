"""State of the solver of known rooms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from ...model.power import mode_power
from ...model.problem import Problem
from ...model.settings import SolverSettings
from ...model.validation import frozen_array
from ..interface import RunState
from .thresholds import NOISE


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
    settled : bool, whether it ended because no microphone moved
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
