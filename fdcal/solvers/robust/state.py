"""State of the likelihood solver, the stages of its schedule, and the constants that several of its modules use.

Constants that only one module uses are in that module, above the function that uses them. If the comment of a constant
contains a figure, it states how much worse the results of the suite `benchmarks field` (482 cases, or the cases
concerned) are without the constant. Constants without a figure bound time or memory, or set units.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...model.problem import ChannelCorrection
from ...model.validation import Bools, InputError, Reals
from ..interface import RunState

# Limits of the search for the array without given positions, which only save time: the largest number of steps, and the
# decrease of the cost in a step, nats, below which it ends.
FREE_STEPS = 8
NEGLIGIBLE_DECREASE = 0.05

# factor on the power of the field in the computation of covariances, because rooms are less isotropic than the model;
# without it the 95 % ellipses cover 5 percentage points fewer of the true positions
FIELD_POWER_FACTOR = 4.0

DELAY_SIGMA = 0.5  # metres, prior sigma of the delay times the sound speed of a single faulty channel
CORNER_SIGMA = 2.0  # rad/m, prior sigma of the high-pass corner times 2 pi / c of a single faulty channel

# metres, standard deviation of a given coordinate at the start; only a hypothesis on the given positions increases it
GIVEN_SIGMA = 3e-3

SUSPICIOUS = 4.0  # relative noise tau above which a channel is examined

# iterations of the power by direction before the first step and after every step; with 1 the errors grow by 2 %
DIRECTION_UPDATES = 2

# Smallest ratio of the noise power to the power of the pressures. An undamped isotropic field leaves about 1e-6 of the
# power in any room unexplained. Below 1e-8 the covariance of a measurement without noise would depend on the frame.
MIN_NOISE_FRACTION = {"isotropic": 1e-6, "others": 1e-8}

STAGE_DAMPING = 1e-6  # damping of the first step of a stage


@dataclass(frozen=True)
class Stage:
    """One stage of the schedule."""

    name: str  # as it is displayed
    gains: bool  # whether channel gains are free
    max_steps: int
    tolerance: float  # metres; the stage ends when no coordinate changes by more than this in a step
    negligible: float  # nats; the stage also ends when a step lowers the cost by less than this


STAGES = (
    Stage("search", False, 0, 0.0, 0.0),  # each of its steps fits one start
    Stage("free", False, 5, 1e-3, 2.0),
    Stage("gains", True, 10, 1e-4, 0.3),
    Stage("final", True, 16, 3e-5, 0.01),
)
SEARCH, FREE, GAINS, FINAL = range(4)  # numbers of the stages


@dataclass(frozen=True)
class Model:
    """Assumptions on field, noise and prior sigmas; the solver updates them by maximum likelihood."""

    power: Reals  # (M,) float64, power of the field; the pressures of every mode have a mean power of 1
    noise: Reals  # (M,) float64, noise power of a healthy channel, in the same unit
    channel_noise: Reals  # (N,) float64, tau, noise power of each channel relative to a healthy one
    noise_fraction: float  # noise power divided by the mean power of the pressures
    spread: float  # metres, RMS position error that, together with the noise, explains the residual
    gain_sigma: float  # nepers, prior sigma of the log gains
    phase_sigma: float  # radians, prior sigma of the phases
    known_sigma: float  # metres, prior sigma of each given coordinate; 0 for exact given positions, which never move
    damped: bool  # whether the imaginary part of the wavenumbers is used
    directional: bool  # whether the power of the field depends on the direction
    places: Reals  # (A, D) float64, metres, the given position that belongs to each known microphone
    contradicted: Bools  # (A,) bool, given positions that are ignored because the pressures contradict them
    # (N, 2) float64, delay times the sound speed, metres, and high-pass corner times 2 pi / c, rad/m, of each channel
    filters: Reals
    log_speed: float = 0.0  # logarithm of the ratio of the sound speed to that of the measurement
    # (M, Q) float64, power of the field by direction, mean 1; None until it is learned
    directions: Reals | None = None
    # (T,) float64, metres, c times the standard deviation of the arrival times of each take; None until arrivals are
    # used
    arrival_sigma: np.ndarray | None = None
    # prior sigma of the delays, metres, and of the corners, rad/m, of all channels; 0 if only faulty channels have them
    delay_sigma: float = 0.0
    corner_sigma: float = 0.0
    # result of the fit to the short windows: positions (N, D), metres, precision (N D, N D), 1/m^2, divided by
    # `window_ratio`, and another array (N, D) that explains the windows as well, if there is one
    window_positions: np.ndarray | None = None
    window_precision: np.ndarray | None = None
    window_rival: np.ndarray | None = None
    window_ratio: float = 1.0  # result of `WindowTerm.disagreement`
    tempering: float = 1.0  # divisor of the cost of the long rows if short windows are used


@dataclass(frozen=True)
class FittedStart:
    """The array at which starts end after their fit from low to high frequencies."""

    positions: Reals  # (N, D) float64, metres
    healthy: Bools  # (N,) bool, channels without much noise
    cost: float  # negative log-likelihood up to a constant
    hits: int  # number of starts that have ended at this array


@dataclass(frozen=True)
class LocalOptimum:
    """The end of a restart."""

    positions: np.ndarray  # (N, D) float64, metres
    # (N, 2) float64, as in `State`
    gains: np.ndarray
    offsets: np.ndarray
    model: Model
    score: float  # negative log evidence up to a constant
    converged: bool


@dataclass(frozen=True)
class StageProgress:
    """Position of the solver in its schedule."""

    restart: int  # number of restarts before this one; -1 in the search
    stage: int  # index into STAGES
    rounds: int  # number of completed rounds of this stage
    steps: int  # number of steps taken in this round or, in the search, of starts tried
    damping: float  # damping of the next step

    def __post_init__(self):
        if not 0 <= self.stage < len(STAGES):  # a session file may have been edited
            raise InputError(f"progress.stage = {self.stage} must be from 0 to {len(STAGES) - 1}", key="progress.stage")


@dataclass(frozen=True)
class State(RunState):
    """State of the likelihood solver."""

    solver: ClassVar[str] = "robust"
    # whether directions are only learned in the plane, where there are few of them
    quick: ClassVar[bool] = False

    gains: Reals  # (N, 2) float64, logarithm of the gain, nepers, and phase, radians, of each channel
    offsets: Reals  # (N, 2) float64, prior mean of `gains`; 0 unless a channel has a gross fault
    model: Model
    progress: StageProgress
    # (N, D) float64, metres, positions at the beginning of the stage, whose mean is the centre of the field
    stage_start: Reals
    # arrays found so far or, after the search, those still to be refined, most likely first; None before the search
    starts: tuple[FittedStart, ...] | None
    optima: tuple[LocalOptimum, ...]  # the optima that the restarts have reached so far

    @property
    def restart(self) -> int:
        """Number of the present restart, from 0; -1 in the search."""
        return self.progress.restart

    @property
    def best_positions(self) -> np.ndarray:
        """The best positions (N, D) so far, metres; while another restart runs, those of the most likely optimum."""
        reached = [one for one in self.optima if np.isfinite(one.score)]
        late = self.finished or self.progress.stage == FINAL or not reached
        return self.positions if late else min(reached, key=lambda one: one.score).positions

    @property
    def channels(self) -> ChannelCorrection:
        """Gain and noise of every channel as estimated so far."""
        return ChannelCorrection(np.exp(self.gains @ np.array([1.0, 1.0j])), self.model.channel_noise)
