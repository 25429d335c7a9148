"""Solvers one after the other: the next begins from the positions at which the one before has ended.

A chain is driven like any solver. Its states are those of its members, with step, sweep and stage counted on; whose
state it is says who goes on from it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import ModuleType

import numpy as np

from ..model.measurement import Problem
from ..model.settings import SolverSettings


@dataclass(frozen=True)
class Chain:
    """Members in their order, modules with a `State`; every one but the first has an `init` that takes `positions`."""

    members: tuple[ModuleType, ...]

    def init(self, problem: Problem, settings: SolverSettings, seed: int):
        """The first member's start; InputError, too, for what a later one could not begin with."""
        state = self.members[0].init(problem, settings, seed)
        for member in self.members[1:]:
            member.init(problem, settings, seed, positions=state.positions)
        return state

    def step(self, problem: Problem, state):
        """`state` one step on; where its member has ended, as the start of the next.

        With modes set by hand (`automatic` false) the chain ends with the member at work.
        """
        member = self._member(state)
        after = self.members[member].step(problem, state)
        if not after.finished or not after.automatic or member + 1 == len(self.members):
            return after
        begun = self.members[member + 1].init(problem, after.settings, after.seed, positions=after.positions)
        return replace(begun, step=after.step, sweep=after.sweep, stage=after.stage + 1)

    def use_modes(self, problem: Problem, state, first: int, last: int, automatic: bool):
        """`state` with modes `first` to `last` in use (from 1, both included); its member goes on."""
        return self.members[self._member(state)].use_modes(problem, state, first, last, automatic)

    def landscape(self, problem: Problem, state, n: int, modes: slice, *lattice) -> np.ndarray:
        """What the member at work shows of microphone `n`, mode by mode : (modes, ny, nx) float64."""
        return self.members[self._member(state)].landscape(problem, state, n, modes, *lattice)

    def _member(self, state) -> int:
        """Number of the member whose state it is."""
        return next(i for i, member in enumerate(self.members) if isinstance(state, member.State))
