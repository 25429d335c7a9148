"""A calibration in words: the summary that `fdcal calibrate` prints, and its comparison with other positions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..assessment.calibration import Calibration, Evidence, GivenPosition
from ..model.measurement import Measurement
from ..model.validation import InputError, length_text
from ..session.sources import CalibrationInput
from .options import OPTIONS

if TYPE_CHECKING:
    from ..assessment.position_check import ListFit, PositionCheck
    from ..session.sources import Progress

MIN_MOVE = 1e-3  # metres, of a given position that is mentioned
MAX_ROWS = 12  # of the table of given positions


def summary(inputs: CalibrationInput, result: Calibration) -> str:
    """Return a calibration in seven lines, and more of an uncertain sound speed, of its channels or of a known room."""
    count, f = inputs.measurement.count, result.frequencies
    free = count - len(inputs.given)
    takes = inputs.measurement.take_count
    lines = [
        f"{inputs.name}: {free} of {count} microphones sought by {result.solver}, seed {result.seed}",
        f"modes   {len(f)}{f' rows of {takes} takes' if takes > 1 else ''}, {f[0]:.1f} to {f[-1]:.1f} Hz",
        f"run     {result.sweeps} sweeps in {result.elapsed:.1f} s, {_end(result)}",
        f"error   {_error(result, inputs)}",
    ]
    if result.cost_db is not None:
        cost = f"{result.cost_db:.1f} dB of the power (Eq. 7, of all modes that the microphones carry)"
        lines.insert(3, f"cost    {cost}")
    if inputs.remark:
        lines.append(f"list    {inputs.remark}")
    if inputs.estimate_sound_speed:
        given = inputs.measurement.sound_speed
        lines.append(f"speed   {result.sound_speed:.1f} m/s estimated, {given:.1f} m/s given")
    if result.sound_speed_sigma is not None:
        lines.append(f"speed   {result.sound_speed:.2f} m/s, one sigma {result.sound_speed_sigma:.2g} m/s")
    if result.evidence is not None:
        lines.append(f"predict {_prediction(result, result.evidence)}")
    if inputs.scene is not None and inputs.scene.room.response is not None:
        lines.append("field   plane waves of a measured impulse response: modelled between the microphones")
    lines += _channel_lines(result)
    lines.append(f"verdict {result.verdict}: {result.verdict_text}")
    return "\n".join([*lines, *_room_lines(result)])


def _end(result: Calibration) -> str:
    """Return how the run ended, in the sense of the verdict."""
    if result.converged:
        return "converged"
    if result.verdict == "good":  # of which no step is left that is large beside one sigma
        return "ended; the step left is small beside one sigma"
    return "stopped before it converged"


def _error(result: Calibration, inputs: CalibrationInput) -> str:
    """Return the errors over the microphones sought whose channels are healthy, in words."""
    given, nominal = inputs.given, inputs.measurement.nominal
    truth = inputs.compared_with or ("the nominal positions" if nominal else "the truth")
    if result.mean_error is None or result.max_error is None:
        return f"unknown, since the true positions are{_sigma(result, result.counted(given))}"
    mean, largest, counted = result.mean_error, result.max_error, result.counted(given)
    healthy = " healthy" if len(result.healthy) < len(result.names) else ""
    sought = " sought" if len(given) and not np.isin(counted, given).any() else ""
    over = f"{'the' if healthy or sought else 'all'} {len(counted)}{healthy} microphones{sought}"
    text = f"mean {length_text(mean)}, largest {length_text(largest)} over {over}"
    if result.aligned:
        text += f", moved as a whole onto {truth}"
    elif nominal:
        text += f", against {truth}"
    text += ", in the nearest of the room's symmetries" if result.room is not None else ""
    return text + _sigma(result, counted)


def _sigma(result: Calibration, counted: np.ndarray) -> str:
    """Return one sigma of the microphones whose errors are averaged, in words."""
    if result.uncertainty is None:
        return ""
    sigma = float(np.sqrt(np.mean(result.uncertainty[counted] ** 2)))
    return f"; their one sigma {length_text(sigma, 2)}"


def _prediction(result: Calibration, evidence: Evidence) -> str:
    """Return how well each microphone is predicted from the others, and the worst of them."""
    microphones, modes = evidence.microphones_db, evidence.frequencies_db
    if evidence.leave_one_out_db is None or microphones is None or modes is None:
        return "no leave-one-out prediction in the file"
    healthy = result.healthy
    n, m = int(healthy[microphones[healthy].argmax()]), int(modes.argmax())
    return (
        f"leave-one-out error {evidence.leave_one_out_db:.1f} dB; worst microphone {result.names[n]},"
        f" {microphones[n]:.1f} dB, worst frequency {result.frequencies[m]:.1f} Hz, {modes[m]:.1f} dB"
    )


def _channel_lines(result: Calibration) -> list[str]:
    """Return the spread of the channels' gains, the faulty channels, and the given positions as corrected."""
    channels = result.channels
    if channels is None:
        return []
    gain, phase = (float(np.std(values[result.healthy])) for values in (channels.gain_db, channels.phase_deg))
    faults = "; ".join(fault.text for fault in channels.faults)
    spread = f"spread {gain:.2g} dB and {phase:.2g} degrees" if channels.gains_sought else "taken as matched"
    return [
        f"channels {spread}; {'faulty: ' + faults if faults else 'none is faulty'}",
        *_given_lines(channels.given, result.verdict == "good"),
    ]


