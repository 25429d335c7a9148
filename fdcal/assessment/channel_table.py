"""The channels of a calibration as a table: gain, phase and noise of each, and what is wrong with it."""

from __future__ import annotations

import csv
import io

from ..model.validation import InputError
from .calibration import Calibration

COLUMNS = ("name", "gain_db", "gain_sigma_db", "phase_deg", "phase_sigma_deg", "noise_db", "fault")


def channel_table(result: Calibration) -> str:
    """Return CSV with one line per microphone and the columns COLUMNS, numbers to full precision.

    To correct a recording, divide the pressures of a channel by 10^(gain_db / 20) exp(j phase_deg pi / 180). The fault
    is empty, or one of those of `fdcal.assessment.odd_channels`.

    Raises
    ------
    InputError
        The result holds no gains.
    """
    channels = result.channels
    if channels is None:
        problem = f"the result of solver {result.solver} holds no gains of the channels"
        raise InputError(problem, "calibrate with <solver> robust", key="table", value="gains")
    faults = {fault.name: fault.kind for fault in channels.faults}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    columns = (
        channels.gain_db, channels.gain_sigma_db, channels.phase_deg, channels.phase_sigma_deg, channels.noise_db
    )  # fmt: skip
    for name, *numbers in zip(result.names, *(column.tolist() for column in columns), strict=True):
        writer.writerow([name, *numbers, faults.get(name, "")])
    return text.getvalue()
