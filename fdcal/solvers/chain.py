"""Solvers in sequence: each begins at the positions at which the one before has ended.

A chain is used like any solver. Its states are those of its members; step, sweep and stage are counted on. The name in
a state (`RunState.solver`) says which member continues from it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import ModuleType

import numpy as np

from ..model.problem import Problem
from ..model.settings import SolverSettings
from .estimate import Estimate, RoomEstimate
from .interface import RunState, Traits


@dataclass(frozen=True)
class Chain:
    """Solvers in sequence."""

    # modules as of `fdcal.solvers.interface.Solver`; the `init` of every one but the first takes `positions`
    members: tuple[ModuleType, ...]

    @property
    def State(self) -> type[RunState]:
        """Base class of the states: each is that of a member."""
        return RunState

    @property
    def TRAITS(self) -> Traits:
        """Properties of the chain: it starts like its first member and is assessed like its last."""
        each: list[Traits] = [member.TRAITS for member in self.members]
        settings = [traits.settings for traits in each if traits.settings is not None]
        return Traits(
            moves_all=all(traits.moves_all for traits in each),
            needs_search=any(traits.needs_search for traits in each),
            needs_room=any(traits.needs_room for traits in each),
            adds_modes=any(traits.adds_modes for traits in each),
            starts=each[0].starts,
            draws_order=any(traits.draws_order for traits in each),
            takes_positions=each[0].takes_positions,
            settings=frozenset().union(*settings) if len(settings) == len(each) else None,
            uses_likelihood=any(traits.uses_likelihood for traits in each),
        )

    def init(self, problem: Problem, settings: SolverSettings, seed: int) -> RunState:
        """Return the start of the first member. Raises InputError, too, for what a later member cannot work on."""
        state = self.members[0].init(problem, settings, seed)
        for member in self.members[1:]:
            member.init(problem, settings, seed, positions=state.positions)
        return state

    def step(self, problem: Problem, state: RunState) -> RunState:
        """Return `state` one step on; where its member has finished, the start of the next member.

        With modes set by the user (`automatic` false) the chain ends with the active member.
        """
        number = self._number(state)
        after = self.members[number].step(problem, state)
        if not after.finished or not after.automatic or number + 1 == len(self.members):
            return after
        begun = self.members[number + 1].init(problem, after.settings, after.seed, positions=after.positions)
        return replace(begun, step=after.step, sweep=after.sweep, stage=after.stage + 1)

    def use_modes(self, problem: Problem, state: RunState, first: int, last: int, automatic: bool) -> RunState:
        """Return `state` with modes `first` to `last` in use (from 1, both included); its member continues."""
        return self.members[self._number(state)].use_modes(problem, state, first, last, automatic)

    def landscape(self, problem: Problem, state: RunState, n: int, modes: slice, *search) -> np.ndarray:
        """Return the landscape of microphone `n` by the active member, mode by mode : (modes, ny, nx) float64."""
        return self.members[self._number(state)].landscape(problem, state, n, modes, *search)

    def result(self, problem: Problem, state: RunState) -> Estimate | RoomEstimate:
        """Return what the active member has found."""
        return self.members[self._number(state)].result(problem, state)

    def usable_modes(self, problem: Problem, settings: SolverSettings) -> int:
        """Return how many of the lowest modes every member can use."""
        return min(member.usable_modes(problem, settings) for member in self.members)

    def _number(self, state: RunState) -> int:
        """Number of the member whose state it is."""
        return next(i for i, member in enumerate(self.members) if isinstance(state, member.State))
