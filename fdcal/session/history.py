"""The states of a run so far, their costs, and what a session shows.

The cost of a state by one reference cost is the same for every solver. The solver thread computes it, and any thread
may read it. A step can be shorter than its cost takes to compute, so that while the solver runs the cost of some states
is left out, and computed when the solver rests.
"""

import time
import weakref
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, overload

import numpy as np

from ..model.validation import InputError
from ..solvers.interface import RunState

COST_TIME = 0.25  # of the time of the steps that costs may take while the solver runs
MAX_FILLED = 300  # states, evenly spaced over a run, whose cost is computed when the solver rests


class StateCosts:
    """Costs of states, dB, by the state itself; those of states that no longer exist are forgotten.

    `reference_cost` returns the cost of a state; without it every cost is NaN. `newest`: the cost computed last.
    """

    def __init__(self, reference_cost: Callable[..., float] | None = None):
        self._reference_cost = reference_cost
        self._values: dict[int, tuple[weakref.ref, float]] = {}
        self._credit, self._duration = 0.0, 0.0
        self.newest, self.count = float("nan"), 0

    def of(self, state: RunState) -> float:
        """Return the cost of a state, dB; NaN where it is not computed."""
        found = self._values.get(id(state))
        return float("nan") if found is None or found[0]() is not state else found[1]

    def compute(self, state: RunState) -> None:
        """Compute the cost of a state, unless it is there."""
        if self._reference_cost is None or self.knows(state):
            return
        began = time.thread_time()
        try:
            value = float(self._reference_cost(state))
        except np.linalg.LinAlgError:
            value = float("nan")
        key = id(state)
        self._duration = time.thread_time() - began if self.count else 0.0  # the first one also makes its tables
        self._values[key] = weakref.ref(state, lambda _: self._values.pop(key, None)), value
        self.newest, self.count = value, self.count + 1

    def knows(self, state: RunState) -> bool:
        """Return whether the cost of a state is there, or cannot be computed."""
        found = self._values.get(id(state))
        return self._reference_cost is None or (found is not None and found[0]() is state)

    def compute_in_passing(self, state: RunState, spent: float) -> None:
        """Compute the cost of a state after a step of `spent` s, unless costs have had their share."""
        self._credit = min(self._credit + COST_TIME * spent, 2 * self._duration + COST_TIME * spent)
        if self._credit >= self._duration:
            self.compute(state)
            self._credit -= self._duration

    def missing(self, states: Sequence[RunState]) -> list[RunState]:
        """Return the states whose cost is to be computed when the solver rests, the last first."""
        if self._reference_cost is None:
            return []
        stride = max(1, len(states) // MAX_FILLED)
        return [state for state in states[::-1][::stride] if not self.knows(state)]


MAX_STATES = 4000  # of a run that are kept, about 6 kB each; beyond it every second one is dropped


class History(Sequence):
    """The first `count` entries of a list that is only appended to: a frozen sequence without a copy.

    `lineage` is one object for all histories of a run; a reset, or continuing from an earlier state, makes a new one.
    """

    __slots__ = ("_count", "_states", "lineage")

    def __init__(self, states: list, count: int, lineage: object = None):
        self.lineage = states if lineage is None else lineage
        self._states, self._count = states, count

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> Any: ...

    @overload
    def __getitem__(self, index: slice) -> list[Any]: ...

    def __getitem__(self, index: int | slice) -> Any:
        if isinstance(index, slice):
            return self._states[: self._count][index]
        return self._states[range(self._count)[index]]


def thinned(states: Sequence) -> list:
    """Return about half of the states: the first, the last, the first of every stage, every second of the others."""
    last = len(states) - 1
    begins = {i for i in range(1, last) if states[i].stage != states[i - 1].stage}
    return [state for i, state in enumerate(states) if i % 2 == 0 or i == last or i in begins]


def recorded(states: Iterable) -> list:
    """Return the states of a run as a session keeps them, MAX_STATES at most."""
    kept: list = []
    for state in states:
        if len(kept) >= MAX_STATES:
            kept = thinned(kept)
        kept.append(state)
    return kept


@dataclass(frozen=True)
class SessionView:
    """What a session shows; never changed after it is published."""

    state: Any  # the solver state at `index`
    index: int  # place in the history that is shown; the run continues from there
    count: int  # number of states in the history
    running: bool  # whether steps are being taken
    error: str  # the last exception of the solver, "" if there is none
    history: History  # oldest first
    costs: StateCosts = field(default_factory=StateCosts, compare=False)  # of the states in the history
    refused: InputError | None = None  # why the last command was refused, which changed nothing

    @property
    def cost(self) -> float:
        """Cost of the state by the reference cost, dB; in a run or a drag perhaps that of a state just before."""
        state = self.history[self.index]
        return self.costs.of(state) if self.costs.knows(state) else self.costs.newest
