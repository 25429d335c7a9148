"""A calibration as a table of pandas, which is not among the dependencies."""

from __future__ import annotations

from typing import Any

from ..model.validation import InputError
from .calibration import Calibration
from .result_parts import CHANNEL_KEYS


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
        columns |= {key: getattr(result.channels, key) for key in CHANNEL_KEYS.values()}
        columns["fault"] = [faults.get(name, "") for name in result.names]
    return pandas.DataFrame(columns, index=pandas.Index(result.names, name="microphone"))
