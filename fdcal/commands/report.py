"""A calibration in words: the summary that `fdcal calibrate` prints, and its comparison with other positions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..assessment.calibration import Calibration
from ..assessment.words import comparison_sentences, given_table, result_sentences
from ..session.sources import CalibrationInput
from .options import OPTIONS

if TYPE_CHECKING:
    from ..assessment.position_check import ListFit, PositionCheck
    from ..session.sources import ProgressReport

# Heads of the lines of a summary, in their order.
HEADS = ("modes", "run", "cost", "error", "list", "speed", "predict", "field", "channels", "given", "verdict", "room",
         "images")  # fmt: skip


def summary(inputs: CalibrationInput, result: Calibration) -> str:
    """Return a summary of a calibration: seven lines, and more for the sound speed, the channels or a known room."""
    measurement, free = inputs.measurement, inputs.measurement.count - len(inputs.given)
    said = result_sentences(result, measurement, inputs.given, inputs.compared_with)
    said["list"] = inputs.remark
    speeds = []
    if inputs.estimate_sound_speed:
        speeds.append(f"{result.sound_speed:.1f} m/s estimated, {measurement.sound_speed:.1f} m/s given")
    if result.sound_speed_sigma is not None:
        speeds.append(f"{result.sound_speed:.2f} m/s, one sigma {result.sound_speed_sigma:.2g} m/s")
    said["speed"] = "\nspeed   ".join(speeds)
    if inputs.scene is not None and inputs.scene.room.response is not None:
        said["field"] = "plane waves of a measured impulse response: modelled between the microphones"
    if (given := given_table(result)) is not None:
        (head, table), widths = given, [max(map(len, column)) for column in zip(*given[1], strict=True)]
        rows = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in table)
        said["given"] = "\n        ".join([head, *(row.rstrip() for row in rows)])
    head = f"{inputs.name}: {free} of {measurement.count} microphones sought by {result.solver}, seed {result.seed}"
    return "\n".join([head, *(f"{name:<7} {said[name]}" for name in HEADS if said.get(name))])


def comparison(inputs: CalibrationInput, result: Calibration) -> PositionCheck:
    """Return how the positions found differ from those that the measurement has."""
    from ..assessment.position_check import compare_positions, size_ratio

    listed = np.asarray(inputs.measurement.positions)
    positions = result.positions if result.room is None else result.positions_for(inputs.measurement)
    if _size_is_open(inputs, result):  # scaled about their centre to the size of the list
        centre = positions.mean(axis=0)
        positions = centre + size_ratio(positions, listed) * (positions - centre)
    return compare_positions(positions, listed, _frame(inputs))


UNITS_APART = 2.0  # ratio of sizes from which a list counts as one in another unit, with any verdict


def _size_is_open(inputs: CalibrationInput, result: Calibration) -> bool:
    """Return whether the size of the array is undetermined, so that it is compared in the size of the list."""
    from ..assessment.position_check import MAX_SCALE, size_ratio

    ratio = size_ratio(result.positions, np.asarray(inputs.measurement.positions))
    wrong = result.verdict != "good" and MAX_SCALE < max(ratio, 1 / ratio) < UNITS_APART
    return result.verdict == "scale_undetermined" or wrong


def comparison_text(inputs: CalibrationInput, result: Calibration, check: PositionCheck, fit: ListFit | None) -> str:
    """Return a comparison in words: exchanged channels, and the distance of each microphone from its position."""
    names = inputs.labels or inputs.measurement.names
    lines = comparison_sentences(check, names, result.verdict, len(_frame(inputs)) > 0, OPTIONS, fit)
    if _size_is_open(inputs, result):
        lines.append(
            f"the size of the array found is not to be trusted ({result.verdict}): it is compared in that of the list"
        )
    return "\n".join(lines)


def fit_of_rows(
    inputs: CalibrationInput, result: Calibration, check: PositionCheck, progress: ProgressReport
) -> ListFit | None:
    """Return how the rows of a list fit; None if the list as a whole does not fit, or in a known room."""
    from ..session.doctor import list_fit

    return list_fit(inputs, result, check, progress) if result.room is None and check.fits else None


def _frame(inputs: CalibrationInput) -> Sequence[int]:
    """Return the numbers of the known microphones that fix the axes."""
    return inputs.measurement.known.tolist() if inputs.settings.known == "all" else []
