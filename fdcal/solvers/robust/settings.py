"""The schedule of the solver `robust`, and the numbers that decide beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType


@dataclass(frozen=True)
class Stage:
    """One row of the schedule.

    Attributes
    ----------
    name : of the stage, for display
    degree : of the polynomials by which the array may deform as a whole; 0 lets every microphone move for itself
    modes : at most so many modes, evenly taken; 0 for all
    lowest : with given positions the lowest ones instead: they hold the scale
    gains : whether channel gains are free
    learns : whether the power of the field and the noise of the channels are estimated again after every step
    steps : at most
    settled : metres, a stage ends when nothing moves further
    negligible : nats, or when the cost falls by no more
    """

    name: str
    degree: int
    modes: int
    lowest: bool
    gains: bool
    learns: bool
    steps: int
    settled: float
    negligible: float


SCHEDULE = (
    Stage("deformation", 2, 30, True, False, True, 12, 2e-3, 0.5),
    Stage("deformation", 3, 30, False, False, True, 12, 2e-3, 0.5),
    Stage("free", 0, 0, False, False, True, 5, 1e-3, 2.0),
    Stage("gains", 0, 0, False, True, True, 10, 1e-4, 0.3),
    Stage("noiseless", 0, 0, False, False, False, 10, 1e-4, 0.3),
    Stage("final", 0, 0, False, True, True, 16, 3e-5, 0.01),
)
NOISELESS, FINAL = len(SCHEDULE) - 2, len(SCHEDULE) - 1  # rows; the last but one for measurements without noise alone


@dataclass(frozen=True)
class Rules:
    """What decides beside the schedule.

    Attributes
    ----------
    gain_sigma : nepers, spread of the channel gains to begin with
    phase_sigma : radians, spread of the channel phases to begin with
    known_sigma : metres, one sigma of a given coordinate to begin with, and at most
    exact_sigma : the same of given positions that are stated to be exact; below it rounding counts
    stride : longest move of a microphone in one step, over the shortest wavelength
    rounds : stages "gains" at most in one attempt
    attempts : starts tried at most
    final_rounds : stages "final" at most
    search_modes : modes of a search for other places of outliers
    searches : rounds with such a search
    low_noise : share of the power, an attempt that leaves no more unexplained, and no odd channel, is the last
    same_place : distance of every microphone in one from its place in the other, over the shortest wavelength
    low_noise_channel : the same of the power of a single channel
    settled_noise : change of the logarithm of the noise after which a round is the last
    settled_near_noise : the same with the near-field kernel, of which less noise hardly moves anything
    known_outlier : distance of a given position over the median of all of them, or their sigma, that leaves it out
        when the array is moved onto the given positions
    near_deflation : residual of the near-field kernel over the noise that is assumed with it
    converged_sigmas : largest Newton step left of a run that has converged, over one sigma of the coordinate
    """

    gain_sigma: float = 0.02
    phase_sigma: float = 0.02
    known_sigma: float = 0.003
    exact_sigma: float = 1e-6
    stride: float = 0.125
    rounds: int = 8
    attempts: int = 6
    final_rounds: int = 6
    search_modes: int = 16
    searches: int = 1
    low_noise: float = 1e-7
    low_noise_channel: float = 1e-5
    same_place: float = 0.03
    settled_noise: float = 0.15
    settled_near_noise: float = 0.7
    known_outlier: float = 3.0
    near_deflation: float = 3.0
    converged_sigmas: float = 0.2


RULES = Rules()


@dataclass(frozen=True)
class NoiseRules:
    """Priors and bounds of the noise model.

    Attributes
    ----------
    power_count : observations that the mean power of the pressures is worth
    channel_count : observations that a channel is like the others
    direction_count : observations that the field's power from a direction is that from all; by dimension of the
        field: in space there are more directions
    least_channel_noise : least channel noise over that of the array
    most_channel_noise : greatest, likewise
    least_power : least power of the field over the mean power of the pressures
    most_power : greatest, likewise: without noise a singular covariance would let it grow without bound
    most_share : greatest noise over the power
    most_profiled, profiled : greatest factor on the power of the field where two kernels are compared, and how many
    least_sigma : least spread of gains and phases, nepers and radians
    most_sigma : greatest, likewise
    """

    power_count: float = 2.0
    channel_count: float = 6.0
    direction_count: Mapping[int, float] = field(default_factory=lambda: MappingProxyType({2: 1.0, 3: 0.1}))
    least_channel_noise: float = 0.3
    most_channel_noise: float = 1e6
    least_power: float = 1e-3
    most_power: float = 1e3
    most_share: float = 0.7
    most_profiled: float = 1e4
    profiled: int = 33
    least_sigma: float = 1e-4
    most_sigma: float = 0.6


NOISE_RULES = NoiseRules()


@dataclass(frozen=True)
class OutlierRules:
    """When a channel is moved elsewhere or given another gain.

    Attributes
    ----------
    spacing : distance of candidates over the shortest wavelength
    finer : factor on that spacing in a search near where the channel is
    candidates : candidates at most
    moved : channels examined at once
    suspicious : channel noise over that of the others from which a channel is examined
    gain_sigma : nepers and radians, of the prior of a gross gain
    most_gain : nepers, greatest gross gain
    nats : by which a place must be likelier than the channel as it is, with its own noise
    gross : absolute log gain from which a gain is gross, as that of an inverted channel
    """

    spacing: float = 0.125
    finer: float = 4.0
    candidates: int = 1500
    moved: int = 6
    suspicious: float = 4.0
    gain_sigma: float = 0.05
    most_gain: float = 1.5
    nats: float = 3.0
    gross: float = 0.5


OUTLIERS = OutlierRules()


@dataclass(frozen=True)
class AssumptionRules:
    """What the stages assume of noise, kernel and spreads.

    Attributes
    ----------
    noise_modes : modes, evenly taken, to estimate the noise from, at most
    damped : (Im k R)^2 over the noise from which the imaginary part of k counts
    believed : factor within which the reported noise is believed
    prior_count : channels that `prior_gain` is worth
    prior_gain : nepers or radians, expected spread of gains and phases
    same_spread : change of the logarithm of a spread that does not count
    negligible_spread : nepers or radians, a spread below which no change counts
    known_count : given positions that `given_sigma` is worth
    given_sigma : metres, expected error of each coordinate of a given position
    carrying_sigma, carrying_tail : metres, error of each coordinate of given positions that carry the scale, and the
        degrees of freedom of their prior, which is then nearly Gaussian
    first_updates : steps of expectation and maximisation of the directions' power before the first step
    direction_updates : steps of expectation and maximisation of the directions' power after every step
    most_products : products M N^2 Q of a field in space by Q directions at most; beyond it stays isotropic
    turned : move of a microphone with the array as a whole, times the greatest k, below which the directions are kept
    turned_updates : the same after the array was turned further as a whole
    learned : nats, a stage goes on while the cost falls by more, since the directions are still being learned
    """

    noise_modes: int = 24
    damped: float = 0.1
    believed: float = 2.0
    prior_count: float = 1.0
    prior_gain: float = 1e-3
    same_spread: float = 0.2
    negligible_spread: float = 1e-3
    known_count: float = 2.0
    given_sigma: float = 2e-3
    carrying_sigma: float = 1e-3
    carrying_tail: float = 1e6
    first_updates: int = 10
    direction_updates: int = 3
    most_products: float = 3e8
    turned: float = 0.05
    turned_updates: int = 60
    learned: float = 0.5


ASSUMED = AssumptionRules()


@dataclass(frozen=True)
class FilterRules:
    """Delays and high-pass corners of channels.

    Attributes
    ----------
    delay_sigma : metres, spread of a delay times the sound speed
    corner_sigma : rad/m, spread of a corner times 2 pi / c
    longest_delay : metres, greatest delay that is looked for
    highest_corner : rad/m, greatest corner that is looked for
    delays, corners : that are tried
    channels : suspicious channels at most that may have one
    nats : by which a filter must be likelier than a place and a gain alone
    coherent : share of the power that it must explain
    """

    delay_sigma: float = 0.5
    corner_sigma: float = 2.0
    longest_delay: float = 0.7
    highest_corner: float = 2.0
    delays: int = 41
    corners: int = 17
    channels: int = 3
    nats: float = 8.0
    coherent: float = 0.75


FILTERS = FilterRules()