def _given_lines(given: Sequence[GivenPosition], trusted: bool) -> list[str]:
    """Return a table of the given positions as corrected, where any is by more than MIN_MOVE."""
    rows = sorted((one for one in given if one.difference > MIN_MOVE), key=lambda one: -one.difference)
    if not rows:
        return []
    text = [["microphone", "given (m)", "found (m)", "difference", "one sigma", ""]]
    for one in rows[:MAX_ROWS]:
        places = (", ".join(f"{x:z.4f}" for x in place) for place in (one.given, one.found))
        lengths = (length_text(x, 2) for x in (one.difference, one.sigma))
        text.append([one.name, *places, *lengths, "wrong" if one.wrong else ""])
    widths = [max(map(len, column)) for column in zip(*text, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in text]
    more = f"; the {MAX_ROWS} that differ most" if len(rows) > MAX_ROWS else ""
    head = f"given   {len(rows)} of {len(given)} given positions corrected by more than {1e3 * MIN_MOVE:g} mm{more}"
    if trusted and not any(one.wrong for one in given):  # else nothing is known of them
        head += "; none of them contradicts the pressures"
    return [head, *(f"        {line}".rstrip() for line in lines)]


def _room_lines(result: Calibration) -> list[str]:
    room = result.room
    if room is None:
        return []
    size, source = " x ".join(f"{x:.4g}" for x in room.size), ", ".join(f"{x:z.2f}" for x in room.source)
    others = ", ".join(name for name, _ in room.symmetries[1:])
    return [
        f"room    {size} m; source at ({source}) m, walls of admittance {room.admittance.real:.2g}",
        f"mirror images that explain the pressures as well: {others}",
    ]


def require_positions(measurement: Measurement) -> None:
    """Raise InputError where a measurement has no positions to compare with."""
    if measurement.positions is None:
        problem = "the file has no positions to compare with those found"
        remedy = "name a file that has them with <positions>, or leave out <check>"
        raise InputError(problem, remedy, key="check", value=True)


def comparison(inputs: CalibrationInput, result: Calibration) -> PositionCheck:
    """Return how the positions found differ from those in the measurement.

    Raises InputError: the measurement has no positions.
    """
    from ..assessment.position_check import compare_positions, in_size_of

    measurement = inputs.measurement
    require_positions(measurement)
    positions = result.positions if result.room is None else result.positions_for(measurement)
    if _size_is_open(inputs, result):
        positions = in_size_of(positions, measurement.positions)
    return compare_positions(positions, measurement.positions, _frame(inputs))


UNITS_APART = 2.0  # factor of size from which a list is in another unit, whatever the array found is worth


def _size_is_open(inputs: CalibrationInput, result: Calibration) -> bool:
    """Whether the size of the array found is no finding, so that it is compared in that of the list."""
    from ..assessment.position_check import MAX_SCALE, size_ratio

    listed = inputs.measurement.positions
    assert listed is not None  # `require_positions`
    ratio = size_ratio(result.positions, listed)
    wrong = result.verdict != "good" and MAX_SCALE < max(ratio, 1 / ratio) < UNITS_APART
    return result.verdict == "scale_undetermined" or wrong


def comparison_text(inputs: CalibrationInput, result: Calibration, check: PositionCheck, fit: ListFit | None) -> str:
    """Return a comparison in words: what is exchanged, and how far each microphone is from its place in the list."""
    from ..assessment.position_check import describe

    names = inputs.labels or inputs.measurement.names
    text = describe(check, names, result.verdict, len(_frame(inputs)) > 0, OPTIONS, fit)
    if _size_is_open(inputs, result):
        text += (
            f"\nthe size of the array found is not to be trusted ({result.verdict}): it is compared in that of the list"
        )
    return text


def fit_of_rows(
    inputs: CalibrationInput, result: Calibration, check: PositionCheck, progress: Progress
) -> ListFit | None:
    """Return how the rows of a list fit; None where the list as a whole does not, or a room's shape held the array."""
    from ..session.doctor import list_fit

    return list_fit(inputs, result, check, progress) if result.room is None and check.fits else None


def _frame(inputs: CalibrationInput) -> Sequence[int]:
    """Return the numbers of the known microphones that fix the axes."""
    return inputs.measurement.known.tolist() if inputs.settings.known == "all" else []
