"""The interface of all solvers, the common part of their states, and the limits of every calibration.

RunState    base class of the solvers' states
Traits      properties of a solver that other modules need to know
Estimate    result of a solver (`Solver.result`), the only thing that the assessment of a result reads
Solver      protocol of a solver: a module with these functions

The order of a field's expansion, and with it the memory and the time of a step, grows with the wavenumber times the
extent of the array. N microphones resolve orders up to about N / 2 (Eq. 8). Positions beyond `max_radius`, which
allows at least four times that order, mean that the solver has diverged.

One step may take many trials. The loops inside a step call `fdcal.acoustics.compiled.check_deadline`, so that a
calibration ends soon after its time limit, even in the middle of a step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeVar

import numpy as np

from ..model.problem import ChannelCorrection, Problem
from ..model.settings import Search, SolverSettings
from ..model.validation import LIMITS, Bools, InputError, Reals

if TYPE_CHECKING:  # at run time it would load SciPy, which a session does not need before its first step
    from ..cost.likelihood import Terms


@dataclass(frozen=True)
class ChannelEstimate:
    """Gains, filters and noise of the channels."""

    # (N, 2) float64, log gain, nepers, and phase, radians, of each channel, and their standard deviations
    gains: np.ndarray
    gain_sigma: np.ndarray
    # (N, 2) float64, delay times the sound speed, metres, and high-pass corner times 2 pi / c, rad/m, of each channel,
    # and their standard deviations; 0 for a channel without a filter
    filters: Reals
    filter_sigma: Reals
    # (2,) float64, prior sigma of gains, nepers, and phases, radians, about the offsets of channels with gross faults
    spread: Reals
    noise: Reals  # (N,) float64, noise of each channel relative to that of a healthy one


@dataclass(frozen=True)
class FieldEstimate:
    """Field and noise of the modes in use, at the end of the run."""

    noise_fraction: float  # noise power divided by the mean power of the pressures
    # (M,) float64, power of the field, and noise power of a healthy channel, relative to the mean power of each mode
    power: Reals
    noise: Reals
    # terms of the likelihood with a weaker prior of an isotropic field; they predict each channel from the others
    terms: Terms


@dataclass(frozen=True)
class PositionSpread:
    """The parts of the covariance of the positions. They only depend on the optimum, not on the path to it."""

    # (N D, N D) float64, metres^2: the inverse of the Gauss-Newton matrix of cost and priors, and the part of this
    # covariance that is due to errors of the data rather than to the priors
    newton: Reals
    data: Reals
    # covariance that the differences between blocks of frequencies and takes imply, divided by `data`, pooled over the
    # microphones; 1 on average if the model of the field is right
    dispersion: float
    # (N, D) float64, metres: the remaining Newton step, and the sigma of the unweakened likelihood to compare it with
    step: np.ndarray
    sigma: np.ndarray

    @property
    def covariance(self) -> Reals:
        """Covariance of the positions (N D, N D), metres^2, in which the part `data` is enlarged by the excess."""
        return self.newton + self.excess * self.data

    @property
    def excess(self) -> float:
        """Relative amount by which the variance of the data's errors exceeds the prediction of the field model."""
        return EXCESS * max(0.0, self.dispersion - 1)


# Fraction of `dispersion` - 1 that enlarges the covariance. It is below 1, because a dispersion from ten blocks has an
# error of a factor of two. Over 192 draws of 24 scenarios the logarithmic score is best at 0.7. The best values for
# halves of the draws or scenarios are 0.55 to 0.95; with these, 93.6 to 96.7 % of the positions in the other half lie
# in their 95 % ellipses (89.2 % with the value 0). A dispersion below 1 has no effect: if it reduced the covariance,
# the errors would be 1.24 times the claimed sigma instead of 1.0 times.
EXCESS = 0.75
# Reduced chi-square of the difference of two estimates above which they contradict each other. Estimates of a measured
# array of 44 mm that differ by 5 mm reach 11.
CONTRADICTION = 4.0


@dataclass(frozen=True)
class GivenHypothesis:
    """The most likely hypothesis if given positions and pressures contradict each other."""

    # (N, D) float64, metres: the shape of this array comes from the pressures, its frame from the right given positions
    positions: Reals
    sigma: Reals  # (A,) float64, metres, standard deviation of `positions` at the microphones with a given position
    noise: Reals  # (A,) float64, noise of the channels of these microphones relative to that of a healthy one
    wrong: Bools  # (A,) bool, which given positions are wrong


