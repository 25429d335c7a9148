"""Axes to give positions in, and what stands elsewhere than it was said to stand.

known     as they are: the axes of the known microphones
minimal   the first microphone is the origin, the second lies on the positive x axis, the third in the x-y plane
          with y > 0, the fourth of a space has z > 0; one that is in line with those before is passed over
axes      the centre of the array is the origin, x its longest axis, then y; the sum of cubes is positive on each
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from ..model.gauge import align
from ..model.microphones import MicrophonePositions
from ..model.validation import InputError, require_choice
from .calibration import Calibration

FRAMES = ("known", "minimal", "axes")
IN_LINE = 1e-6  # of the array's extent: microphones this close to a line or plane through others lie in it
TRUSTED = ("good", "scale_undetermined")  # verdicts; with others no swap found is no all-clear
CLEARLY = 0.5  # of the distance as named: a swap explains what is this much closer after it


def in_frame(positions, frame: str) -> np.ndarray:
    """`positions` (N, D), metres, moved, turned and maybe mirrored as a whole into a frame : (N, D) float64."""
    require_choice("--frame", frame, FRAMES)
    positions = np.asarray(positions, dtype=float)
    if frame == "known":
        return positions.copy()
    return _minimal(positions) if frame == "minimal" else _axes(positions)


def placed_in_frame(result: Calibration, frame: str | None) -> MicrophonePositions:
    """Return the microphones of a calibration in a frame.

    Parameters
    ----------
    result : Calibration
    frame : str or None
        One of FRAMES; None takes that of the known microphones, or "axes" without any.

    Raises
    ------
    InputError
        The frame of the known microphones is asked for and there is none.
    """
    if frame is None:
        frame = "axes" if result.known == () else "known"
    if frame == "known" and result.known == ():
        raise InputError(
            "frame = known: no microphone was known", "use <frame> minimal or axes", key="frame", value=frame
        )
    return MicrophonePositions(result.names, in_frame(result.positions, frame), result.uncertainty, frame)


def _minimal(positions: np.ndarray) -> np.ndarray:
    apart = positions - positions[0]
    extent = np.linalg.norm(apart, axis=1).max()
    basis: list[np.ndarray] = []
    for vector in apart[1:]:
        rest = vector - sum((np.dot(vector, axis) * axis for axis in basis), np.zeros_like(vector))
        rest = rest - sum((np.dot(rest, axis) * axis for axis in basis), np.zeros_like(vector))  # rounding, once more
        if len(basis) < positions.shape[1] and np.linalg.norm(rest) > IN_LINE * extent:
            basis.append(rest / np.linalg.norm(rest))
    for axis in np.eye(positions.shape[1]):  # an array in a line or a plane leaves some open
        rest = axis - sum((np.dot(axis, b) * b for b in basis), np.zeros_like(axis))
        if len(basis) < positions.shape[1] and np.linalg.norm(rest) > 0.1:
            basis.append(rest / np.linalg.norm(rest))
    return apart @ np.array(basis).T


def _axes(positions: np.ndarray) -> np.ndarray:
    centred = positions - positions.mean(axis=0)
    turned = centred @ np.linalg.svd(centred, full_matrices=True)[2].T
    return turned * np.where(np.sum(turned**3, axis=0) < 0, -1.0, 1.0)


@dataclass(frozen=True)
class PositionCheck:
    """Positions as said and as found: `errors` (N,) float64, metres, after the best rigid motion; `swapped` pairs of
    channels whose places are exchanged; `permuted`, chains of more than two that are in each other's places."""

    errors: np.ndarray
    swapped: tuple[tuple[int, int], ...]
    permuted: tuple[tuple[int, ...], ...]


def compare_positions(found, said, known=()) -> PositionCheck:
    """Compare positions found (N, D) with those said to be (N, D), metres.

    A swap is named where the array as a whole fits better with it, each microphone concerned by half at least. The
    positions are first moved onto each other as a whole, unless `known` microphones hold them.
    """
    found, said = np.asarray(found, float), np.asarray(said, float)
    if found.shape != said.shape:
        raise InputError(f"{found.shape} positions were found where the file tells {said.shape}; use its own result")
    placed = found if len(known) else align(found, said, _trusted(found, said))
    order = _exchanged(placed, said)
    if not len(known):
        placed = align(found, said[order])
        order = _exchanged(placed, said)
    cycles = _cycles(order)
    errors = np.linalg.norm(placed - said, axis=1)
    return PositionCheck(errors, tuple(c for c in cycles if len(c) == 2), tuple(c for c in cycles if len(c) > 2))


def _trusted(found: np.ndarray, said: np.ndarray) -> np.ndarray:
    """The half of the microphones whose distances to most of the others are as said: none of them is swapped."""
    off = [np.median(np.abs(np.linalg.norm(f - found, axis=1) - np.linalg.norm(s - said, axis=1)))
           for f, s in zip(found, said, strict=True)]  # fmt: skip
    return np.argsort(off, kind="stable")[: max(found.shape[1] + 2, (len(found) + 1) // 2)]


def _exchanged(placed: np.ndarray, said: np.ndarray) -> np.ndarray:
    """Whose place each microphone is in : (N,) int64, its own unless another one is clearly nearer, all in turn."""
    distance = np.linalg.norm(placed[:, None] - said[None], axis=2)
    order = linear_sum_assignment(distance**2)[1]
    kept = np.arange(len(order))
    for cycle in _cycles(order):
        if all(distance[n, order[n]] < CLEARLY * distance[n, n] for n in cycle):
            kept[list(cycle)] = order[list(cycle)]
    return kept


def _cycles(order: np.ndarray) -> list[tuple[int, ...]]:
    """Cycles of a permutation that move something, each from its lowest number."""
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


def describe(result: PositionCheck, names, verdict: str = "good", known: bool = True) -> str:
    """The check in words: every swap, then the error of every microphone, the greatest first.

    Unless the `verdict` (`fdcal.assessment.verdict`, `fdcal.assessment.room_verdict`) trusts the positions, no swap
    found is no all-clear.
    `known`: whether known microphones held the positions.
    """
    lines = [f"channels {names[a]} and {names[b]} are swapped" for a, b in result.swapped]
    lines += [
        f"channels {', '.join(names[n] for n in chain)} stand in each other's places" for chain in result.permuted
    ]
    if not lines and verdict not in TRUSTED:
        advice = "; try --known none" if known else ""
        lines = [f"swaps cannot be told from positions that are not to be trusted ({verdict}){advice}"]
    lines = lines or ["no channels are swapped"]
    order = np.argsort(-result.errors, kind="stable")
    lines += [f"{names[n]:>12}  {1e3 * result.errors[n]:8.1f} mm" for n in order]
    return "\n".join(lines)
