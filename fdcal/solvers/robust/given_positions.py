"""Given positions that the pressures contradict no longer hold the array; two that were exchanged are put right.

Where the given positions and the pressures agree nothing changes. Otherwise the array is sought without given
positions, and put where the likeliest of `given_hypotheses` has it; the next steps hold the positions that are right.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from ...model.gauge import align, rigid_motions
from ...model.problem import Problem
from ...model.validation import frozen_array
from . import assumptions
from .free_array import FreeArray, free_array
from .given_hypotheses import Hypothesis, hypotheses
from .given_rules import GIVEN
from .state import End, State


def resolved(problem: Problem, state: State) -> State:
    """Return `state` with the likeliest hypothesis on the given positions where those assumed do not fit the pressures.

    Parameters
    ----------
    problem : Problem
        With modes of unit power.
    state : State
    """
    exact = state.settings.known_sigma == 0
    if exact or len(problem.known) <= problem.array_dimension or assumptions.given_carry_scale(problem):
        return state
    if state.model.kernel == "near" and _close(problem, state):
        return state
    try:
        if _agree(problem, state, free_array(problem, state, 0)):
            return state
        found = free_array(problem, state, GIVEN.steps)
    except np.linalg.LinAlgError:
        return state
    best = likely(problem, state, found)[0]
    assumed = _assumed(problem, state, found, best)
    as_before = same_given(state, assumed) and best.sigma < GIVEN.inaccurate * GIVEN.sigma
    return state if best.scale or as_before else assumed


def likely(problem: Problem, state: State, found: FreeArray) -> list[Hypothesis]:
    """Return the hypotheses on the given positions, the likeliest first."""
    sized = state.settings.sound_speed_sigma is None
    return hypotheses(found, problem.known, problem.known_positions, state.settings.known_sigma, sized)


def _close(problem: Problem, state: State) -> bool:
    """Whether no given position is far from an array that, without noise, does not bend to it."""
    known, places = assumptions.held(problem, state)
    moved = align(state.positions[known], places)
    return bool(np.linalg.norm(moved - places, axis=1).max(initial=0.0) < GIVEN.close)


def _agree(problem: Problem, state: State, found: FreeArray) -> bool:
    """Whether the positions that hold the array and the pressures agree within their sigmas."""
    known, places = assumptions.held(problem, state)
    x, D = found.unknowns.positions, problem.array_dimension
    index = (known[:, None] * D + np.arange(D)).ravel()
    sigma = max(state.model.known_sigma, GIVEN.sigma)
    S = found.covariance[np.ix_(index, index)] + sigma**2 * np.eye(len(index))
    r, G = (places - x[known]).ravel(), rigid_motions(x)[index]
    weighed = np.linalg.solve(S, np.column_stack([r, G]))
    left = r - G @ np.linalg.solve(G.T @ weighed[:, 1:], G.T @ weighed[:, 0])
    freedom = len(index) - G.shape[1]
    return freedom <= 0 or bool(chdtrc(freedom, left @ np.linalg.solve(S, left)) > GIVEN.agree)


def _assumed(problem: Problem, state: State, found: FreeArray, best: Hypothesis) -> State:
    """`state` under a hypothesis."""
    moved = assumptions.with_unknowns(state, replace(found.unknowns, positions=best.positions))
    model = replace(
        moved.model,
        places=frozen_array(problem.known_positions[best.order], float),
        contradicted=frozen_array(~best.right, bool),
        known_sigma=best.sigma,
    )
    return replace(moved, shape=moved.positions, model=model)


def same_given(one: State | End, other: State | End) -> bool:
    """Return whether the same given positions hold two arrays."""
    a, b = one.model, other.model
    return bool(np.array_equal(a.contradicted, b.contradicted) and np.array_equal(a.places, b.places))


def inaccurate(state: State) -> bool:
    """Return whether the given positions are all less accurate than expected."""
    stated = state.settings.known_sigma
    return state.model.known_sigma > GIVEN.inaccurate * (GIVEN.sigma if stated is None else stated)