@dataclass(frozen=True)
class GivenEstimate:
    """What the solver has assumed and found out about the given positions."""

    sigma: float  # metres, assumed standard deviation of each coordinate; 0 if they are exact
    expected_sigma: float  # metres, the stated sigma or, without one, the usual sigma
    stiffness: Reals  # (A,) float64, 1/m^2, curvature of the prior of each given position
    carry_scale: bool  # whether only these positions fix the scale, because the pressures hardly show the array's size
    # returns, for a selection (A,) bool of the given positions, the probability that by chance they would disagree with
    # the pressures at least as much as they do
    probability: Callable[[np.ndarray], float]
    # nats by which these positions make the array likelier than its mirror image; infinite if these cannot be compared
    mirror_advantage: float = np.inf
    contradicted: GivenHypothesis | None = None  # None if the positions agree with the pressures or cannot be tested


@dataclass(frozen=True)
class TriedOptimum:
    """An optimum that the search has found."""

    positions: Reals  # (N, D) float64, metres
    score: float  # negative log evidence, up to a constant; 0 if short windows determine the array
    same_frame: bool  # whether the same given positions fix its frame and that of the estimate


@dataclass(frozen=True)
class Estimate:
    """The result of a solver. If its cost is not the likelihood, the uncertainty still comes from the likelihood."""

    problem: Problem  # with every mode scaled to unit power
    modes: slice  # the modes in use
    positions: Reals  # (N, D) float64, metres
    ended: bool  # whether the run has ended, for whatever reason
    channels: ChannelEstimate
    field: FieldEstimate
    spread: PositionSpread
    given: GivenEstimate
    # logarithm of the ratio of the estimated sound speed to that of the problem, and its standard deviation; both are 0
    # if the speed is fixed
    log_speed: float
    log_speed_sigma: float
    tried: tuple[TriedOptimum, ...]  # the most likely first
    # factor by which the covariances from short windows and from modes were enlarged because they disagree; 0 if no
    # windows are used
    window_ratio: float = 0.0
    flat: bool = False  # whether an array in space was found to be flat, and its heights were held near a plane
    interpolates: bool = False  # whether the solver interpolates the field between microphones (Eq. 7)


@dataclass(frozen=True, kw_only=True)
class RunState:
    """The part of a solver's state that page, history, session files and exports read.

    A subclass adds what its `step` needs. A state is never changed: `step` returns a new one. The default values are
    those of the first state of a run that begins with its lowest modes.
    """

    solver: ClassVar[str]  # name of the solver that continues from this state

    positions: Reals  # (N, D) float64, metres, read-only
    settings: SolverSettings
    seed: int  # seed of all random numbers that the solver draws
    # numbers of steps taken, sweeps completed and stages completed
    step: int = 0
    sweep: int = 0
    stage: int = 0
    moved: int = -1  # microphone that the last step moved; -1 at the start, or if a step moves all of them
    # lowest and highest mode in use, counted from 1
    first: int = 1
    last: int
    automatic: bool = True  # whether the solver adds modes and begins other stages by itself
    cost: float = 0.0  # cost of the modes in use, as the solver defines it
    finished: bool = False  # whether the run has ended
    # whether it ended because its last steps hardly moved a microphone, rather than at the largest number of steps
    converged: bool = False

    @property
    def modes(self) -> slice:
        """Indices of the modes in use."""
        return slice(self.first - 1, self.last)

    @property
    def best_positions(self) -> np.ndarray:
        """The best positions (N, D), metres, of all restarts so far; they are the result of a run that ends early."""
        return self.positions

    @property
    def restart(self) -> int:
        """Number of the present restart, from 0; -1 in the search for starts."""
        return 0

    @property
    def order_offset(self) -> int:
        """The number added to ceil(kR) in the order rule of the paper; 0 if the solver expands no field."""
        return 0

    def next_microphone(self, problem: Problem) -> int:
        """Return the microphone that the next step moves; -1 if it moves all of them, or there is none."""
        return -1

    @property
    def channels(self) -> ChannelCorrection | None:
        """Gain and noise of every channel as estimated so far; None if the solver does not estimate them."""
        return None


@dataclass(frozen=True)
class Traits:
    """Properties of a solver."""

    settings: frozenset[str]  # fields of `SolverSettings` that have an effect on it
    # whether a step moves all free microphones by the likelihood of the pressures; otherwise it moves one by Eq. 7
    moves_all: bool
    needs_search: bool = False  # whether it needs a search domain, whose lattice it searches
    adds_modes: bool = False  # whether it adds modes by itself while it runs
    # values of `SolverSettings.start` that it accepts, the default first; empty if it always uses its own starts
    starts: tuple[str, ...] = ()
    draws_order: bool = False  # whether the seed has an effect other than on a random start


