"""State of the joint solver: all that one step needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from ..interface import RunState

PhaseName = Literal["deformation", "free", "refinement", "angular_prior"]


@dataclass(frozen=True)
class Phase:
    """The present stage.

    Attributes
    ----------
    name : "deformation", "free", "refinement" or "angular_prior", see `fdcal.solvers.joint.solver`
    degree : int, of the polynomials of phase "deformation"
    origin : (N, D) float64, metres, positions at the beginning of the stage; the polynomials are functions of these
    steps : int, taken in this stage
    damping : float, of the next step
    """

    name: PhaseName
    degree: int
    origin: np.ndarray
    steps: int
    damping: float


@dataclass(frozen=True)
class FieldAssumptions:
    """What the stage assumes of the noise and of the sound field.

    Attributes
    ----------
    noise : (M,) float64, assumed noise power of every mode measured, in the unit of abs(pressures)**2
    noise_power : (M,) float64, noise power of the measurement, reported or estimated, in the same unit
    noise_given : bool, whether it was reported
    near_field : bool, whether a source near the array and damping are allowed for
    spread : float, metres, estimated error of a microphone's position at the beginning of the stage
    prior : (modes in use, Q) float64, power by direction, or None for a diffuse field
    prior_updates : int, stages of phase "angular_prior" begun
    """

    noise: np.ndarray
    noise_power: np.ndarray
    noise_given: bool
    near_field: bool
    spread: float
    prior: np.ndarray | None
    prior_updates: int


@dataclass(frozen=True)
class AttemptEnd:
    """Where an attempt has ended.

    Attributes
    ----------
    cost : float, as of `fdcal.solvers.residual_noise.noise_at`
    settled : bool, whether it ended because no microphone moved
    positions, origin : (N, D) float64, metres
    noise, noise_power : (M,) float64
    near_field : bool
    """

    cost: float
    settled: bool
    positions: np.ndarray
    origin: np.ndarray
    noise: np.ndarray
    noise_power: np.ndarray
    near_field: bool


@dataclass(frozen=True)
class Attempt:
    """The present attempt.

    Attributes
    ----------
    number : int, index into `fdcal.solvers.initial_positions.attempts`
    rounds : int, stages of phases "free" and "refinement" begun in this attempt
    best : AttemptEnd or None, the likeliest end of the attempts before
    """

    number: int
    rounds: int
    best: AttemptEnd | None


@dataclass(frozen=True)
class State(RunState):
    """Everything `step` needs. A run can be continued from any state.

    Without known microphones the positions are determined up to rotation, translation and mirror.

    Attributes
    ----------
    phase : Phase
    field : FieldAssumptions
    attempt : Attempt
    cost : of the modes in use, dimensionless: -log likelihood up to a constant, or Eq. 7
    """

    solver: ClassVar[str] = "joint"

    phase: Phase
    field: FieldAssumptions
    attempt: Attempt

    @property
    def best_positions(self) -> np.ndarray:
        """The end of the best attempt (N, D), metres; before the first has ended, the present positions."""
        return self.positions if self.finished or self.attempt.best is None else self.attempt.best.positions

    @property
    def assessment_noise(self) -> np.ndarray | None:
        """The noise power of the measurement; None in the near field, where the assessment estimates it."""
        return None if self.field.near_field else self.field.noise_power
