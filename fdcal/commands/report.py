"""A calibration in words: what `calibrate` and `record` print, and the comparison with other positions.

`record` leaves out the faulty channels of the takes so far, and calibrates with the solver robust, which finds inverted
and dead channels. The comparison with a list of positions shows swapped channels.
"""

import numpy as np

from ..assessment import words
from ..assessment.calibration import FAULTS, Calibration
from ..assessment.position_check import MAX_SCALE, ListFit, PositionCheck, compare_positions, fit_result, size_ratio
from ..model.measurement import Measurement
from ..model.validation import length_text, word_arguments
from ..session.sources import CalibrationInput
from .options import OPTIONS

# Heads of the lines of a summary, in their order.
HEADS = "array radius band run cost error list speed predict field channels given frame verdict".split()


def summary(inputs: CalibrationInput, result: Calibration) -> str:
    """Return a summary of a calibration: for each of HEADS that applies a line, or a line and a table."""
    measurement, free = inputs.measurement, inputs.measurement.count - len(inputs.given)
    said = words.result_sentences(result, measurement, inputs.given, inputs.compared_with)
    said |= {"list": inputs.remark, "array": words.plane_words(measurement)}
    said["radius"] = word_arguments(inputs.radius, OPTIONS)
    said["frame"] = "" if inputs.given else "without given positions the array may be rotated, moved or mirrored"
    if said["array"] and inputs.scene is None:
        said["array"] += word_arguments("; an import with <array_dimension> 3 estimates heights, too", OPTIONS)
    sigma = result.sound_speed_sigma
    if inputs.distance is not None or sigma is not None:
        certain = "" if sigma is None else f", one sigma {sigma:.2g} m/s"
        said["speed"] = f"{result.sound_speed:.2f} m/s estimated{certain}; {measurement.sound_speed:.1f} m/s given"
    if inputs.scene is not None and inputs.scene.room.response is not None:
        said["field"] = "modelled between the microphones by plane waves, from an impulse response at one point"
    if (given := words.given_table(result)) is not None:
        (head, table), widths = given, [max(map(len, column)) for column in zip(*given[1], strict=True)]
        rows = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in table)
        said["given"] = "\n        ".join([head, *(row.rstrip() for row in rows)])
    how = f"solver {result.solver}, random seed {result.seed}"
    head = f"{inputs.name}: {free} of {measurement.count} microphones sought; {how}"
    return "\n".join([head, *(f"{name:<7} {said[name]}" for name in HEADS if said.get(name))])


def comparison(inputs: CalibrationInput, result: Calibration) -> PositionCheck:
    """Return how the positions found differ from those that the measurement has."""
    listed, positions = np.asarray(inputs.measurement.positions), result.positions
    if _size_is_open(inputs, result):  # scaled about their centre to the size of the list
        centre = positions.mean(axis=0)
        positions = centre + size_ratio(positions, listed) * (positions - centre)
    return compare_positions(positions, listed, inputs.given)


UNITS_APART = 2.0  # a list whose size differs by at least this factor counts as one in another unit
TWO_MOTIONS = 'the distances below differ from those in the line "error": there the array is aligned with all rows'
TWO_MOTIONS += " of the list, here wrong rows are left out of the alignment"
# The two alignments give two largest errors. If their relative difference exceeds this, a sentence explains it; a
# smaller one hardly shows in the millimetres that are printed.
MAX_APART = 0.05


def _size_is_open(inputs: CalibrationInput, result: Calibration) -> bool:
    """Return whether the size of the array is undetermined; the array is then scaled to the size of the list."""
    ratio = size_ratio(result.positions, np.asarray(inputs.measurement.positions))
    wrong = result.verdict != "good" and MAX_SCALE < max(ratio, 1 / ratio) < UNITS_APART
    return result.verdict == "scale_undetermined" or wrong


def comparison_text(inputs: CalibrationInput, result: Calibration, check: PositionCheck, fit: ListFit | None) -> str:
    """Return a comparison in words: swapped channels, and the distance of each microphone from its position."""
    measurement = inputs.measurement
    names = inputs.labels or measurement.names
    lines = words.comparison_sentences(check, names, result.verdict, len(inputs.given) > 0, OPTIONS, fit)
    error, scaled = (result.aligned and result.max_error) or 0.0, _size_is_open(inputs, result)
    apart = abs(check.errors[result.counted(inputs.given)].max() - error)
    if check.fits and check.scale == 1 and not scaled and apart > MAX_APART * error > 0:
        lines.insert(-len(names), TWO_MOTIONS)
    if scaled:
        size = f"the size of the array found cannot be trusted ({result.verdict})"
        lines.append(f"{size}: the array is scaled to the size of the list for this comparison")
    listed = inputs.compared_with or f"the {'nominal' if measurement.nominal else 'true'} positions"
    return "\n".join([f"comparison of the positions found with {listed}:", *lines])


def error_title(measurement: Measurement, result: Calibration) -> str:
    """Return the errors of a result in words, over the same microphones as `fdcal calibrate`."""
    given = [n for n, name in enumerate(measurement.names) if name in (result.known or ())]
    compared = result.compared_with(measurement, given)
    errors = None if compared.errors is None else compared.errors[result.counted(given)]
    return words.error_line(errors, result.aligned, measurement.nominal)


NEXT = "move the loudspeaker to the other side of the array"


def takes_report(
    takes: int, inputs: CalibrationInput, result: Calibration, check: PositionCheck | None
) -> tuple[list[str], bool]:
    """Return the lines of the report on `takes` takes, and whether the list of positions is wrong."""
    listed, said = inputs.measurement.positions, words.result_sentences(result, inputs.measurement, inputs.given)
    sigmas = np.full(len(result.names), np.nan) if result.uncertainty is None else result.uncertainty
    sigma = float(np.sqrt(np.mean(sigmas[result.healthy] ** 2)))
    wrong = list[str]()
    faults = () if result.channels is None else result.channels.faults
    if check is not None and listed is not None and check.fits:
        wrong = words.list_faults(check, fit_result(check, result, listed), inputs.labels or result.names)
    lines = [
        f"result  {words.counted(takes, 'take')}, {len(result.names)} microphones, one sigma {length_text(sigma, 2)}"
    ]
    if result.mean_error is not None:
        lines.append(f"list    {words.error_words(result)} from {inputs.compared_with}")
        if check is not None and not check.fits:
            lines.append("list    the positions listed do not fit the array found in any order")
    named = "; ".join([*(words.faults_text([fault]) for fault in faults), *wrong])
    lines += [f"verdict {said['verdict']}", f"faults  {named or 'none found'}"]
    if wrong or any(FAULTS[fault.kind].mend for fault in faults):
        lines.append("next    correct the channels, and record this take again")
    else:
        after = sigma * float(np.sqrt(takes / (takes + 1)))  # if the next take has the information of an average take
        lines.append(f"next    {NEXT}: another take reduces one sigma to about {length_text(after, 2)}")
    kinds = {fault.name: fault.kind for fault in faults}
    axes = "xyz"[: result.positions.shape[1]]
    lines.append(f"microphone{''.join(f'{axis} (m)'.rjust(10) for axis in axes)}   one sigma")
    for name, position, one in zip(result.names, result.positions, sigmas, strict=True):
        cells = "".join(f"{x:z10.4f}" for x in position)
        lines.append(f"{name:>10}{cells}{length_text(one, 2):>12}  {kinds.get(name, '')}".rstrip())
    return lines, bool(wrong) or (check is not None and not check.agrees)
