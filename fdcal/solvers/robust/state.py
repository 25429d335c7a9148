"""State of the likelihood solver: everything that one step needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from ...cost.channel_correction import ChannelCorrection
from ...model.validation import InputError
from ..interface import RunState
from .rules import NOISELESS, STAGES

KernelName = Literal["diffuse", "series", "near", "directional", "damped_directional"]
UNDAMPED: tuple[KernelName, ...] = ("diffuse", "directional")  # which leave out the imaginary part of wavenumbers
DIRECTIONAL: tuple[KernelName, ...] = ("directional", "damped_directional")


@dataclass(frozen=True)
class Model:
    """Field, noise and spreads that are assumed; updated by maximum likelihood while the solver runs."""

    power: np.ndarray  # (M,) float64, of the field; every mode of the problem has a mean power of 1
    noise: np.ndarray  # (M,) float64, of a healthy channel, likewise
    channel_noise: np.ndarray  # (N,) float64, noise of each channel over that, tau
    share: float  # noise as a part of the mean power
    spread: float  # metres, error of the positions that, with the noise, explains the residual
    # gain_sigma, phase_sigma: nepers and radians
    gain_sigma: float
    phase_sigma: float
    known_sigma: float  # metres; 0 for exact given positions, which never move
    kernel: KernelName  # "diffuse", "series", "near", "directional", or "damped_directional" of complex wavenumbers
    # (A, D) float64, metres, of the microphones whose position is given; two that were exchanged put right
    places: np.ndarray
    contradicted: np.ndarray  # (A,) bool, which of them hold nothing, since the pressures contradict them
    # (N, 2) float64, delay, metres, times the sound speed, and high-pass corner, rad/m, times 2 pi / c, of each channel
    filters: np.ndarray
    log_speed: float = 0.0  # logarithm of the sound speed over that of the measurement
    # (M, Q) float64, power of the field by direction, mean 1; of the directional kernels only
    directions: np.ndarray | None = None
    # kernel of the conditional likelihood that the last stage minimises; "" for that of a random field
    conditional: Literal["", "diffuse", "series"] = ""
    deflation: float = 1.0  # of the noise that is assumed, by which the residual is larger
    # (T,) float64, metres, one sigma of the arrivals of each take; None before they count
    arrival_sigma: np.ndarray | None = None
    # delay_sigma, corner_sigma: spread of the delays, metres, and of the corners, rad/m, of all channels; 0 where only
    # those of a faulty channel are sought
    delay_sigma: float = 0.0
    corner_sigma: float = 0.0


@dataclass(frozen=True)
class LocalOptimum:
    """Where a restart ended: positions (N, D), metres, gains and offsets (N, 2), model, and the score that ranks it.

    `regrouped` tells that the restart began from another optimum: the two do not confirm each other.
    """

    positions: np.ndarray
    gains: np.ndarray
    offsets: np.ndarray
    model: Model
    score: float
    converged: bool
    regrouped: bool = False


@dataclass(frozen=True)
class Progress:
    """Where the solver is."""

    restart: int  # number of the start in `fdcal.solvers.starts.plan`; -1 for positions that the run was begun with
    stage: int  # index into `rules.STAGES`
    rounds: int  # of this stage so far
    steps: int  # in this stage
    damping: float  # of the next step
    # whether the restart began where another ended, with a group of microphones in another pose
    regrouped: bool = False
    # (N, D) float64 each, metres, arrays of such restarts that are still to be tried
    poses: tuple[np.ndarray, ...] = ()

    def __post_init__(self):
        if not 0 <= self.stage < len(STAGES):  # of a session file that somebody has changed
            raise InputError(f"progress.stage = {self.stage} must be from 0 to {len(STAGES) - 1}", key="progress.stage")


@dataclass(frozen=True)
class State(RunState):
    """State of the likelihood solver."""

    solver: ClassVar[str] = "robust"
    # whether one restart that leaves no more than the reported noise is believed, and directions are learned in the
    # plane alone, where they are few
    quick: ClassVar[bool] = False

    gains: np.ndarray  # (N, 2) float64, logarithm of the gain, nepers, and phase, radians, of each channel
    # (N, 2) float64, likewise, about which the gains scatter: 0 but for a channel with a gross fault
    offsets: np.ndarray
    model: Model
    progress: Progress
    # (N, D) float64, metres, positions at the beginning of the stage, which fix the deformations and the centre
    shape: np.ndarray
    optima: tuple[LocalOptimum, ...]  # of the restarts so far

    @property
    def best_positions(self) -> np.ndarray:
        """The best positions (N, D) so far, metres: those of the likeliest optimum while another restart runs."""
        reached = [one for one in self.optima if np.isfinite(one.score)]
        late = self.finished or self.progress.stage >= NOISELESS or not reached
        return self.positions if late else min(reached, key=lambda one: one.score).positions

    @property
    def channels(self) -> ChannelCorrection:
        """Gain and noise of every channel as estimated so far."""
        return ChannelCorrection(np.exp(self.gains @ np.array([1.0, 1.0j])), self.model.channel_noise)
