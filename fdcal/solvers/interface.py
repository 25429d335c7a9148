"""The interface of all solvers, the part of a state that they share, and the limits of every calibration.

RunState    base class of the solvers' states
Traits      properties of a solver that other modules ask for
Estimate    result of a solver (`Solver.result`), from which alone its assessment is made
Solver      protocol of a solver: a module with these functions

The order of a field's expansion, and with it memory and time of a step, grows with the wavenumber times the extent of
the array. N microphones resolve orders up to about N / 2 (Eq. 8), so that positions beyond `max_radius` mean that the
solver has diverged.

One step may take many trials. Loops inside a step call `fdcal.acoustics.compiled.check_deadline`, so that a calibration
ends soon after its time limit rather than after the step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeVar

import numpy as np

from ..model.problem import ChannelCorrection, Problem
from ..model.settings import Search, SolverSettings
from ..model.validation import LIMITS, Bools, InputError, Reals

if TYPE_CHECKING:  # the likelihood loads SciPy, which a session does not need before its first step
    from ..cost.likelihood import Terms


@dataclass(frozen=True)
class ChannelEstimate:
    """Gains, filters and noise of the channels."""

    # gains, gain_sigma: (N, 2) float64, log gain, nepers, and phase, radians, and one sigma of each
    gains: np.ndarray
    gain_sigma: np.ndarray
    # filters, filter_sigma: (N, 2) float64, delay, metres (times the sound speed), and high-pass corner, rad/m (times
    # 2 pi / c), and one sigma of each; 0 for a channel without a filter
    filters: Reals
    filter_sigma: Reals
    spread: Reals  # (2,) float64, prior sigma of gains, nepers, and phases, radians, without gross faults
    noise: Reals  # (N,) float64, noise of each channel over that of a healthy one


@dataclass(frozen=True)
class FieldEstimate:
    """Field and noise of the modes in use, at the end of the run."""

    noise_fraction: float  # noise over the mean power of the pressures
    # power, noise: (M,) float64, of the field and of a healthy channel, in units of the mean power of each mode
    power: Reals
    noise: Reals
    # of the likelihood with a weaker prior of an isotropic field; they predict each channel from the others
    terms: Terms


@dataclass(frozen=True)
class PositionSpread:
    """The parts of the covariance of the positions. They depend on the optimum only, not on the path to it."""

    # newton, data: (N D, N D) float64, metres^2, inverse of the Gauss-Newton matrix of cost and priors, and the part of
    # it that is due to errors of the data rather than of the priors
    newton: Reals
    data: Reals
    # ratio of the covariance that the disagreement of blocks of frequencies and takes shows to `data`, pooled over the
    # microphones; 1 on average where the model of the field holds
    dispersion: float
    # step, sigma: (N, D) float64, metres, Newton step that is left, and one sigma of each coordinate
    step: np.ndarray
    sigma: np.ndarray

    @property
    def covariance(self) -> Reals:
        """Covariance of the positions (N D, N D), metres^2, with `data` enlarged by the excess."""
        return self.newton + self.excess * self.data

    @property
    def excess(self) -> float:
        """Relative excess of the variance of the data's errors over the variance that the field model predicts."""
        return EXCESS * max(0.0, self.dispersion - 1)


# Fraction of the excess of a dispersion over 1 that counts, because an estimate from ten blocks scatters by a factor of
# two. Over 192 draws of 24 scenarios the logarithmic score is best at 0.7; halves of the draws or of the scenarios give
# 0.55 to 0.95, and then 93.6 to 96.7 % of the other half lie in their 95 % ellipses (89.2 % with 0). A dispersion below
# 1 does not count: errors would then be 1.24 times the claimed sigma, instead of 1.0 times.
EXCESS = 0.75


@dataclass(frozen=True)
class GivenHypothesis:
    """The likeliest hypothesis where given positions and pressures contradict each other."""

    # (N, D) float64, metres, array with its shape from the pressures and its frame from the right given positions
    positions: Reals
    sigma: Reals  # (A,) float64, metres, one sigma of this array at the microphones whose positions are given
    noise: Reals  # (A,) float64, noise of these channels over that of a healthy one
    wrong: Bools  # (A,) bool, which given positions are wrong


@dataclass(frozen=True)
class GivenEstimate:
    """What the solver has assumed and found of the given positions."""

    sigma: float  # metres, one sigma of each coordinate; 0 where they are exact
    expected_sigma: float  # metres, the stated sigma or, without one, the usual sigma
    stiffness: Reals  # (A,) float64, 1/m^2, curvature of the prior of each
    carry_scale: bool  # whether only these positions fix the scale, since the pressures hardly show the array's size
    # maps a selection (A,) bool of the given positions to the probability that they disagree with the pressures as much
    # as this by chance
    probability: Callable[[np.ndarray], float]
    # nats by which the array is likelier than its mirror image because of these positions; infinite where none is given
    mirror_advantage: float = np.inf
    contradicted: GivenHypothesis | None = None  # None where they agree with the pressures or cannot be tested


