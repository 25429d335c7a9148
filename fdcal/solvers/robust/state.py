"""State of the likelihood solver, the stages of its schedule, and the numbers that several of its modules use.

The other numbers stand above the functions that use them. Those that were ablated carry a figure: what gets worse
without them on the field suite (482 cases, or those of the families that the number serves; 75 where it says so). Among
these are DAMPED and GROSS_GAIN_SIGMA. Without NOISE_TOLERANCE, that is with one round, a simulated array of 48
microphones is left 2 mm away, with the verdict "model_mismatch".

MAX_ROUNDS bounds the time: with 3 instead of 8, 55 of 73 cases are the same, three better and two worse. With
MAX_RESTARTS 3 one of 65 is worse and two good ones become ambiguous; with SAME_PLACE 0.3 an array 278 mm off is good;
with SUSPICIOUS 12 two of 62 are better and three worse. MAX_SIGMA has no effect on 49 cases. What else has no figure
bounds memory or steps, or sets units.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...model.problem import ChannelCorrection
from ...model.validation import Bools, InputError, Reals
from ..interface import RunState

# of the search for the array without given positions: steps at most, and nats after which it ends. Without either
# every result is the same; without the second these arrays take 1.2 times the time.
FREE_STEPS = 8
NEGLIGIBLE_DECREASE = 0.05

# factor on the power of the field for the covariance, as of the verdict: rooms are less isotropic than their model;
# without it ellipses cover 87.8 instead of 92.7 %
WEAKER_FIELD = 4.0

DELAY_SIGMA = 0.5  # metres, spread of a delay times the sound speed, of a channel that alone has one
CORNER_SIGMA = 2.0  # rad/m, spread of a high-pass corner times 2 pi / c, likewise

# metres, one sigma of a given coordinate: with it a run begins, and before a hypothesis it is the greatest
GIVEN_SIGMA = 3e-3

SUSPICIOUS = 4.0  # channel noise over that of the others from which a channel is examined

# steps of expectation and maximisation of the directions' power before the first step, and after every step; with 1
# the errors grow by 2 %
DIRECTION_UPDATES = 3

# least fraction of noise in the power: of an undamped isotropic field, which leaves that much of any room unexplained,
# and of the others; with 1e-10 the covariance without noise depends on the frame
MIN_NOISE_FRACTION = {"isotropic": 1e-6, "others": 1e-8}

STAGE_DAMPING = 1e-6  # of the first step of a stage


@dataclass(frozen=True)
class Stage:
    """One stage of the schedule; what follows it is in `schedule.TRANSITIONS`."""

    name: str  # for display
    degree: int  # of the polynomials by which the array may deform as a whole; 0 lets every microphone move for itself
    # at most so many modes, evenly taken; 0 for all. With degree 3 twice and all modes a wrong array is good, and noisy
    # ones take twice the time.
    modes: int
    lowest: bool  # with given positions the lowest ones instead: they hold the scale
    gains: bool  # whether channel gains are free
    max_steps: int  # at most
    tolerance: float  # metres, a stage ends when nothing moves further
    # nats, or when the cost falls by no more. Without tolerances and with equal bounds on steps (and with one damping,
    # as now) as many arrays are right, and array 1 takes 1.3 to 1.9 times the time.
    negligible: float


STAGES = (
    Stage("deformation", 2, 30, True, False, 12, 2e-3, 0.5),
    Stage("deformation", 3, 30, False, False, 12, 2e-3, 0.5),
    Stage("free", 0, 0, False, False, 5, 1e-3, 2.0),
    Stage("gains", 0, 0, False, True, 10, 1e-4, 0.3),
    Stage("final", 0, 0, False, True, 16, 3e-5, 0.01),
)
FREE, FINAL = 2, 4  # stages


@dataclass(frozen=True)
class Model:
    """Field, noise and spreads that are assumed; updated by maximum likelihood while the solver runs."""

    power: Reals  # (M,) float64, of the field; every mode of the problem has a mean power of 1
    noise: Reals  # (M,) float64, of a healthy channel, likewise
    channel_noise: Reals  # (N,) float64, noise of each channel over that, tau
    noise_fraction: float  # noise as a part of the mean power
    spread: float  # metres, error of the positions that, with the noise, explains the residual
    # gain_sigma, phase_sigma: nepers and radians
    gain_sigma: float
    phase_sigma: float
    known_sigma: float  # metres; 0 for exact given positions, which never move
    damped: bool  # whether the imaginary part of the wavenumbers counts
    directional: bool  # whether the power of the field depends on the direction
    # (A, D) float64, metres, of the microphones whose position is given; two that were exchanged put right
    places: Reals
    contradicted: Bools  # (A,) bool, which of them hold nothing, since the pressures contradict them
    # (N, 2) float64, delay, metres, times the sound speed, and high-pass corner, rad/m, times 2 pi / c, of each channel
    filters: Reals
    log_speed: float = 0.0  # logarithm of the sound speed over that of the measurement
    # (M, Q) float64, power of the field by direction, mean 1; of a directional field, once it was learned
    directions: Reals | None = None
    # (T,) float64, metres, one sigma of the arrivals of each take; None before they count
    arrival_sigma: np.ndarray | None = None
    # delay_sigma, corner_sigma: spread of the delays, metres, and of the corners, rad/m, of all channels; 0 where only
    # those of a faulty channel are sought
    delay_sigma: float = 0.0
    corner_sigma: float = 0.0
    # of the short windows, once they were fitted: positions (N, D), metres, and precision (N D, N D), 1/m^2
    window_positions: np.ndarray | None = None
    window_precision: np.ndarray | None = None
    window_ratio: float = 1.0  # `WindowTerm.disagreement`
    tempering: float = 1.0  # by which the cost of the long rows is divided beside short windows

    @property
    def min_noise(self) -> float:
        """The least fraction of noise in the power that the model of the field can show."""
        return MIN_NOISE_FRACTION["others" if self.damped or self.directional else "isotropic"]


@dataclass(frozen=True)
class LocalOptimum:
    """Where a restart ended: positions (N, D), metres, gains and offsets (N, 2), model, and the score that ranks it."""

    positions: np.ndarray
    gains: np.ndarray
    offsets: np.ndarray
    model: Model
    score: float
    converged: bool


@dataclass(frozen=True)
class StageProgress:
    """Where the solver is."""

    restart: int  # number of the start in `fdcal.solvers.starts.plan`; -1 for positions that the run was begun with
    stage: int  # index into STAGES
    rounds: int  # of this stage so far
    steps: int  # in this stage
    damping: float  # of the next step

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

    gains: Reals  # (N, 2) float64, logarithm of the gain, nepers, and phase, radians, of each channel
    # (N, 2) float64, likewise, about which the gains scatter: 0 but for a channel with a gross fault
    offsets: Reals
    model: Model
    progress: StageProgress
    # (N, D) float64, metres, positions at the beginning of the stage, which fix the deformations and the centre
    shape: Reals
    optima: tuple[LocalOptimum, ...]  # of the restarts so far

    @property
    def restart(self) -> int:
        """Number of the start that the run has come from last."""
        return self.progress.restart

    @property
    def best_positions(self) -> np.ndarray:
        """The best positions (N, D) so far, metres: those of the likeliest optimum while another restart runs."""
        reached = [one for one in self.optima if np.isfinite(one.score)]
        late = self.finished or self.progress.stage == FINAL or not reached
        return self.positions if late else min(reached, key=lambda one: one.score).positions

    @property
    def channels(self) -> ChannelCorrection:
        """Gain and noise of every channel as estimated so far."""
        return ChannelCorrection(np.exp(self.gains @ np.array([1.0, 1.0j])), self.model.channel_noise)
