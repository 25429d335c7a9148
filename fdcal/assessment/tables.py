"""Microphones and channels as tables: CSV of positions, CSV of gains, and a calibration as a table of pandas."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from typing import Any

import numpy as np

from ..model.measurement import Measurement
from ..model.validation import InputError
from .calibration import CHANNEL_NUMBERS, Calibration


def position_table(measurement: Measurement, positions, sigma=None, by: slice | np.ndarray = slice(None)) -> str:
    """Return positions (N, D) as CSV; lengths in metres, unknown values empty, numbers to full precision.

    Columns: name, known (yes or no), x_m, y_m[, z_m], true_x_m, true_y_m[, true_z_m], error_m, uncertainty_m, which is
    `sigma` (N,). Without any known microphone the error is that after the best rigid motion or mirror image of the
    whole array, which the microphones `by` determine, in a column called error_once_aligned_m. Nominal positions have
    columns nominal_x_m and so on.
    """
    truth, errors, axes = measurement.positions, measurement.errors(positions, by), "xyz"[: measurement.array_dimension]
    unknown = np.full((measurement.count, len(axes) + 1), None)
    true = unknown if truth is None or errors is None else np.column_stack([truth, errors])
    numbers = np.column_stack([np.asarray(positions, float), true, unknown[:, 0] if sigma is None else sigma])
    known = ["yes" if n in measurement.known else "no" for n in range(measurement.count)]
    aligned = "_once_aligned" if measurement.blind and truth is not None else ""
    compared = [f"{measurement.reference}_{axis}_m" for axis in axes]
    head = [*(f"{axis}_m" for axis in axes), *compared, f"error{aligned}_m", "uncertainty_m"]
    return _csv(["name", "known", *head], zip(measurement.names, known, *numbers.T.tolist(), strict=True))


def channel_table(result: Calibration) -> str:
    """Return gain, phase and noise of every channel as CSV, numbers to full precision.

    To correct a recording, divide the pressures of a channel by 10^(gain_db / 20) exp(j phase_deg pi / 180). The fault
    is empty, or one of those of `fdcal.assessment.channels`.
    """
    if result.channels is None or not result.channels.gains_sought:
        problem = f"the result of solver {result.solver} holds no gains of the channels"
        raise InputError(problem, "calibrate with <solver> robust", key="table", value="gains")
    columns = _channel_columns(result)
    return _csv(["name", *columns], zip(result.names, *columns.values(), strict=True))


def data_frame(self: Calibration) -> Any:
    """Return a pandas table with one row a microphone, if pandas is installed.

    Columns: x, y (z), metres; known; uncertainty, one sigma in metres; error, metres, where it is known; where the
    solver finds them gain_db, gain_sigma_db, phase_deg, phase_sigma_deg, noise_db and fault, "" where sound,
    and of given positions given_x, given_y (given_z) and given_difference, metres, NaN where none is given. The
    index are the names.

    Returns
    -------
    pandas.DataFrame

    Raises
    ------
    InputError
        pandas is not installed.

    Examples
    --------
    >>> import fdcal
    >>> found = fdcal.calibrate(fdcal.load("tiny"), modes=12)
    >>> found.to_dataframe().columns.tolist()[:6]
    ['x', 'y', 'known', 'uncertainty', 'error', 'gain_db']
    """
    result = self
    try:
        import pandas
    except ImportError:
        raise InputError("to_dataframe needs the library pandas", "install it: pip install pandas") from None
    axes = "xyz"[: result.positions.shape[1]]
    columns: dict[str, Any] = dict(zip(axes, result.positions.T, strict=True))
    if result.known is not None:
        columns["known"] = [name in result.known for name in result.names]
    if result.uncertainty is not None:
        columns["uncertainty"] = result.uncertainty
    if result.errors is not None:
        columns["error"] = result.errors
    columns |= _channel_columns(result)
    if result.channels is not None and result.channels.given:
        given = {one.name: one.given for one in result.channels.given}
        places = np.array([given.get(name, (np.nan,) * len(axes)) for name in result.names])
        columns |= {f"given_{axis}": column for axis, column in zip(axes, places.T, strict=True)}
        columns["given_difference"] = np.linalg.norm(result.positions - places, axis=1)
    return pandas.DataFrame(columns, index=pandas.Index(result.names, name="microphone"))


def _channel_columns(result: Calibration) -> dict[str, list]:
    """Return gain, phase, noise and fault of every channel, "" where it is sound; nothing without channels."""
    if result.channels is None:
        return {}
    faults = {fault.name: fault.kind for fault in result.channels.faults}
    columns = {name: getattr(result.channels, name).tolist() for name in CHANNEL_NUMBERS}
    return columns | {"fault": [faults.get(name, "") for name in result.names]}


def _csv(head: list[str], rows: Iterable[Iterable[object]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    return text.getvalue()
