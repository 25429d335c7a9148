"""Known microphones, rigid alignment and position errors.

Pressures alone leave the array free to move, turn and flip as a whole: the gauge. Known microphones fix it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .validation import InputError, frozen_array


@dataclass(frozen=True, eq=False)
class GaugeFrame:
    """The least gauge: one position, one direction, one sign (section 5 of the paper); in space a plane as well.

    Attributes
    ----------
    microphones : (D + 1,) int64; the first one's position is known, the second's direction from it, and on which side
        of what is fixed by then each of the others stands
    positions : (D + 1, D) float64, metres; of the others than the first only what is said above counts
    """

    microphones: np.ndarray
    positions: np.ndarray


def minimal_frame(known, known_positions) -> GaugeFrame:
    """The frame of the first D + 1 of `known` (A,), at `known_positions` (A, D), metres, that span D directions.

    Raises InputError where no such are known.
    """
    places = np.asarray(known_positions, float)
    D = places.shape[1]
    chosen = list(range(min(2, len(places))))
    for candidate in range(2, len(places)):
        if len(chosen) <= D and _spans(places[[*chosen, candidate]]):
            chosen.append(candidate)
    if len(chosen) != D + 1:
        raise InputError(
            f"known = {np.asarray(known).tolist()} fixes no frame; the least gauge needs {D + 1} known microphones that"
            " span the array: a position, a direction and a side"
        )
    return GaugeFrame(frozen_array(np.asarray(known)[chosen], np.int64), frozen_array(places[chosen], float))


def move_to_frame(positions, frame: GaugeFrame) -> np.ndarray:
    """`positions` (N, D), metres, moved, turned and flipped as a whole into `frame`."""
    origin = positions[frame.microphones[0]]
    turn = _axes(positions[frame.microphones]) @ _axes(frame.positions).T
    return (positions - origin) @ turn + frame.positions[0]


def _axes(points: np.ndarray) -> np.ndarray:
    """Orthonormal axes (D, D), columns: towards the second point, then by Gram and Schmidt towards the others."""
    Q, R = np.linalg.qr((points[1:] - points[0]).T)
    return Q * np.where(np.diag(R) < 0, -1.0, 1.0)


def _spans(points: np.ndarray) -> bool:
    """Whether A points span A - 1 directions."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[len(points) - 2] > 1e-3 * spread[0])


def rigid_motions(positions) -> np.ndarray:
    """Translations and infinitesimal rotations of `positions` (N, D) : (N D, D (D + 1) / 2) float64."""
    N, D = positions.shape
    centred = positions - positions.mean(axis=0)
    moves = [np.tile(row, N) for row in np.eye(D)]
    for a in range(D):
        for b in range(a):
            turned = np.zeros((N, D))
            turned[:, a], turned[:, b] = centred[:, b], -centred[:, a]
            moves.append(turned.ravel())
    return np.array(moves).T


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
