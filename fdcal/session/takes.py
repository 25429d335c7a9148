"""A recording day: takes one after the other, and the result of all takes so far.

The recordings are imported without their faulty channels and calibrated by solver robust, which finds inverted and dead
channels. The comparison with a list of positions shows exchanged channels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..assessment.assess import ARGUMENTS
from ..assessment.calibration import FAULTS
from ..assessment.position_check import PositionCheck, compare_positions, fit_result
from ..assessment.words import counted, error_words, faults_text, list_faults, result_sentences
from ..model.validation import length_text
from ..recordings.importer import measurement_of_takes, read_takes
from ..recordings.recording import ImportOptions
from .calibration_run import solve
from .sources import CalibrationInput, compared_with_file, measurement_input

if TYPE_CHECKING:
    from ..assessment.calibration import Calibration

NEXT = "move the loudspeaker to the other side of the array"


OPTIONS = ImportOptions(leave_out="bad", files="takes")


@dataclass(frozen=True, eq=False)
class TakesResult:
    """The result of several takes."""

    takes: int
    inputs: CalibrationInput
    result: Calibration
    check: PositionCheck | None  # against the list; None without one

    @property
    def list_faults(self) -> list[str]:
        """The faults of the list in words: exchanged channels, misplaced microphones, its size."""
        check, given, result = self.check, self.inputs.measurement.positions, self.result
        if check is None or given is None or not check.fits:
            return []
        return list_faults(check, fit_result(check, result, given), self.inputs.labels or result.names)

    @property
    def faults(self) -> list[str]:
        """The faults of channels and of the list, in words."""
        channels = self.result.channels
        return [faults_text([fault]) for fault in (channels.faults if channels else ())] + self.list_faults

    @property
    def sigma(self) -> float:
        """One sigma of a position: root mean square over the healthy microphones, metres; NaN if it is unknown."""
        if self.result.uncertainty is None:
            return float("nan")
        return float(np.sqrt(np.mean(self.result.uncertainty[self.result.healthy] ** 2)))

    @property
    def lines(self) -> list[str]:
        """The result in words, a line each."""
        result, said = self.result, result_sentences(self.result, self.inputs.measurement, self.inputs.given)
        sigma = length_text(self.sigma, 2)
        lines = [f"result  {counted(self.takes, 'take')}, {len(result.names)} microphones, one sigma {sigma}"]
        if result.mean_error is not None:
            lines.append(f"list    {error_words(result)} from {self.inputs.compared_with}")
            if self.check is not None and not self.check.fits:
                lines.append("list    it fits the array found in no order")
        lines += [f"verdict {said['verdict']}", f"faults  {'; '.join(self.faults) or 'none found'}"]
        channels = result.channels
        if self.list_faults or any(FAULTS[fault.kind].mend for fault in (channels.faults if channels else ())):
            return [*lines, "next    correct the channels, and record this take again"]
        after = self.sigma * float(np.sqrt(self.takes / (self.takes + 1)))  # with the information of an average take
        return [*lines, f"next    {NEXT}: another take brings one sigma to about {length_text(after, 2)}"]

    @property
    def table(self) -> list[str]:
        """The positions as in the result file, a line for each microphone."""
        result, positions = self.result, self.result.positions
        sigma = np.full(len(positions), np.nan) if result.uncertainty is None else result.uncertainty
        faults = {} if result.channels is None else {fault.name: fault.kind for fault in result.channels.faults}
        head = "".join(f"{axis + ' (m)':>10}" for axis in "xyz"[: positions.shape[1]])
        lines = [
            f"{name:>10}{''.join(f'{x:z10.4f}' for x in position)}{length_text(one, 2):>12}  {faults.get(name, '')}"
            for name, position, one in zip(result.names, positions, sigma, strict=True)
        ]
        return [f"microphone{head}   one sigma", *(line.rstrip() for line in lines)]


def takes_result(
    takes: Sequence[str | Path],
    positions: str | None = None,
    options: ImportOptions = OPTIONS,
    wording: Mapping[str, str] = ARGUMENTS,
) -> TakesResult:
    """Return the result of the files of several takes.

    `positions` is the file of a list with which the array is compared; `wording` names the arguments in the remedy of a
    verdict. InputError if the takes are too short, have too few microphones or are of different arrays.
    """
    measurement, report = measurement_of_takes(read_takes(takes, options), options)
    inputs = measurement_input(measurement, "takes" if len(takes) > 1 else "take")
    if positions is not None:
        inputs = compared_with_file(inputs, positions, tuple(report.left_out))
    result, listed, check = solve(inputs, wording=wording), inputs.measurement.positions, None
    if listed is not None:
        known = inputs.measurement.known.tolist() if inputs.settings.known == "all" else []
        check = compare_positions(result.positions, listed, known)
    return TakesResult(len(takes), inputs, result, check)
