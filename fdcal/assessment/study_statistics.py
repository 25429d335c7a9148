"""What the rows of a study say: success, error, error bars and verdicts, point by point.

found     the error is below 5 mm, or three times the Cramer-Rao bound where that is larger
trusted   the verdict is good
wrong     trusted, and the error is above 5 mm and three times what was claimed
good      trusted, and not wrong
doubted   found, though not trusted
lost      neither found nor trusted
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..model.validation import InputError

if TYPE_CHECKING:
    import pandas

LEAST, FACTOR = 0.005, 3.0  # metres; times the bound, or times one sigma
COLUMNS = ("rms_error_m", "max_error_m", "claimed_sigma_m", "bound_m")


@dataclass(frozen=True)
class Grid:
    """A statistic over two axes of a study.

    Attributes
    ----------
    axes : (str, str), names of the axes along y and x; the second may be ""
    values : (list, list), along y and x
    share : (Y, X) float64, NaN where there is no row
    count : (Y, X) int64, rows
    """

    axes: tuple[str, str]
    values: tuple[list, list]
    share: np.ndarray
    count: np.ndarray


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
    """Return the rows at which other axes have the values `at`, given as text.

    Raises
    ------
    InputError
        For an axis or a value that the study lacks.
    """
    found: Any = rows
    for key, text in at.items():
        if key not in axes:
            raise InputError(f"the study has no axis {key}", f"use {', '.join(axes)}", key="at", value=key)
        texts = [str(value) for value in axes[key]]
        if text not in texts:
            raise InputError(f"{key} has no value {text}", f"use {', '.join(texts)}", key="at", value=text)
        found = found[found[key] == column_value(axes[key][texts.index(text)])]
    return found


def column_value(value: Any) -> Any:
    """Return a value of an axis as the table holds it: lists as JSON."""
    import json

    return value if isinstance(value, (int, float, str)) else json.dumps(value)


def share_grid(rows: pandas.DataFrame, axes: dict[str, list], names: tuple[str, str], column: str) -> Grid:
    """Return the share of rows in which `column` is true, over two axes.

    Parameters
    ----------
    rows : as of `judged`
    axes : of the study
    names : axes along y and x; "" for no second axis
    column : a column of this module's head
    """
    y, x = (axes.get(name, [""]) for name in names)
    share, count = np.full((len(y), len(x)), np.nan), np.zeros((len(y), len(x)), int)
    for i, one in enumerate(y):
        for j, other in enumerate(x):
            part = rows
            for name, value in ((names[0], one), (names[1], other)):
                if name:
                    part = part[part[name] == column_value(value)]
            count[i, j] = len(part)
            if len(part):
                share[i, j] = part[column].mean()
    return Grid(names, (y, x), share, count)


def quantiles(rows: pandas.DataFrame, axes: dict[str, list], name: str, column: str, q=(0.1, 0.5, 0.9)) -> np.ndarray:
    """Return quantiles of a column at every value of an axis : (V, Q) float64, NaN without rows."""
    found = []
    for value in axes[name]:
        part: Any = rows[rows[name] == column_value(value)]
        part = part[column].dropna()
        found.append(part.quantile(list(q)).to_numpy() if len(part) else np.full(len(q), np.nan))
    return np.array(found)
