"""Which covariance of the field a stage assumes, and the power of the field by direction, which the last one learns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...cost.angular_prior import diffuse_prior, learned_prior
from ...model.problem import Problem
from ...model.validation import frozen_array
from .assumptions import corrected, used_modes, wavenumbers
from .settings import ASSUMED, NOISE_RULES
from .state import KernelName, State

NEAR_SHARE = {2: 1e-5, 3: 2e-6}  # with less noise a source near the array counts


def kernel_of(problem: Problem, state: State) -> KernelName:
    """The kernel of an isotropic field that the noise left calls for."""
    k = problem.wavenumbers[state.modes]
    radius = float(np.sqrt(np.mean(np.sum((state.positions - state.positions.mean(axis=0)) ** 2, axis=1))))
    return "series" if (np.abs(np.imag(k)).max() * radius) ** 2 > ASSUMED.damped * state.model.share else "diffuse"


def near_field_counts(problem: Problem, state: State) -> bool:
    """Whether the noise is so low that a source near the array would count."""
    return state.model.share <= NEAR_SHARE[problem.dimension]


def noise_deflation(problem: Problem, state: State) -> float:
    """Factor by which less noise is assumed than there is: in space, where the field is taken as isotropic.

    A room's field is not. With less noise the positions depend more on the pressures and less on that assumption; with
    much noise it is needed. A plane array needs it always, for its size.
    """
    if problem.array_dimension < 3 or state.model.kernel == "directional":
        return 1.0
    return float(np.clip(NOISE_RULES.deflated / state.model.share, 1.0, NOISE_RULES.deflation))


def with_directions(problem: Problem, state: State, used, updates: int) -> State:
    """`state` with the power of the field by direction learned a little further, where its kernel has one."""
    model = state.model
    if model.kernel != "directional":
        return state
    k = wavenumbers(problem, state)
    learned = np.array(diffuse_prior(state.positions, k) if model.directions is None else model.directions)
    learned[used] = learned_prior(
        state.positions,
        corrected(problem, state, used),
        k[used],
        model.power[used],
        model.noise[used],
        learned[used],
        updates,
        model.channel_noise,
        NOISE_RULES.direction_count,
        state.shape,
    )
    return replace(state, model=replace(model, directions=frozen_array(learned, float)))


def with_turned_directions(problem: Problem, state: State) -> State:
    """`state` with directions learned again, for an array that was turned as a whole."""
    cleared = replace(state, model=replace(state.model, directions=None), shape=state.positions)
    return with_directions(problem, cleared, used_modes(problem, cleared, 0), ASSUMED.turned_updates)
