"""Coordinate frames of a result, and microphones that stand elsewhere than given.

known     as they are: the axes of the known microphones
minimal   the first microphone is the origin, the second lies on the positive x axis, the third in the x-y plane
          with y > 0, the fourth of an array in space has z > 0; a microphone in line with those before is skipped
axes      the centre of the array is the origin, x its longest axis, then y; the sum of cubes is positive on each
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..model.gauge import align
from ..model.microphones import MicrophonePositions
from ..model.validation import InputError, require_choice, word_arguments
from .calibration import Calibration

FRAMES = ("known", "minimal", "axes")
COLLINEAR = 1e-6  # of the array's extent: microphones this close to a line or plane through others lie in it
INDEPENDENT = 0.1  # least part of a coordinate axis outside the axes found so far, to complete them
TRUSTED = "good"  # the verdict with which finding no swap means that there is none
SWAP_RATIO = 0.5  # a swap must reduce the distance of each microphone concerned to less than this share


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


@dataclass(frozen=True)
class PositionCheck:
    """Estimated positions compared with those given.

    Attributes
    ----------
    errors : (N,) float64
        Metres, distance from the given position after the best rigid motion.
    swapped : tuple of (int, int)
        Pairs of channels whose positions are exchanged.
    permuted : tuple of tuple of int
        Cycles of more than two channels that stand at each other's positions.
    """

    errors: np.ndarray
    swapped: tuple[tuple[int, int], ...]
    permuted: tuple[tuple[int, ...], ...]


def compare_positions(found, given, known=()) -> PositionCheck:
    """Compare estimated positions with those given.

    A swap is reported where the array as a whole fits better with it and each microphone concerned by half at least.

    Parameters
    ----------
    found, given : (N, D) array_like
        Metres.
    known : sequence of int
        Numbers of known microphones; without any, the positions are first moved onto each other as a whole.

    Returns
    -------
    PositionCheck

    Raises
    ------
    InputError
        The two have different shapes.

    Examples
    --------
    >>> import fdcal
    >>> given = [[0.0, 0.0], [1.0, 0.0], [0.0, 2.0], [1.5, 2.5], [3.0, 0.7]]
    >>> fdcal.compare_positions([given[n] for n in (0, 1, 3, 2, 4)], given, known=[0, 1, 4]).swapped
    ((2, 3),)
    """
    found, given = np.asarray(found, float), np.asarray(given, float)
    if found.shape != given.shape:
        raise InputError(
            f"the result has positions of shape {found.shape}, the measurement {given.shape}",
            "use the result of this measurement",
            key="result",
        )
    placed = found if len(known) else align(found, given, _consistent(found, given))
    order = _assignment(placed, given)
    if not len(known):
        placed = align(found, given[order])
        order = _assignment(placed, given)
    cycles = _cycles(order)
    errors = np.linalg.norm(placed - given, axis=1)
    pairs = tuple((c[0], c[1]) for c in cycles if len(c) == 2)
    return PositionCheck(errors, pairs, tuple(c for c in cycles if len(c) > 2))


def _consistent(found: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Return the half of the microphones whose distances to the others agree best: none of them is swapped."""
    off = [np.median(np.abs(np.linalg.norm(f - found, axis=1) - np.linalg.norm(g - given, axis=1)))
           for f, g in zip(found, given, strict=True)]  # fmt: skip
    return np.argsort(off, kind="stable")[: max(found.shape[1] + 2, (len(found) + 1) // 2)]


def _assignment(placed: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Return whose given position each microphone is at : (N,) int64, its own unless a whole cycle is nearer."""
    distance = np.linalg.norm(placed[:, None] - given[None], axis=2)
    from scipy.optimize import linear_sum_assignment  # takes a tenth of a second to load

    order = linear_sum_assignment(distance**2)[1]
    kept = np.arange(len(order))
    for cycle in _cycles(order):
        if all(distance[n, order[n]] < SWAP_RATIO * distance[n, n] for n in cycle):
            kept[list(cycle)] = order[list(cycle)]
    return kept


def _cycles(order: np.ndarray) -> list[tuple[int, ...]]:
    """Return the cycles of a permutation that move something, each from its lowest number."""
    seen, cycles = set(), []
    for start in range(len(order)):
        cycle, n = [], start
        while n not in seen:
            seen.add(n)
            cycle.append(n)
            n = int(order[n])
        if len(cycle) > 1:
            cycles.append(tuple(cycle))
    return cycles


def describe(
    check: PositionCheck,
    names: Sequence[object],
    verdict: str = "good",
    known: bool = True,
    arguments: Mapping[str, str] | None = None,
) -> str:
    """Return a comparison in words: every swap, then the error of every microphone, the largest first.

    Parameters
    ----------
    names : (N,) names of the microphones
    verdict : code of `fdcal.assessment.verdict` or `fdcal.assessment.room_verdict`; unless it is "good", finding no
        swap does not mean that there is none
    known : whether known microphones fixed the positions
    arguments : how the reader calls the arguments, as of `fdcal.model.validation.word_arguments`
    """
    lines = [f"channels {names[a]} and {names[b]} are swapped" for a, b in check.swapped]
    for cycle in check.permuted:
        lines.append(f"channels {', '.join(str(names[n]) for n in cycle)} stand in each other's places")
    if not lines and verdict != TRUSTED:
        advice = word_arguments("; try <known> none", arguments or {}) if known else ""
        lines = [f"swaps cannot be detected from positions that are not to be trusted ({verdict}){advice}"]
    lines = lines or ["no channels are swapped"]
    order = np.argsort(-check.errors, kind="stable")
    lines += [f"{names[n]!s:>12}  {1e3 * check.errors[n]:8.1f} mm" for n in order]
    return "\n".join(lines)
