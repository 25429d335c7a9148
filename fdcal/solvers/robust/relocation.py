"""Channels that do not fit where they are, at another place, with another gain or with a filter."""

from __future__ import annotations

from dataclasses import replace

from ...model.problem import Problem
from ...model.validation import frozen_array
from . import assumptions, hyperparameters, outliers
from .settings import RULES, SCHEDULE
from .state import State


def relocated(problem: Problem, state: State, local: bool = False) -> tuple[State, bool]:
    """Return `state` with channels that do not fit changed, and whether any was.

    local : only with a filter, and near where they are, on a finer lattice
    """
    used, m = assumptions.used_modes(problem, state, RULES.search_modes), state.model
    gains = SCHEDULE[state.progress.row].gains and assumptions.gains_are_free(state)
    found = outliers.relocate(
        outliers.Placed(state.positions, state.gains, state.offsets, m.filters, m.channel_noise),
        problem.pressures[used],
        assumptions.wavenumbers(problem, state)[used],
        m.power[used],
        m.noise[used],
        problem.dimension,
        filters=gains,
        local=local,
    )
    if found is None:
        return state, False
    elsewhere = replace(
        state,
        positions=frozen_array(found.positions, float),
        gains=frozen_array(found.gains, float),
        offsets=frozen_array(found.offsets, float),
        model=replace(m, channel_noise=found.channel_noise, filters=frozen_array(found.filters, float)),
    )
    return hyperparameters.with_noise(problem, elsewhere, rough=not gains), True
