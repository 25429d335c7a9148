"""Whether the last row can minimise the conditional likelihood (`fdcal.cost.conditional_likelihood`).

It is free of what the likelihood of a random field supposes of the room, and less sharp. Where the pressures hardly fix
the size and shears of the array without that supposition, as of a small array, the array would run off.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...model.problem import Problem
from . import assumptions, kernels
from .channel_fit import reduced
from .conditional_rules import CONDITIONAL
from .convergence import scaled_inverse
from .settings import FINAL
from .state import State


def with_conditional(problem: Problem, state: State) -> State:
    """Return `state`, at the beginning of the last row, with the conditional likelihood if the array permits it.

    Parameters
    ----------
    problem : Problem
        With modes of unit power.
    state : State
    """
    used = assumptions.used_modes(problem, state, 0)
    slow = len(used) * len(state.positions) ** 3 > CONDITIONAL.most_products
    noisy = state.model.share > CONDITIONAL.noise_share
    without = replace(state, model=replace(state.model, conditional=""))  # it may be that of a run with other modes
    if state.model.kernel == "near" or noisy or slow:
        return without
    kernel = "series" if kernels.kernel_of(problem, state) == "series" else "diffuse"
    chosen = replace(state, model=replace(state.model, conditional=kernel), progress=replace(state.progress, row=FINAL))
    here, goal = assumptions.unknowns(chosen), assumptions.objective(problem, chosen, used)
    size = state.positions.size  # the positions are the first of the free unknowns
    try:
        free = assumptions.free_unknowns(problem, chosen, None)
        H = reduced(here, goal.evaluate(here), free, not len(problem.known))[1]
        sigma = stretch_sigma(state.positions, [scaled_inverse(H)[:size, :size]])
    except np.linalg.LinAlgError:
        return without
    most = CONDITIONAL.stretch_sigma if len(problem.known) else CONDITIONAL.blind_stretch_sigma
    return chosen if sigma < most else without


def stretch_sigma(positions: np.ndarray, covariances) -> float:
    """Return one sigma of the least certain stretching or shearing of an array as a whole, relative.

    Parameters
    ----------
    positions : (N, D) float64, metres
    covariances : sequence of (N D, N D) float64, metres^2; the one that makes it largest counts

    Of the maps x -> x + B x, B symmetric, that fit a move of the microphones best.
    """
    x = positions - positions.mean(axis=0)
    N, D = x.shape
    fit = np.kron(np.linalg.pinv(np.column_stack([x, np.ones(N)]))[:D], np.eye(D))  # (D D, N D)
    fit = np.array([(B + B.T).ravel() / 2 for B in np.eye(D * D).reshape(-1, D, D)]) @ fit
    return float(np.sqrt(max(np.linalg.eigvalsh(fit @ P @ fit.T)[-1] for P in covariances)))
