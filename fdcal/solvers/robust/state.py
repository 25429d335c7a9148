"""The schedule of the likelihood solver, and every number that decides beside it.

What gets worse without a number stands at it, as an ablation on the field suite shows it (482 cases, or those of the
families that the number serves). Left are

- numbers without which 10 to 27 arrays were the same, too few to remove them: STEPS.converged_sigmas, restarts, rounds,
  same_place, low_noise and tolerance_noise of SCHEDULE, ASSUMED.near_share and damped, OUTLIERS.suspicious and
  gain_sigma, GIVEN.max_sigma;
- numbers that were not ablated alone: STEPS.damping and min_eigenvalue, ASSUMED.max_products, CONDITIONAL.power,
  OUTLIERS.spacing and candidates, GIVEN.sigma, those of delays and corners that have no figure, and the columns
  max_steps, lowest, gains and learns of STAGES.

State of the likelihood solver: everything that one step needs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import ClassVar, Literal

import numpy as np

from ...cost.channel_correction import ChannelCorrection
from ...model.validation import InputError
from ..interface import RunState


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
    learns: bool  # whether the power of the field and the noise of the channels are estimated again after every step
    max_steps: int  # at most
    tolerance: float  # metres, a stage ends when nothing moves further
    # nats, or when the cost falls by no more. Without tolerances and with equal bounds on steps (and with one damping,
    # as now) as many arrays are right, and array 1 takes 1.3 to 1.9 times the time.
    negligible: float


STAGES = (
    Stage("deformation", 2, 30, True, False, True, 12, 2e-3, 0.5),
    Stage("deformation", 3, 30, False, False, True, 12, 2e-3, 0.5),
    Stage("free", 0, 0, False, False, True, 5, 1e-3, 2.0),
    Stage("gains", 0, 0, False, True, True, 10, 1e-4, 0.3),
    Stage("noiseless", 0, 0, False, False, False, 10, 3e-5, 0.01),
    Stage("final", 0, 0, False, True, True, 16, 3e-5, 0.01),
)
FREE, NOISELESS, FINAL = 2, 4, 5  # stages; the last but one is of measurements without noise alone


@dataclass(frozen=True)
class StepRules:
    """Steps and where they end."""

    # longest move of a microphone in one step, over the shortest wavelength; without it the error of a row in space
    # grows from 1.3 to 2.1 mm
    max_step: float = 0.125
    damping: float = 1e-6  # of the first step of a stage
    # largest Newton step left of a run that has converged, over one sigma of the coordinate
    converged_sigmas: float = 0.2
    # RMS move in one step over one sigma of the coordinates, at which a stage ends that learns the directions of a
    # field in space: their power changes long after it moves the positions. Four takes of 32 microphones end 0.1 to 0.5
    # mm from where all steps would lead, at an error of 3 to 4 mm, with 0.1 0.3 to 0.7 mm. In the plane directions cost
    # little, and an array whose size is hardly determined then goes from 14 to 17 mm
    settled_sigmas: float = 0.05
    # of the scaled Gauss-Newton matrix, dimensionless; directions with less are as good as undetermined
    min_eigenvalue: float = 1e-13


@dataclass(frozen=True)
class ScheduleRules:
    """Rounds and restarts."""

    restarts: int = 6  # starts tried at most
    rounds: int = 8  # of stage "gains" at most in one restart, and of stage "final"
    # distance of every microphone in one optimum from its place in another, over the shortest wavelength, within which
    # the two agree
    same_place: float = 0.03
    # low_noise, low_noise_channel: share of the power, of the array and of one channel: a restart that leaves no more
    # unexplained of a measurement without noise is the last, since in a wrong basin none does so; without the second a
    # run ends in a wrong basin, 1.1 m off
    low_noise: float = 1e-7
    low_noise_channel: float = 1e-5
    # the same over the reported noise, where channels are matched and positions exact; without it such arrays take 1.4
    # times the time
    reported_noise: float = 1.2
    tolerance_noise: float = 0.15  # change of the logarithm of the noise after which a round is the last


@dataclass(frozen=True)
class AssumptionRules:
    """What the stages assume of noise, kernel and spreads."""

    # least share of noise in the power that each kernel can show; with 1e-10 for all, the covariance without noise
    # depends on the frame, with 1e-8 such an array is not found to the last digit
    min_share: Mapping[str, float] = field(
        default_factory=lambda: MappingProxyType(
            {"diffuse": 1e-6, "series": 1e-8, "directional": 1e-8, "damped_directional": 1e-8, "near": 1e-10}
        )
    )
    # share of noise by dimension of the field, at or below which a source near the array counts
    near_share: Mapping[int, float] = field(default_factory=lambda: MappingProxyType({2: 1e-5, 3: 2e-6}))
    # residual of the near-field kernel over the noise that is assumed with it; without it an array with an error of 3.4
    # mm and a claim of 0.9 mm is good
    near_deflation: float = 3.0
    damped: float = 0.1  # (Im k R)^2 over the noise from which the imaginary part of k counts
    # modes, evenly taken, to estimate the noise from, at most; with all, the error of 1 of 22 arrays grows from 36 to
    # 54 mm, and it takes three times the time
    noise_modes: int = 24
    # factor within which the reported noise is believed; if it always is, an array of 2.6 mm is lost; if it never is,
    # the error of one in space grows from 16 to 20 mm
    believed: float = 2.0
    # gain_sigma, phase_sigma: nepers and radians, spreads of the channels to begin with; with 0.05 an array of 4.5 mm
    # is lost
    gain_sigma: float = 0.02
    phase_sigma: float = 0.02
    # least spread of gains and phases, nepers and radians; with 1e-3 the errors of matched arrays with little noise
    # grow by 10 to 15 %
    min_sigma: float = 1e-4
    # prior_filter, max_filter: metres, of delays, and rad/m, of corners: expected spread, worth one channel, and the
    # greatest
    prior_filter: tuple[float, float] = (2e-4, 2e-3)
    max_filter: tuple[float, float] = (0.2, 2.0)
    filter_nats: float = 3.0  # evidence for such a spread from which those of all channels are sought
    # change of the logarithm of a spread that does not count; without it an array without noise ends at, 0.011 instead
    # of 0.004 mm
    same_spread: float = 0.2
    # given_sigma, known_count: metres, expected error of a given coordinate, and positions that this is worth; without
    # them an array with a wrong position and an error of 27 mm is good, and ellipses cover 92.1 instead of 93.8 %
    given_sigma: float = 2e-3
    known_count: int = 2
    # distance of a given position over the median of all of them, or their sigma, that leaves it out when the array is
    # moved onto the given positions; without it 1 of 32 arrays with wrong given positions is lost
    known_outlier: float = 3.0
    # carrying_sigma, carrying_tail: metres, error of each coordinate of given positions that carry the scale, and the
    # degrees of freedom of their prior, which is then nearly Gaussian; with 3 mm errors grow from 1.0 to 2.3 mm, with 3
    # degrees of freedom from 7 to 70 mm in 1 of 6 plane arrays in space
    carrying_sigma: float = 1e-3
    carrying_tail: float = 1e6
    # observations that the directions of a row are those of its take; resonances of a plate differ more than the
    # frequencies of a room
    direction_count: Mapping[int, float] = field(default_factory=lambda: MappingProxyType({2: 0.3, 3: 3.0}))
    # steps of expectation and maximisation of the directions' power before the first step, and after every step; with 1
    # the errors grow by 2 %
    direction_updates: int = 3
    # nats, a stage goes on while the cost falls by more, since the directions are still being learned; where it ends
    # sooner an array in the plane whose size is hardly determined goes from 14 to 17 mm
    learned: float = 0.5
    max_products: float = 3e8  # products M N^2 Q of a field in space by Q directions at most; beyond it stays isotropic


@dataclass(frozen=True)
class ConditionalRules:
    """When and how the last stage minimises the conditional likelihood."""

    power: float = 50.0  # factor on the power of the field in it
    # of the likelihood of a random field beside it; by dimension of the field: a plane field has fewer directions, and
    # their power is learned better
    weight: Mapping[int, float] = field(default_factory=lambda: MappingProxyType({2: 0.3, 3: 0.1}))
    # one sigma of the least certain stretching of the array, relative, up to which it is minimised
    stretch_sigma: float = 0.05
    # the same without given positions, where nothing else shows that there is no such field
    blind_stretch_sigma: float = 0.02
    # noise as a part of the mean power up to which it is minimised: with more, what the noise does to the positions is
    # more than what the room does, and the sharper likelihood is better
    noise_share: float = 2e-4
    max_products: float = 1e8  # products M N^3 at most, a cap of time


@dataclass(frozen=True)
class OutlierRules:
    """When a channel is moved elsewhere or given another gain."""

    modes: int = 16  # of a search for other places; with all of them it takes 1.1 times the time
    spacing: float = 0.125  # distance of candidates over the shortest wavelength
    candidates: int = 1500  # at most, a cap of memory
    moved: int = 6  # channels examined at once, a cap of time: of all, searches take 2.7 times as long
    suspicious: float = 4.0  # channel noise over that of the others from which a channel is examined
    # gain_sigma, max_gain: nepers and radians, of the prior of a gross gain, and its greatest value; without that value
    # the error with a dead channel grows from 4.6 to 5.2 mm, and its claim falls from 8.9 to 5.5 mm
    gain_sigma: float = 0.05
    max_gain: float = 1.5
    # absolute log gain from which a gain is gross, as that of an inverted channel; without it the error of a blind
    # circle grows from 18 to 25 mm
    gross: float = 0.5
    # delay_sigma, max_delay, delays: metres, spread of a delay times the sound speed, the greatest, and their number
    delay_sigma: float = 0.5
    max_delay: float = 0.7
    delays: int = 41
    corner_sigma: float = 2.0  # rad/m, spread of a high-pass corner times 2 pi / c
    # suspicious channels at most that may have a filter; without it six healthy channels get one, and an array with an
    # error of 5.4 mm and a claim of 1.1 mm is good
    filtered: int = 3
    filter_nats: float = 8.0  # by which a filter must be likelier than a place and a gain alone
    coherent: float = 0.75  # share of the power that it must explain


@dataclass(frozen=True)
class GivenRules:
    """How given positions are weighed against the pressures."""

    # sigma, sigma_spread, max_sigma: metres, nepers, metres: log-normal prior of one sigma of a given coordinate, and
    # its greatest value; a run begins with the first, which is also its greatest before a hypothesis; with a spread of
    # 1 the error of an array in space grows from 11 to 18 mm
    sigma: float = 3e-3
    sigma_spread: float = 0.6
    max_sigma: float = 0.04
    # probability that a given position is wrong, that two are exchanged, or that the sound speed is wrong; with, 0.2
    # the errors of 2 of 32 arrays grow from 5 to 11 mm
    wrong: float = 0.05
    # greatest distance of a wrong position over the least one; with 10 the error of one grows from 5 to 12 mm
    decades: float = 1e3
    # range of relative errors of the sound speed; with 1 the error of one array grows from 34 to 55 mm
    sizes: float = 0.1
    # that sigma over the expected one from which all given positions are inaccurate; without it the error of, 1 of 32
    # arrays with wrong given positions grows from 9 to 19 mm
    inaccurate: float = 2.0
    # probability of the disagreement found from which the given positions are taken as they are; without it arrays with
    # given positions take 1.2 times the time
    agree: float = 0.2
    # given positions of which every subset and pair is examined; of more, those that fit worst. If only those that fit
    # worst are, the error of 1 of 52 arrays grows from 32 to 540 mm.
    examined: int = 7
    # at most, on which an array is laid; with 3 of them 2 of 24 arrays with 9 to 20 given positions are lost
    subsets: int = 40
    # factor on the power of the field for the covariance, as of the verdict: rooms are less isotropic than their model;
    # without it ellipses cover 87.8 instead of 92.7 %
    weaker_field: float = 4.0
    # steps, negligible: of the search for the array without given positions: steps at most, and nats after which it
    # ends. Without either every result is the same; without the second these arrays take 1.2 times the time.
    steps: int = 8
    negligible: float = 0.05
    # by which another hypothesis must be likelier than exact positions as they are given; without it 2 of 12 arrays
    # with wrong exact positions are good
    nats: float = 3.0


STEPS = StepRules()
SCHEDULE = ScheduleRules()
ASSUMED = AssumptionRules()
CONDITIONAL = ConditionalRules()
OUTLIERS = OutlierRules()
GIVEN = GivenRules()


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