@dataclass(frozen=True)
class TriedOptimum:
    """Another optimum of the search."""

    positions: Reals  # (N, D) float64, metres
    score: float  # -log evidence, up to a constant
    same_frame: bool  # whether the given positions that fix its frame are those that fix the frame of the estimate


@dataclass(frozen=True)
class Estimate:
    """The result of a solver that minimises the likelihood, or is judged by it."""

    problem: Problem  # with modes of unit power
    modes: slice  # the modes in use
    positions: Reals  # (N, D) float64, metres
    converged: bool  # whether the solver ended at a minimum
    # channels, field, spread, given: as of their classes
    channels: ChannelEstimate
    field: FieldEstimate
    spread: PositionSpread
    given: GivenEstimate
    # log_speed, log_speed_sigma: logarithm of the sound speed found over that of the problem, and one sigma; 0 if fixed
    log_speed: float
    log_speed_sigma: float
    tried: tuple[TriedOptimum, ...]  # the likeliest first
    window_ratio: float = 0.0  # factor on the covariances of short windows and modes; 0 where no windows are used
    interpolates: bool = False  # whether the solver interpolates the field between microphones (Eq. 7)


@dataclass(frozen=True, kw_only=True)
class RunState:
    """The part of a solver's state that page, history, session files and exports read.

    A subclass adds what its `step` needs. A state is never changed: `step` returns another one. The defaults are those
    of a run that begins with its lowest modes.
    """

    solver: ClassVar[str]  # name of the solver that continues from this state

    positions: Reals  # (N, D) float64, metres, read-only
    settings: SolverSettings
    seed: int  # seed of all random numbers that the solver draws
    # step, sweep, stage: steps taken, sweeps completed, stages completed
    step: int = 0
    sweep: int = 0
    stage: int = 0
    moved: int = -1  # microphone that the last step moved; -1 at the start and if a step moves all of them
    # first, last: modes in use, counted from 1, both included
    first: int = 1
    last: int
    automatic: bool = True  # whether the solver adds modes and begins other stages by itself
    cost: float = 0.0  # cost of the modes in use; the solver defines it
    finished: bool = False  # whether nothing is left to do
    converged: bool = False  # whether it finished because no microphone moved, not because the steps were used up

    @property
    def modes(self) -> slice:
        """Indices of the modes in use."""
        return slice(self.first - 1, self.last)

    @property
    def best_positions(self) -> np.ndarray:
        """The best positions (N, D) so far, metres, over all restarts; a run that ends early returns them."""
        return self.positions

    @property
    def restart(self) -> int:
        """Number of the present restart, from 0."""
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
        """Gain and noise of every channel as estimated so far; None if the solver takes the pressures as recorded."""
        return None


@dataclass(frozen=True)
class Traits:
    """Properties of a solver."""

    settings: frozenset[str]  # fields of `SolverSettings` that change what it does
    # whether a step moves all free microphones, by the likelihood of the pressures; otherwise one of them, by Eq. 7
    moves_all: bool
    needs_search: bool = False  # whether it needs a search domain, whose lattice it searches
    adds_modes: bool = False  # whether it adds modes by itself while it runs
    # values of `SolverSettings.start` that it takes, the default first; empty if it has a start of its own
    starts: tuple[str, ...] = ()
    draws_order: bool = False  # whether the seed matters beyond a random start


class Solver(Protocol):
    """A solver: a module with these functions."""

    State: type[Any]  # class of the states, a dataclass derived from `RunState`
    TRAITS: Traits

    def init(self, problem: Problem, settings: SolverSettings, seed: int) -> Any:
        """Return the first state of a run.

        settings : the start and the options of the solver
        seed : of everything that is drawn; equal seeds give equal runs

        Raises InputError for a problem or settings that the solver cannot work on.
        """
        ...

    def step(self, problem: Problem, state: Any) -> Any:
        """Return the state after one step; the same state if it is finished.

        A step should take a second at most: the page shows the state after each step, and a person can stop a run only
        between two steps. It must not change `state`, because a replay shows earlier states again.
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

    def landscape(
        self, problem: Problem, state: Any, n: int, modes: slice, search: Search | None = None, /
    ) -> np.ndarray:
        """Return the cost of microphone `n` over a lattice, the problem's unless given : (modes, ny, nx)."""
        ...


State = TypeVar("State", bound=RunState)


def time_limit(problem: Problem, modes: int) -> float:
    """Return the seconds of processor time that a calibration may take unless another limit is given."""
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
    """Return the state `after` a step or, if a microphone has diverged, the state `before` it, ended unconverged."""
    # a session may run a solver of other problems, which has no such limit
    if not isinstance(problem, Problem):  # pyright: ignore[reportUnnecessaryIsInstance]
        return after
    search = max(problem.search.size) if problem.search is not None else 0.0
    known, start = radius(problem.known_positions), radius(before.positions)  # what starts further out may stay there
    limit = max(max_radius(problem, before.settings.modes), search, 2 * known, start)
    return after if np.isfinite(after.positions).all() and radius(after.positions) <= limit else ended_early(before)


def ended_early(state: State) -> State:
    """Return a state as the end of a run that was stopped, at the best positions so far."""
    if state.finished:
        return state
    return replace(state, positions=state.best_positions, finished=True, converged=False)
