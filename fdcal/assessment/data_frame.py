"""A calibration as a table of pandas, which is not among the dependencies."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..model.validation import InputError
from .calibration import CHANNEL_NUMBERS, Calibration


def data_frame(result: Calibration) -> Any:
    """Return the table of `Calibration.to_dataframe`.

    Raises
    ------
    InputError
        pandas is not installed.
    """
    try:
        import pandas
    except ImportError:
        raise InputError("to_dataframe needs the library pandas", "install it: pip install pandas") from None
    columns: dict[str, Any] = {
        axis: result.positions[:, i] for i, axis in enumerate("xyz"[: result.positions.shape[1]])
    }
    if result.known is not None:
        columns["known"] = [name in result.known for name in result.names]
    if result.uncertainty is not None:
        columns["uncertainty"] = result.uncertainty
    if result.errors is not None:
        columns["error"] = result.errors
    if result.channels is not None:
        faults = {fault.name: fault.kind for fault in result.channels.faults}
        columns |= {key: getattr(result.channels, key) for key in CHANNEL_NUMBERS}
        columns["fault"] = [faults.get(name, "") for name in result.names]
        columns |= _given_columns(result)
    return pandas.DataFrame(columns, index=pandas.Index(result.names, name="microphone"))


def _given_columns(result: Calibration) -> dict[str, Any]:
    """Return the given coordinates and their distances from the positions found; NaN where none is given."""
    given = {} if result.channels is None else {one.name: one for one in result.channels.given}
    if not given:
        return {}
    none = (np.nan,) * result.positions.shape[1]
    places = np.array([given[name].given if name in given else none for name in result.names])
    columns: dict[str, Any] = {f"given_{axis}": places[:, i] for i, axis in enumerate("xyz"[: places.shape[1]])}
    return columns | {"given_difference": np.linalg.norm(result.positions - places, axis=1)}
