"""A comparison of positions in words: `describe` turns a `PositionCheck` into the lines of `calibrate --check`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..model.lengths import length_text
from ..model.validation import word_arguments
from .position_check import PositionCheck

TRUSTED = "good"  # the verdict with which finding no swap means that there is none
MOST_LISTED = 0.5  # share of the microphones in others' places beyond which only the rows say who stands where
UNITS = (("centimetres", 100.0), ("millimetres", 1000.0), ("feet", 3.281), ("inches", 39.37))
UNIT_TOLERANCE = 0.1  # relative, of a factor that suggests a unit


def describe(
    check: PositionCheck,
    names: Sequence[object],
    verdict: str = "good",
    known: bool = True,
    arguments: Mapping[str, str] | None = None,
) -> str:
    """Return a comparison in words: what is exchanged, then the error of every microphone, the largest first.

    Parameters
    ----------
    names : (N,) names of the microphones
    verdict : code of `fdcal.assessment.verdict` or `fdcal.assessment.room_verdict`; unless it is "good", finding no
        swap means that there is none only where every microphone is near its place
    known : whether known microphones fixed the positions
    arguments : how the reader calls the arguments, as of `fdcal.model.validation.word_arguments`
    """
    advice = word_arguments("; try <known> none", arguments or {}) if known else ""
    if not check.fits:
        lines = [_misfit(check, verdict, advice)]
    else:
        lines = _exchanges(check, names) or [_unchanged(check, verdict, advice)]
        lines += _remarks(check)
    lines += _size(check)
    return "\n".join(lines + _rows(check, names))


def _misfit(check: PositionCheck, verdict: str, advice: str) -> str:
    head = "the list fits the array found in no order: "
    if verdict != TRUSTED:
        return head + f"the positions found are not to be trusted ({verdict}){advice}, or it is of another array"
    return head + "it is of another array, or most of its positions are far off"


def _exchanges(check: PositionCheck, names: Sequence[object]) -> list[str]:
    """Return the swaps and longer cycles in words; none where every microphone is at its place."""
    moved = np.count_nonzero(check.order != np.arange(len(check.order)))
    if moved > MOST_LISTED * len(names):
        return [f"{moved} of {len(names)} channels stand in others' places{_pattern(check.order)}"]
    lines = [f"channels {names[a]} and {names[b]} are swapped" for a, b in check.swapped]
    for cycle in check.permuted:
        lines.append(f"channels {', '.join(str(names[n]) for n in cycle)} stand in each other's places")
    return lines


def _pattern(order: np.ndarray) -> str:
    """Return what kind of order this is, where it has a name."""
    count, own = len(order), np.arange(len(order))
    if np.array_equal(order, own[::-1]):
        return ": the list is in reverse"
    shift = int(order[0])
    if np.array_equal(order, (own + shift) % count):
        half = " (its halves are exchanged)" if 2 * shift == count else ""
        shift = shift if 2 * shift <= count else shift - count
        return f": the list is shifted by {shift} row{'s' if abs(shift) > 1 else ''}{half}"
    return ""


def _unchanged(check: PositionCheck, verdict: str, advice: str) -> str:
    if verdict == TRUSTED:
        return "no channels are swapped"
    if np.all(check.errors < check.spacing / 2):
        largest, least = (length_text(float(x), 2) for x in (check.errors.max(), check.spacing.min()))
        return (
            f"no swap seen: the largest distance, {largest}, is far below the spacing of the microphones, {least},"
            f" though the verdict is {verdict}"
        )
    return f"swaps cannot be detected from positions that are not to be trusted ({verdict}){advice}"


def _remarks(check: PositionCheck) -> list[str]:
    lines = []
    if check.symmetric:
        lines.append(
            "the list fits as well turned or mirrored, since the array is symmetric: such an exchange of most channels"
            " cannot be seen without known microphones"
        )
    if check.moved:
        lines.append("the list has other axes than the known microphones: the positions are moved onto it as a whole")
    return lines


def _size(check: PositionCheck) -> list[str]:
    """Return the size of the list where it is not that of the array found, and the unit that would explain it."""
    if check.scale == 1:
        return []
    units = [name for name, factor in UNITS if abs(check.scale / factor - 1) < UNIT_TOLERANCE]
    hint = f": is it in {units[0]}? Give metres" if units else ""
    after = "; the distances are those of the list in the size of the array" if check.fits else ""
    return [f"the list is about {check.scale:.3g} times as large as the array found{hint}{after}"]


def _rows(check: PositionCheck, names: Sequence[object]) -> list[str]:
    rows = []
    for n in np.argsort(-check.errors, kind="stable").tolist():
        row = f"{names[n]!s:>12}  {1e3 * check.errors[n]:8.1f} mm"
        if check.order[n] != n:
            row += f"  at the place of {names[int(check.order[n])]}, within {1e3 * check.distances[n]:.1f} mm"
        rows.append(row)
    return rows
