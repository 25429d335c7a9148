"""Known microphones, rigid alignment and position errors.

Pressures alone leave the array free to move, turn and flip as a whole: the gauge. Known microphones fix it.
"""

from __future__ import annotations

import numpy as np


def position_errors(estimate, truth) -> np.ndarray:
    """Distance of each microphone from its true place : (N,) float64, metres; both (N, D), metres."""
    return np.linalg.norm(np.asarray(estimate) - np.asarray(truth), axis=1)


def align(estimate, truth, by=slice(None)) -> np.ndarray:
    """`estimate` moved, turned and flipped as a whole onto `truth`, least squares : (N, D) float64, metres.

    Both (N, D), metres. Kabsch's method without the condition on the determinant: a mirror image is allowed, since
    pressures cannot tell it from the array. `by` numbers the microphones that decide; all unless given.
    """
    estimate, truth = np.asarray(estimate, float), np.asarray(truth, float)
    centre, goal = estimate[by].mean(axis=0), truth[by].mean(axis=0)
    U, _, Vt = np.linalg.svd((estimate[by] - centre).T @ (truth[by] - goal))
    return (estimate - centre) @ (U @ Vt) + goal


def fixes_gauge(positions) -> bool:
    """Whether microphones at `positions` (A, D), metres, fix translation, rotation and mirror.

    They do if they span all D directions, counted with a tolerance of a thousandth of their extent.
    """
    positions = np.asarray(positions, float)
    if len(positions) <= positions.shape[1]:
        return False
    spread = np.linalg.svd(positions - positions.mean(axis=0), compute_uv=False)
    return bool(spread[-1] > 1e-3 * spread[0])
