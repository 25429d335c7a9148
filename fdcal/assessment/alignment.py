"""Coordinate frames of a result.

known     as they are: the axes of the known microphones
minimal   the first microphone is the origin, the second lies on the positive x axis, the third in the x-y plane
          with y > 0, the fourth of an array in space has z > 0; a microphone in line with those before is skipped
axes      the centre of the array is the origin, x its longest axis, then y; the sum of cubes is positive on each
"""

from __future__ import annotations

import numpy as np

from ..model.microphones import MicrophonePositions
from ..model.validation import InputError, require_choice
from .calibration import Calibration

FRAMES = ("known", "minimal", "axes")
COLLINEAR = 1e-6  # of the array's extent: microphones this close to a line or plane through others lie in it
INDEPENDENT = 0.1  # least part of a coordinate axis outside the axes found so far, to complete them


def in_frame(positions, frame: str) -> np.ndarray:
    """Return positions moved, rotated and maybe mirrored as a whole into a frame.

    Parameters
    ----------
    positions : (N, D) float64, metres
    frame : one of FRAMES

    Returns
    -------
    (N, D) float64, metres

    Raises
    ------
    InputError
        The frame is unknown.
    """
    require_choice("frame", frame, FRAMES)
    positions = np.asarray(positions, dtype=float)
    if frame == "known":
        return positions.copy()
    return _minimal(positions) if frame == "minimal" else _axes(positions)


def placed_in_frame(result: Calibration, frame: str | None) -> MicrophonePositions:
    """Return the microphones of a result in a frame.

    Parameters
    ----------
    frame : one of FRAMES; None for that of the known microphones, or "axes" without any

    Raises
    ------
    InputError
        The frame of the known microphones is asked for and there is none.
    """
    blind = result.known == ()
    if frame is None:
        frame = "axes" if blind else "known"
    if frame == "known" and blind:
        raise InputError(
            "frame = known, but no microphone was known", "use <frame> minimal or axes", key="frame", value="known"
        )
    return MicrophonePositions(result.names, in_frame(result.positions, frame), result.uncertainty, frame)


def _minimal(positions: np.ndarray) -> np.ndarray:
    apart = positions - positions[0]
    extent = np.linalg.norm(apart, axis=1).max()
    basis: list[np.ndarray] = []
    for vector in apart[1:]:
        rest = vector - sum((np.dot(vector, axis) * axis for axis in basis), np.zeros_like(vector))
        rest = rest - sum((np.dot(rest, axis) * axis for axis in basis), np.zeros_like(vector))  # removes rounding
        if len(basis) < positions.shape[1] and np.linalg.norm(rest) > COLLINEAR * extent:
            basis.append(rest / np.linalg.norm(rest))
    for axis in np.eye(positions.shape[1]):  # an array in a line or a plane leaves some axes open
        rest = axis - sum((np.dot(axis, b) * b for b in basis), np.zeros_like(axis))
        if len(basis) < positions.shape[1] and np.linalg.norm(rest) > INDEPENDENT:
            basis.append(rest / np.linalg.norm(rest))
    return apart @ np.array(basis).T


def _axes(positions: np.ndarray) -> np.ndarray:
    centred = positions - positions.mean(axis=0)
    turned = centred @ np.linalg.svd(centred, full_matrices=True)[2].T
    return turned * np.where(np.sum(turned**3, axis=0) < 0, -1.0, 1.0)