class Solver(Protocol):
    """A solver: a module with these functions."""

    State: type[Any]  # class of the states, a dataclass derived from `RunState`
    TRAITS: Traits

    def init(self, problem: Problem, settings: SolverSettings, seed: int) -> Any:
        """Return the first state of a run.

        settings : the start and the options of the solver
        seed : seed of all random numbers; equal seeds give equal runs

        Raises InputError for a problem or settings that the solver cannot work on.
        """
        ...

    def step(self, problem: Problem, state: Any) -> Any:
        """Return the state after one step; the same state if it is finished.

        A step should take at most a second, because the page shows the state after each step, and a user can only stop
        a run between two steps. It must not change `state`, because a replay shows earlier states again.
        """
        ...

    def use_modes(self, problem: Problem, state: Any, first: int, last: int, automatic: bool) -> Any:
        """Return `state` with other modes in use; the solver continues from it.

        first, last : the lowest and the highest mode, counted from 1
        automatic : whether the solver may add modes by itself
        """
        ...

    def result(self, problem: Problem, state: Any) -> Estimate:
        """Return what the solver has found in `state`, which is all that the assessment of a result reads."""
        ...

    def usable_modes(self, problem: Problem, settings: SolverSettings) -> int:
        """Return how many of the lowest modes of `problem` can be in use."""
        ...

    def landscape(self, problem: Problem, state: Any, n: int, modes: slice, search: Search | None = None, /) -> Reals:
        """Return the cost with microphone `n` moved over the lattice `search` : (modes, ny, nx) float64.

        The lattice is by default that of the problem.
        """
        ...


State = TypeVar("State", bound=RunState)


def time_limit(problem: Problem, modes: int) -> float:
    """Return the default limit on the processor time of a calibration, seconds."""
    pairs = problem.pressures.shape[1] ** 2 * min(modes, len(problem.pressures))
    return LIMITS.seconds * max(1.0, pairs / LIMITS.usual_pairs)


def require_affordable(problem: Problem, settings: SolverSettings, traits: Traits) -> None:
    """Raise InputError for a problem that needs too much memory, or whose known microphones are too far apart."""
    if not traits.moves_all:
        return
    count, modes = problem.pressures.shape[1], min(settings.modes, len(problem.pressures))
    if count**2 * modes > LIMITS.pairs:
        fault = f"{count} microphones at {modes} frequencies need more memory than a calibration may take"
        remedy = f"use at most {int(LIMITS.pairs / count**2)} frequencies (<modes>), or fewer microphones (<exclude>)"
        raise InputError(fault, remedy, key="modes")
    extent, limit = radius(problem.known_positions), max_radius(problem, modes)
    if extent > limit:
        fault = (
            f"the known microphones lie up to {2 * extent:.3g} m apart, farther than {count} microphones resolve at"
            f" {problem.frequencies[modes - 1]:.4g} Hz ({2 * limit:.3g} m)"
        )
        raise InputError(fault, "give positions in metres, or use fewer frequencies (<modes>)", key="known_positions")


def radius(positions: np.ndarray) -> float:
    """Return half the largest extent of positions (N, D) along an axis, metres; 0 without any."""
    return float(np.ptp(positions, axis=0).max(initial=0.0)) / 2 if len(positions) else 0.0


def max_radius(problem: Problem, modes: int) -> float:
    """Return the radius of the largest array that the lowest `modes` modes can resolve at all, metres."""
    phase = max(LIMITS.phase, LIMITS.phase_per_microphone * problem.pressures.shape[1])
    return phase / float(np.abs(problem.wavenumbers[:modes]).max())


def bounded(problem: Problem, before: State, after: State) -> State:
    """Return the state `after` a step, or the state `before` it as the end of the run if a microphone has diverged."""
    # A session can also run solvers of other problems, whose class is not `Problem`. They have no such limit.
    if not isinstance(problem, Problem):  # pyright: ignore[reportUnnecessaryIsInstance]
        return after
    search = max(problem.search.size) if problem.search is not None else 0.0
    known, start = radius(problem.known_positions), radius(before.positions)  # a larger start is not a divergence
    limit = max(max_radius(problem, before.settings.modes), search, 2 * known, start)
    return after if np.isfinite(after.positions).all() and radius(after.positions) <= limit else ended_early(before)


def ended_early(state: State) -> State:
    """Return a state as the end of a run that was stopped, at the best positions so far."""
    if state.finished:
        return state
    return replace(state, positions=state.best_positions, finished=True, converged=False)
