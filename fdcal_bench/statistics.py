"""Figures from the rows of a study: success, error, error bars and verdicts, point by point.

found     the error is below 5 mm, or three times the Cramer-Rao bound where that is larger
trusted   the verdict is good
wrong     trusted, and the error is above 5 mm and above three claimed sigmas, or that of one microphone above 10 mm
          and above five sigmas
good      trusted, and not wrong
doubted   found, though not trusted
lost      neither found nor trusted
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas
from scipy.special import chdtri, ndtr

from fdcal.assessment.calibration import Calibration
from fdcal.model.gauge import align
from fdcal.model.measurement import Measurement
from fdcal.model.validation import InputError

LEVELS = (0.5, 0.8, 0.95, 0.99)  # probabilities of the ellipses that are counted
BINS = 20  # of the rank histogram
# Columns on the error bars, and the type of each; null without true positions or covariance
SCORES = {
    "judged": "int64",  # microphones that are sought, healthy and not named
    "inside": "string",  # JSON, how many of them are inside their ellipse of each of LEVELS
    "ranks": "string",  # JSON, how many of their coordinates are in each of the BINS of the rank histogram
    "error_m2": "float64",  # mean of their squared errors
    "claimed_m2": "float64",  # mean of their claimed variances
    "worst_sigmas": "float64",  # of those more than FAR off, the largest error over sigma; 0 without any
    "sound": "int64",  # channels without a fault
    "accused": "int64",  # of these, named as faulty
    "faults": "int64",  # channels with a fault
    "named": "int64",  # of these, named
    "right_given": "int64",  # given positions that are right, to the tape's error
    "wrongly_doubted": "int64",  # of these, named
    "wrong_given": "int64",  # given positions that are wrong
    "doubted_given": "int64",  # of these, named
}
FAR, FAR_SIGMAS = 0.01, 5.0  # metres and sigmas: a microphone further off than both makes "good" wrong

LEAST, FACTOR = 0.005, 3.0  # metres; times the bound, or times one sigma
COLUMNS = ("rms_error_m", "max_error_m", "claimed_sigma_m", "bound_m")


def classified(rows: pandas.DataFrame) -> pandas.DataFrame:
    """Return the rows with the columns of this module's head, bool; a refused draw was not found."""
    rows = rows.copy()
    rows[list(COLUMNS)] = rows[list(COLUMNS)].astype(float)
    error, bound = rows["rms_error_m"], rows["bound_m"].fillna(0.0)
    rows["found"] = (error < np.maximum(LEAST, FACTOR * bound)).to_numpy()
    rows["trusted"] = (rows["verdict"] == "good").to_numpy()
    claimed = rows["claimed_sigma_m"].fillna(np.inf)
    far = error > np.maximum(LEAST, FACTOR * claimed)
    far |= rows["worst_sigmas"].astype(float).fillna(0.0) > FAR_SIGMAS
    rows["wrong"] = (rows["trusted"] & far).to_numpy()
    rows["good"], rows["doubted"] = rows["trusted"] & ~rows["wrong"], ~rows["trusted"] & rows["found"]
    rows["lost"] = ~rows["trusted"] & ~rows["found"]
    return rows


def selected(rows: pandas.DataFrame, axes: dict[str, list], at: dict[str, str]) -> pandas.DataFrame:
    """Return the rows at which axes have the values `at`, as texts; InputError for an unknown axis or value."""
    values = {}
    for key, text in at.items():
        if key not in axes:
            raise InputError(f"the study has no axis {key}", f"use {', '.join(axes)}", key="at")
        texts = [str(value) for value in axes[key]]
        if text not in texts:
            raise InputError(f"{key} has no value {text}", f"use {', '.join(texts)}", key="at")
        values[key] = axes[key][texts.index(text)]
    return rows_of(rows, values)


def column_value(value: Any) -> Any:
    """Return a value of an axis as the table holds it: lists as JSON."""
    return value if isinstance(value, (int, float, str)) else json.dumps(value)


def rows_of(rows: pandas.DataFrame, values: Mapping[str, Any]) -> pandas.DataFrame:
    """Return the rows at which axes have `values`, which the study lists for these axes."""
    found: Any = rows
    for name, value in values.items():
        found = found[found[name] == column_value(value)]
    return found


