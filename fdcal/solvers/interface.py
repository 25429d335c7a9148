"""What every solver offers, what every state holds, and what bounds every calibration, whatever the solver.

RunState    base class of the solvers' states
Traits      properties of a solver that others ask for
Solver      protocol of a solver: a module with these functions

The order of a field's expansion, and with it memory and time of a step, grows with the wavenumber times the extent of
the array. `N` microphones resolve orders up to about N / 2 (Eq. 8), so positions beyond `max_radius` are no answer: the
solver has diverged.

One step may take many trials. Loops inside a step call `check_deadline`, so a calibration ends soon after its time
limit and not after the step. A deadline holds in the thread that has set it: calibrations in other threads, and the
page's session, have their own or none.
"""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np

from ..model.problem import ChannelCorrection, Problem
from ..model.settings import Search, SolverSettings
from ..model.validation import LIMITS, InputError, Reals
from .estimate import Estimate, RoomEstimate


@dataclass(frozen=True, kw_only=True)
class RunState:
    """The part of a solver's state that page, history, session files and exports read.

    A subclass adds what its `step` needs. A state is never changed: `step` returns another one. The defaults are those
    of a run that begins with its lowest modes.
    """

    solver: ClassVar[str]  # name of the solver that continues from this state

    positions: Reals  # (N, D) float64, metres, read-only
    settings: SolverSettings
    seed: int  # of whatever the solver draws
    # step, sweep, stage: steps taken, sweeps completed, stages completed
    step: int = 0
    sweep: int = 0
    stage: int = 0
    moved: int = -1  # microphone that the last step moved; -1 at the start and if a step moves all of them
    # first, last: modes in use, counted from 1, both included
    first: int = 1
    last: int
    automatic: bool = True  # whether the solver adds modes and begins other stages by itself
    cost: float = 0.0  # of the modes in use; the solver defines it
    finished: bool = False  # whether nothing is left to do
    converged: bool = False  # whether it finished because no microphone moved, not because the steps were used up

    @property
    def modes(self) -> slice:
        """Indices of the modes in use."""
        return slice(self.first - 1, self.last)

    @property
    def best_positions(self) -> np.ndarray:
        """The best positions (N, D) so far, metres, for a run that ends early; of restarts those of the likeliest."""
        return self.positions

    @property
    def restart(self) -> int:
        """Number of the start that the run has come from last, from 0; it changes where the run starts again."""
        return 0

    @property
    def order_offset(self) -> int:
        """The number added to ceil(kR) in the order rule of the paper; 0 if the solver expands no field."""
        return 0

    @property
    def channels(self) -> ChannelCorrection | None:
        """Gain and noise of every channel as estimated so far; None if the solver takes the pressures as recorded."""
        return None


@dataclass(frozen=True)
class Traits:
    """Properties of a solver."""

    moves_all: bool  # whether a step moves all free microphones; otherwise one
    needs_search: bool = False  # whether it needs a search domain, whose lattice it searches
    needs_room: bool = False  # whether it needs the size of a rectangular room (`SolverSettings.room`)
    adds_modes: bool = False  # whether it adds modes by itself while it runs
    # values of `SolverSettings.start` that it takes, the default first; empty if it has a start of its own
    starts: tuple[str, ...] = ()
    draws_order: bool = False  # whether the seed matters beyond a random start
    takes_positions: bool = False  # whether `init` takes the keyword `positions`
    # fields of `SolverSettings` that change what it does; None stands for all of them
    settings: frozenset[str] | None = None
    uses_likelihood: bool = False  # whether it minimises a likelihood: the covariance of all microphones in each mode

    @property
    def default_start(self) -> str | None:
        """Start that is used unless another one is given; None if the solver has a start of its own."""
        return self.starts[0] if self.starts else None

    def uses_seed(self, start: str | None) -> bool:
        """Return whether the seed changes a run from `start`."""
        return self.draws_order or ("random" in self.starts and (start or self.default_start) == "random")

    def ignores(self, key: str) -> bool:
        """Return whether the field `key` of `SolverSettings` does nothing."""
        return self.settings is not None and key not in self.settings


