"""State of the solver `joint`: all that one step needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..interface import RunState


@dataclass(frozen=True)
class State(RunState):
    """Everything `step` needs to go on, so that any state can be gone on from.

    Attributes
    ----------
    positions : (N, D) float64, metres, read-only; up to rotation, translation and mirror without known microphones
    settings : SolverSettings
    seed : int, of a random start
    step, sweep, stage : steps taken (twice), stages completed
    moved : -1, since all microphones move
    first, last : modes in use, counted from 1, both included
    automatic : whether modes are added when settled
    phase : "bend", "free", "sharp" or "learned"
    prior : (modes in use, Q) float64, power by direction, or None for a diffuse field
    lessons : stages of phase "learned" begun
    near : whether a near source and damping count
    degree : of the polynomials that bend the array
    shape : (N, D) float64, metres, positions at the beginning of the stage, of which the polynomials are
    attempt : which of `initial_positions.attempts`
    best : of the likeliest of the attempts before (cost as of `initial_positions.left_over`, converged, positions,
        shape, noise,
        noise_power, near), or None
    rounds : stages of phases "free" and "sharp" in the present attempt
    stage_steps : steps taken in the present stage
    damping : of the next step
    noise : (M,) float64, noise power supposed, in the unit of abs(pressures)**2, read-only
    noise_power : (M,) float64, noise power of the measurement, told or estimated, likewise
    noise_told : whether it was told
    spread : metres, error of each microphone's own place that the pressures told of when the stage began
    cost : of the modes in use, dimensionless: -log likelihood up to a constant, or Eq. 7
    finished : nothing is left to do
    converged : finished because no microphone moved any more, not because steps ran out
    """

    solver: ClassVar[str] = "joint"

    phase: str
    prior: np.ndarray | None
    lessons: int
    near: bool
    degree: int
    shape: np.ndarray
    attempt: int
    best: tuple | None
    rounds: int
    stage_steps: int
    damping: float
    noise: np.ndarray
    noise_power: np.ndarray
    noise_told: bool
    spread: float

    @property
    def assessment_noise(self) -> np.ndarray | None:
        """The noise power of the measurement; None in the near field, whose residual is the real kernel's own."""
        return None if self.near else self.noise_power
