"""Frozen records of a run: the states so far, and what a session shows at one moment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


class History(Sequence):
    """The first `count` entries of a list that is only ever appended to: a frozen sequence that costs no copy.

    `lineage` is shared by histories of which one begins with the other; a cut makes a new one.
    """

    __slots__ = ("_count", "lineage")

    def __init__(self, states: list, count: int):
        self.lineage = states
        self._count = count

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index):
        if isinstance(index, slice):
            return self.lineage[: self._count][index]
        return self.lineage[range(self._count)[index]]


@dataclass(frozen=True)
class SessionView:
    """What a session shows at one moment; never changed after it is published.

    Attributes
    ----------
    state : the solver state at `index`
    index : int, place in the history that is looked at; going on starts there
    count : int, number of states in the history
    running : bool, whether steps are being taken
    error : str, the solver's last exception, "" when all is well
    history : sequence of states, oldest first
    """

    state: Any
    index: int
    count: int
    running: bool
    error: str
    history: History
