"""The cost of the states of a run by one reference cost, which is the same for every solver.

The solver thread computes it, and any thread may read it. A step can be shorter than its cost takes to compute, so
that while the solver runs the cost of some states is left out, and computed when the solver rests.
"""

from __future__ import annotations

import time
import weakref
from collections.abc import Callable, Sequence

import numpy as np

from ..solvers.interface import RunState

SHARE = 0.25  # of the time of the steps that costs may take while the solver runs
MOST_FILLED = 300  # states, evenly spaced over a run, whose cost is computed when the solver rests


class StateCosts:
    """Costs of states, by the state itself; those of states that no longer exist are forgotten.

    `reference_cost`: returns the cost of a state, dB; without one every cost is NaN. `newest`: the cost computed last,
    dB; `count`: how many were computed.
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
        self._duration = time.thread_time() - began
        self._values[key] = weakref.ref(state, lambda _: self._values.pop(key, None)), value
        self.newest, self.count = value, self.count + 1

    def knows(self, state: RunState) -> bool:
        """Return whether the cost of a state is there, or cannot be computed."""
        found = self._values.get(id(state))
        return self._reference_cost is None or (found is not None and found[0]() is state)

    def compute_in_passing(self, state: RunState, spent: float) -> None:
        """Compute the cost of a state of a running solver, unless costs have had their share of the time.

        `spent`: processor time of the step, s.
        """
        self._credit = min(self._credit + SHARE * spent, 2 * self._duration + SHARE * spent)
        if self._credit >= self._duration:
            self.compute(state)
            self._credit -= self._duration

    def missing(self, states: Sequence[RunState]) -> list[RunState]:
        """Return the states whose cost is to be computed when the solver rests, the last first."""
        if self._reference_cost is None:
            return []
        stride = max(1, len(states) // MOST_FILLED)
        return [state for state in states[::-1][::stride] if not self.knows(state)]
