"""Which covariance of the field a stage assumes, and the power of the field by direction, which the last one learns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...cost.angular_prior import diffuse_prior, directions_needed, learned_prior
from ...model.problem import Problem
from ...model.validation import frozen_array
from .assumptions import corrected, field_wavenumbers, given_carry_scale, used_modes, wavenumbers
from .settings import ASSUMED, NOISE_RULES
from .state import DIRECTIONAL, KernelName, State

NEAR_SHARE = {2: 1e-5, 3: 2e-6}  # with less noise a source near the array counts


def kernel_of(problem: Problem, state: State) -> KernelName:
    """The kernel of an isotropic field that the noise left calls for."""
    k = problem.wavenumbers[state.modes]
    radius = float(np.sqrt(np.mean(np.sum((state.positions - state.positions.mean(axis=0)) ** 2, axis=1))))
    return "series" if (np.abs(np.imag(k)).max() * radius) ** 2 > ASSUMED.damped * state.model.share else "diffuse"


def last_kernel(problem: Problem, state: State) -> KernelName:
    """The kernel of the last row: directional, but for plane arrays in space and where that would take too long."""
    k = wavenumbers(problem, state)[used_modes(problem, state, 0)]
    products = len(k) * len(state.positions) ** 2 * directions_needed(state.positions, k, problem.dimension)
    slow = problem.dimension == 3 and products > ASSUMED.most_products
    if slow or given_carry_scale(problem):
        return state.model.kernel
    return "damped_directional" if kernel_of(problem, state) == "series" else "directional"


def with_damping(problem: Problem, state: State) -> State:
    """`state` with damped waves, where its noise is now so low that the damping counts."""
    counts = state.model.kernel == "directional" and kernel_of(problem, state) == "series"
    return replace(state, model=replace(state.model, kernel="damped_directional")) if counts else state


def near_field_counts(problem: Problem, state: State) -> bool:
    """Whether the noise is so low that a source near the array would count."""
    return state.model.share <= NEAR_SHARE[problem.dimension]


def with_directions(problem: Problem, state: State, used, updates: int) -> State:
    """`state` with the power of the field by direction learned a little further, where its kernel has one."""
    model = state.model
    if model.kernel not in DIRECTIONAL:
        return state
    k = field_wavenumbers(problem, state)
    learned = np.array(
        diffuse_prior(state.positions, k, problem.dimension) if model.directions is None else model.directions
    )
    learned[used] = learned_prior(
        state.positions,
        corrected(problem, state, used),
        k[used],
        model.power[used],
        model.noise[used],
        learned[used],
        updates,
        model.channel_noise,
        NOISE_RULES.direction_count[problem.dimension],
        state.shape,
        problem.dimension,
    )
    return replace(state, model=replace(model, directions=frozen_array(learned, float)))


def with_turned_directions(problem: Problem, state: State, before) -> State:
    """`state`, which was moved as a whole from the positions `before` (N, D), with directions learned again."""
    furthest = float(np.abs(state.positions - before).max())
    shape = replace(state, shape=state.positions)
    if furthest * float(np.real(problem.wavenumbers).max()) < ASSUMED.turned:
        return with_directions(problem, shape, used_modes(problem, state, 0), ASSUMED.direction_updates)
    cleared = replace(shape, model=replace(state.model, directions=None))
    return with_directions(problem, cleared, used_modes(problem, cleared, 0), ASSUMED.turned_updates)
