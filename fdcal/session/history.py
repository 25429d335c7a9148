"""The states of a run so far, and what a session shows: frozen records."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, overload

from .state_costs import StateCosts

MOST_STATES = 4000  # of a run that are kept, about 6 kB each; beyond it every second one is dropped


class History(Sequence):
    """The first `count` entries of a list that is only appended to: a frozen sequence without a copy.

    `lineage` is the same object for all histories of one run; a reset, or continuing from an earlier state, makes a
    new one.
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
    """Return the states of a run as a session keeps them, MOST_STATES at most."""
    kept: list = []
    for state in states:
        if len(kept) >= MOST_STATES:
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

    @property
    def cost(self) -> float:
        """Cost of the state by the reference cost, dB; in a run or a drag perhaps that of a state just before."""
        return self.costs.of(self.state) if self.costs.knows(self.state) else self.costs.newest