def share_grid(rows: pandas.DataFrame, axes: dict[str, list], names: tuple[str, str], column: str) -> np.ndarray:
    """Return the fraction of classified rows in which `column` is true over two axes : (Y, X), NaN without a row."""
    y, x = ([{name: value} for value in axes[name]] if name else [{}] for name in names)
    cells = [[rows_of(rows, one | other)[column] for other in x] for one in y]
    return np.array([[cell.mean() if len(cell) else np.nan for cell in line] for line in cells])


def quantiles(rows: pandas.DataFrame, axes: dict[str, list], name: str, column: str, q=(0.1, 0.5, 0.9)) -> np.ndarray:
    """Return quantiles of a column at every value of an axis : (V, Q) float64, NaN without rows."""
    return np.array([rows_of(rows, {name: value})[column].dropna().quantile(list(q)) for value in axes[name]])


def scored(
    found: Calibration,
    measurement: Measurement,
    given: Sequence[int],
    faulty: frozenset[str],
    misplaced: frozenset[str],
) -> dict[str, Any]:
    """Return the columns SCORES of a calibration of known truth.

    `given`: microphones whose positions the solver got; `faulty`, `misplaced`: names of the channels with a fault, and
    of the microphones whose given position is wrong.
    """
    truth, C = measurement.positions, found.covariance
    if truth is None or C is None:
        return {}
    names, x = np.array(found.names), found.positions
    faults = () if found.channels is None else found.channels.faults
    own = {names[n] for n in given}
    doubted = {fault.name for fault in faults if fault.kind in ("misplaced", "swapped")} & own
    accused = {fault.name for fault in faults} - doubted
    healthy = ~np.isin(names, list(faulty))
    judged = healthy & ~np.isin(names, list(accused)) & ~np.isin(np.arange(len(names)), np.asarray(given, int))
    if found.aligned:  # the covariance is that of the array as it was found
        truth = align(truth, x, np.flatnonzero(healthy))
    e, C = (x - truth)[judged], C[judged]
    usable = np.linalg.det(C) > 0
    e, C = e[usable], C[usable]
    variance = np.diagonal(C, axis1=1, axis2=2)
    distance = np.einsum("na,nab,nb->n", e, np.linalg.inv(C), e)
    limits = chdtri(e.shape[1], 1 - np.array(LEVELS))
    ranks = np.histogram(ndtr(-e / np.sqrt(variance)), BINS, (0, 1))[0]
    length, sigma = np.linalg.norm(e, axis=1), np.sqrt(variance.sum(axis=1))
    sound, right = set(names[healthy]), own - misplaced
    return {
        "judged": len(e),
        "inside": json.dumps([int(np.sum(distance <= limit)) for limit in limits]),
        "ranks": json.dumps(ranks.tolist()),
        "error_m2": float(np.mean(length**2)) if len(e) else None,
        "claimed_m2": float(np.mean(sigma**2)) if len(e) else None,
        "worst_sigmas": float(np.max((length / sigma)[length > FAR], initial=0.0)),
        "sound": len(sound),
        "accused": len(accused & sound),
        "faults": len(faulty),
        "named": len(accused & faulty),
        "right_given": len(right),
        "wrongly_doubted": len(doubted & right),
        "wrong_given": len(misplaced),
        "doubted_given": len(doubted & misplaced),
    }


def clustered(counts: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return fractions (K,) of the items of all draws, and their standard errors.

    `counts` (G, K) are numbers of items in each draw, and `sizes` (G,) those of all its items. The draws are
    independent, the microphones of one draw are not: sum_g (c_g - p n_g)^2 is the variance of the sum.
    """
    total, G = sizes.sum(), len(sizes)
    share = counts.sum(axis=0) / max(total, 1)
    left = counts - share * sizes[:, None]
    return share, np.sqrt((left**2).sum(axis=0) * G / max(G - 1, 1)) / max(total, 1)


def json_columns(rows: pandas.DataFrame, name: str) -> np.ndarray:
    """Return a column of JSON lists of equal length : (R, K) float64."""
    return np.array([json.loads(text) for text in rows[name]], float)
