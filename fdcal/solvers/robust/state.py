"""State of the solver `robust`: everything that one step needs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from .settings import RobustSettings


@dataclass(frozen=True)
class Model:
    """What is supposed beside positions and gains; updated by maximum likelihood as the solver goes.

    Attributes
    ----------
    power : (M,) float64, of the field, in the unit of abs(pressures)**2
    noise : (M,) float64, of a sound channel, in the same unit
    channel_noise : (N,) float64, noise of each channel over that, tau
    share, spread : float, noise as a share of the power of the pressures, and the error of the positions, metres,
        that together explain what is left
    gain_sigma, phase_sigma : float, nepers and radians
    known_sigma : float, metres
    kernel : "diffuse", "series" or "near"
    """

    power: np.ndarray
    noise: np.ndarray
    channel_noise: np.ndarray
    share: float
    spread: float
    gain_sigma: float
    phase_sigma: float
    known_sigma: float
    kernel: str = "diffuse"


@dataclass(frozen=True)
class End:
    """Where an attempt ended: positions (N, D), gains and offsets (N, 2), model, and the score that ranks it."""

    positions: np.ndarray
    gains: np.ndarray
    offsets: np.ndarray
    model: Model
    score: float
    converged: bool


@dataclass(frozen=True)
class State:
    """Attributes: positions (N, D) metres; gains, offsets (N, 2) nepers and radians; row of the schedule and steps
    taken in it; ends of the attempts so far.
    """

    solver: ClassVar[str] = "robust"
    positions: np.ndarray
    gains: np.ndarray
    offsets: np.ndarray
    model: Model
    settings: RobustSettings
    seed: int
    step: int = 0
    stage: int = 0
    row: int = 0
    stage_steps: int = 0
    rounds: int = 0
    attempt: int = 0
    damping: float = 1e-3
    cost: float = 0.0
    shape: np.ndarray | None = None
    ends: tuple[End, ...] = field(default=())
    finished: bool = False
    converged: bool = False
