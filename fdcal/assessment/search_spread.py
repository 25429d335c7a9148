"""How far the ends of a search lie apart that explain the pressures about as well.

    w_e = exp(-score_e) / sum_f exp(-score_f),   covariance of microphone n = sum_e w_e d_en d_en^T

d_en is the distance of microphone n between end e of the solver and the array that it returned. One sigma from the
curvature at one minimum knows neither another end nor the way from an attempt's end to the last stage. An end that
other given positions held is first moved onto that array as a whole.
"""

from __future__ import annotations

import numpy as np

from ..model.gauge import align
from ..model.problem import Problem
from ..solvers.robust.given_positions import inaccurate, same_given
from ..solvers.robust.state import State


def end_weights(state: State) -> np.ndarray:
    """Return the weights of the ends, of sum 1 : (E,) float64; none without an end whose score is finite."""
    scores = np.array([end.score for end in state.ends])
    if not len(scores) or not np.isfinite(scores).any():
        return np.zeros(len(scores))
    weights = np.exp(-(scores - scores[np.isfinite(scores)].min()))
    return weights / weights.sum()


def search_spread(problem: Problem, state: State, healthy: np.ndarray) -> np.ndarray:
    """Return the covariance of each position between the ends of the solver.

    Parameters
    ----------
    problem : Problem
    state : State
    healthy : (N,) bool
        Microphones that determine the motion onto each other of arrays that nothing holds as a whole.

    Returns
    -------
    (N, D, D) float64, metres^2
    """
    x = state.positions
    spread = np.zeros((*x.shape, x.shape[1]))
    for weight, end in zip(end_weights(state), state.ends, strict=True):
        if weight > 0:
            placed = len(problem.known) and same_given(state, end) and not inaccurate(state)
            away = (end.positions if placed else align(end.positions, x, healthy)) - x
            spread += weight * away[:, :, None] * away[:, None, :]
    return spread
