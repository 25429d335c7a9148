"""What the rows of a study say: success, error, error bars and verdicts, point by point.

found     the error is below 5 mm, or three times the Cramer-Rao bound where that is larger
trusted   the verdict is good
wrong     trusted, and the error is above 5 mm and three times what was claimed
good      trusted, and not wrong
doubted   found, though not trusted
lost      neither found nor trusted
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..model.validation import InputError

if TYPE_CHECKING:
    import pandas

LEAST, FACTOR = 0.005, 3.0  # metres; times the bound, or times one sigma
COLUMNS = ("rms_error_m", "max_error_m", "claimed_sigma_m", "bound_m")


def judged(rows: pandas.DataFrame) -> pandas.DataFrame:
    """Return the rows with the columns of this module's head, bool; a refused draw was not found."""
    rows = rows.copy()
    for name in COLUMNS:
        rows[name] = rows[name].astype(float) if name in rows else np.nan
    error, bound = rows["rms_error_m"], rows["bound_m"].fillna(0.0)
    rows["found"] = (error < np.maximum(LEAST, FACTOR * bound)).to_numpy()
    rows["trusted"] = (rows["verdict"] == "good").to_numpy()
    claimed = rows["claimed_sigma_m"].fillna(np.inf)
    rows["wrong"] = (rows["trusted"] & (error > np.maximum(LEAST, FACTOR * claimed))).to_numpy()
    rows["good"], rows["doubted"] = rows["trusted"] & ~rows["wrong"], ~rows["trusted"] & rows["found"]
    rows["lost"] = ~rows["trusted"] & ~rows["found"]
    return rows


def selected(rows: pandas.DataFrame, axes: dict[str, list], at: dict[str, str]) -> pandas.DataFrame:
    """Return the rows at which other axes have the values `at`, given as text; InputError for what the study lacks."""
    values = {}
    for key, text in at.items():
        if key not in axes:
            raise InputError(f"the study has no axis {key}", f"use {', '.join(axes)}", key="at", value=key)
        texts = [str(value) for value in axes[key]]
        if text not in texts:
            raise InputError(f"{key} has no value {text}", f"use {', '.join(texts)}", key="at", value=text)
        values[key] = axes[key][texts.index(text)]
    return rows_of(rows, values)


def column_value(value: Any) -> Any:
    """Return a value of an axis as the table holds it: lists as JSON."""
    return value if isinstance(value, (int, float, str)) else json.dumps(value)


def rows_of(rows: pandas.DataFrame, values: Mapping[str, Any]) -> pandas.DataFrame:
    """Return the rows at which axes have `values`, as of the axes of the study."""
    found: Any = rows
    for name, value in values.items():
        found = found[found[name] == column_value(value)]
    return found


def share_grid(rows: pandas.DataFrame, axes: dict[str, list], names: tuple[str, str], column: str) -> np.ndarray:
    """Return the fraction of rows of `judged` in which `column` is true over two axes : (Y, X), NaN without a row."""
    y, x = ([{name: value} for value in axes[name]] if name else [{}] for name in names)
    cells = [[rows_of(rows, one | other)[column] for other in x] for one in y]
    return np.array([[cell.mean() if len(cell) else np.nan for cell in line] for line in cells])


def quantiles(rows: pandas.DataFrame, axes: dict[str, list], name: str, column: str, q=(0.1, 0.5, 0.9)) -> np.ndarray:
    """Return quantiles of a column at every value of an axis : (V, Q) float64, NaN without rows."""
    return np.array([rows_of(rows, {name: value})[column].dropna().quantile(list(q)) for value in axes[name]])