class Solver(Protocol):
    """A solver: a module with these functions."""

    @property
    def State(self) -> type[Any]:
        """Class of the states, a dataclass derived from `RunState`."""
        ...

    @property
    def TRAITS(self) -> Traits:
        """Properties of the solver."""
        ...

    def init(self, problem: Problem, settings: SolverSettings, seed: int) -> Any:
        """Return the first state. Raises InputError for what the solver cannot work on."""
        ...

    def step(self, problem: Problem, state: Any) -> Any:
        """Return the state after one step; the same state if it is finished."""
        ...

    def use_modes(self, problem: Problem, state: Any, first: int, last: int, automatic: bool) -> Any:
        """Return `state` with modes `first` to `last` in use, counted from 1; the solver continues from it."""
        ...

    def landscape(
        self, problem: Problem, state: Any, n: int, modes: slice, search: Search | None = None, /
    ) -> np.ndarray:
        """Return the cost of microphone `n` over a lattice, the problem's unless given : (modes, ny, nx)."""
        ...

    def result(self, problem: Problem, state: Any) -> Estimate | RoomEstimate:
        """Return what the solver has found, which is all that the assessment of a result reads."""
        ...

    def usable_modes(self, problem: Problem, settings: SolverSettings) -> int:
        """Return how many of the lowest modes of `problem` can be in use."""
        ...


State = TypeVar("State", bound=RunState)

_time_is_up: ContextVar[Callable[[], bool] | None] = ContextVar("time_is_up", default=None)


class OutOfTime(Exception):
    """The time of a calibration is used up; the last state before holds its best positions."""


@contextmanager
def deadline(end: float, clock: Callable[[], float]) -> Generator[None]:
    """Let `check_deadline` raise OutOfTime inside this context once `clock()`, seconds, is past `end`."""
    token = _time_is_up.set(lambda: clock() > end)
    try:
        yield
    finally:
        _time_is_up.reset(token)


def check_deadline() -> None:
    """Raise OutOfTime if the deadline of this thread has passed; without a deadline do nothing."""
    time_is_up = _time_is_up.get()
    if time_is_up is not None and time_is_up():
        raise OutOfTime


def time_limit(problem: Problem, modes: int) -> float:
    """Return the seconds of processor time that a calibration may take unless another limit is given."""
    pairs = problem.pressures.shape[1] ** 2 * min(modes, len(problem.pressures))
    return LIMITS.seconds * max(1.0, pairs / LIMITS.usual_pairs)


def require_affordable(problem: Problem, settings: SolverSettings, traits: Traits) -> None:
    """Raise InputError for a problem that needs too much memory, or whose known microphones are too far apart."""
    if not traits.uses_likelihood:
        return
    count, modes = problem.pressures.shape[1], min(settings.modes, len(problem.pressures))
    if count**2 * modes > LIMITS.pairs:
        fault = f"{count} microphones at {modes} frequencies need more memory than a calibration may take"
        remedy = f"use at most {int(LIMITS.pairs / count**2)} modes (<modes>), or fewer microphones (<exclude>)"
        raise InputError(fault, remedy, key="modes", value=modes)
    extent, limit = radius(problem.known_positions), max_radius(problem, modes)
    if extent > limit:
        fault = (
            f"the known microphones lie up to {2 * extent:.3g} m apart, farther than {count} microphones resolve at"
            f" {problem.frequencies[modes - 1]:.4g} Hz ({2 * limit:.3g} m)"
        )
        raise InputError(fault, "give positions in metres, or use fewer modes (<modes>)", key="known_positions")


def radius(positions: np.ndarray) -> float:
    """Return half the largest extent of positions (N, D) along an axis, metres; 0 without any."""
    return float(np.ptp(positions, axis=0).max(initial=0.0)) / 2 if len(positions) else 0.0


def max_radius(problem: Problem, modes: int) -> float:
    """Return the radius of the largest array that the lowest `modes` modes can resolve at all, metres."""
    phase = max(LIMITS.phase, LIMITS.phase_per_microphone * problem.pressures.shape[1])
    return phase / float(np.abs(problem.wavenumbers[:modes]).max())


def bounded(problem: Problem, before: State, after: State) -> State:
    """Return the state after a step; the one `before` it, ended without convergence, where a microphone diverges."""
    # a session takes whatever its solver takes, which then bounds itself
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
