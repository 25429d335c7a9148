"""Known microphones, rigid alignment and position errors.

The pressures determine the array except for a rigid motion and a mirror image. This freedom is called the gauge; known
microphones fix it.

Frames in which positions are given:

known     the axes of the given positions of the known microphones
minimal   the first microphone is the origin; the second lies on the positive x axis; the third lies in the x-y plane
          with y > 0; the fourth of an array in space has z > 0. A microphone is skipped if it lies on one line with the
          previous ones or, as the fourth in space, in one plane with them
axes      the centroid of the array is the origin; x is its longest principal axis, y the next; the signs are such that
          the sum of the cubes of each coordinate is positive
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .validation import InputError, Integers, Reals, frozen_array, require_choice

FRAMES = ("known", "minimal", "axes")
COLLINEAR = 1e-6  # microphones lie in a line or plane if their distance from it is below this times the array's extent
INDEPENDENT = 0.1  # a coordinate axis is added to the axes found so far if its part perpendicular to them exceeds this
FLAT = 1e-3  # an array lies on a line or in a plane if its smallest extent is below this times the largest one
MIN_KNOWN = {  # what fixes the gauge, by the number of coordinates
    2: "three known microphones that are not on one line",
    3: "four known microphones that are not in one plane",
}


@dataclass(frozen=True, eq=False)
class GaugeFrame:
    """The minimal gauge: a position, a direction and a side (section 5 of the paper); in space a plane as well."""

    # (D + 1,) int64. The gauge fixes the position of the first microphone and the direction from it to the second. For
    # each further microphone it fixes on which side of the line, or plane, through the previous ones it lies
    microphones: np.ndarray
    # (D + 1, D) float64, metres; except for the first, only the directions and sides that they define are used
    positions: np.ndarray


def minimal_frame(known: Integers, known_positions: Reals) -> GaugeFrame:
    """Return the frame of the first D + 1 known microphones, at (A, D) metres, that span D directions.

    Raises InputError if they span fewer directions.
    """
    positions = np.asarray(known_positions, float)
    D = positions.shape[1]
    chosen = list(range(min(2, len(positions))))
    for candidate in range(2, len(positions)):
        if len(chosen) <= D and _spans(positions[[*chosen, candidate]], len(chosen)):
            chosen.append(candidate)
    if len(chosen) != D + 1:
        problem = f"known = {np.asarray(known).tolist()} does not fix position, rotation and mirror image"
        raise InputError(problem, f"name {MIN_KNOWN[D]}", key="known")
    return GaugeFrame(frozen_array(np.asarray(known)[chosen], np.int64), frozen_array(positions[chosen], float))


def move_to_frame(positions: Reals, frame: GaugeFrame) -> np.ndarray:
    """Return `positions` (N, D), metres, moved into `frame` by a rigid motion, which may include a mirror image."""
    return (positions - positions[frame.microphones[0]]) @ turn_to_frame(positions, frame) + frame.positions[0]


def turn_to_frame(positions: Reals, frame: GaugeFrame) -> np.ndarray:
    """Return the matrix (D, D) by which `move_to_frame` multiplies rows of offsets: a rotation, or a mirror image.

    positions : (N, D), metres; the positions of the frame's microphones among them determine the axes of the array
    """
    axes = list[np.ndarray]()
    for points in (positions[frame.microphones], frame.positions):
        # Gram-Schmidt: the first axis points towards the second point, and so on
        Q, R = np.linalg.qr((points[1:] - points[0]).T)
        axes.append(Q * np.where(np.diag(R) < 0, -1.0, 1.0))
    return axes[0] @ axes[1].T


def _spans(points: np.ndarray, directions: int) -> bool:
    """Return whether points (A, D) span at least this number of directions."""
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extents[directions - 1] > FLAT * extents[0])


def rigid_motions(positions: Reals) -> np.ndarray:
    """Return the translations and infinitesimal rotations of `positions` (N, D), as columns.

    The result is (N D, D (D + 1) / 2) float64; the columns are not normalised.
    """
    N, D = positions.shape
    centred = positions - positions.mean(axis=0)
    moves = [np.tile(row, N) for row in np.eye(D)]
    for a in range(D):
        for b in range(a):
            rotation = np.zeros((N, D))
            rotation[:, a], rotation[:, b] = centred[:, b], -centred[:, a]
            moves.append(rotation.ravel())
    return np.array(moves).T


def position_errors(estimate: ArrayLike, truth: ArrayLike | None) -> np.ndarray:
    """Return the distance of each microphone (N, D) from its true position, metres : (N,)."""
    return np.linalg.norm(np.asarray(estimate) - np.asarray(truth), axis=1)


def align(estimate: ArrayLike, truth: ArrayLike, by: slice | np.ndarray = slice(None)) -> np.ndarray:
    """Return `estimate` moved onto `truth` by the best rigid motion, which may include a mirror image.

    Both are (N, D), metres. The motion is the best one for the microphones `by`.
    """
    estimate, truth = np.asarray(estimate, float), np.asarray(truth, float)
    turn, centre, target = rigid_motion(estimate[by], truth[by])
    return (estimate - centre) @ turn + target


def rigid_motion(x: Reals, others: Reals, mirror: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return `turn`, `centre` and `target` of the best motion (x - centre) @ turn + target of `x` onto `others` (N, D).

    This is Kabsch's method without its condition on the determinant, because a mirror image has the same pressures. If
    `mirror` is true, the result is the best motion with the opposite determinant.
    """
    centre, target = x.mean(axis=0), others.mean(axis=0)
    left, _, right = np.linalg.svd((x - centre).T @ (others - target))
    if mirror:
        left = left * np.append(np.ones(left.shape[1] - 1), -1.0)
    return left @ right, centre, target


def fixes_gauge(positions: ArrayLike) -> bool:
    """Return whether microphones at (A, D), metres, fix translation, rotation and mirror image.

    They do so if they span D directions.
    """
    positions = np.asarray(positions, float)
    return len(positions) > positions.shape[1] and _spans(positions, positions.shape[1])


def in_frame(positions: Reals, frame: str) -> np.ndarray:
    """Return positions (N, D), metres, moved, rotated and possibly mirrored as a whole into a frame of FRAMES."""
    require_choice("frame", frame, FRAMES)
    positions = np.array(positions, float)
    if frame == "known":
        return positions
    if frame == "minimal":
        apart = positions - positions[0]
        # An array on a line or in a plane does not determine all axes; the coordinate axes complete them.
        candidates = [(vector, COLLINEAR * np.linalg.norm(apart, axis=1).max()) for vector in apart[1:]]
        candidates += [(axis, INDEPENDENT) for axis in np.eye(apart.shape[1])]
        axes = np.zeros((0, apart.shape[1]))
        for vector, least in candidates:
            rest = vector - axes.T @ (axes @ vector)
            rest = rest - axes.T @ (axes @ rest)  # removes rounding errors
            if len(axes) < apart.shape[1] and np.linalg.norm(rest) > least:
                axes = np.vstack([axes, rest / np.linalg.norm(rest)])
        return apart @ axes.T
    return (positions - positions.mean(axis=0)) @ principal_axes(positions)


def principal_axes(positions: Reals) -> np.ndarray:
    """Return the axes (D, D), in columns, of the frame "axes" of positions (N, D), metres."""
    centred = positions - positions.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=True)[2].T
    return axes * np.where(np.sum((centred @ axes) ** 3, axis=0) < 0, -1.0, 1.0)
