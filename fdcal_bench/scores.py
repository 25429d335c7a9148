"""How far the positions of a method are from the truth, and the table of several methods."""

import csv
import importlib
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from .cases import NAMES, Case

Method = Callable[..., tuple[np.ndarray, np.ndarray | None] | None]
REFERENCE = Path(__file__).parent / "reference.csv"
FAILED = 0.5  # error over the size of an array, from which a method counts as failed


@dataclass(frozen=True)
class Score:
    """One method on one case."""

    case: str
    draw: int
    method: str
    size_mm: float  # size of the array, RMS about its middle
    error_mm: float  # RMS after the best rigid motion, a mirror image allowed; NaN where the method gave nothing
    claim_mm: float  # RMS of the method's own sigma; NaN without one
    seconds: float  # processor time

    @property
    def failed(self) -> bool:
        """Whether the method gave nothing, or its error exceeds half the size of the array."""
        return not self.error_mm < FAILED * self.size_mm


def score(case: Case, method: Method, name: str) -> Score:
    """Run a method on a case."""
    start = time.process_time()
    found = method(
        [np.array(one) for one in case.recordings], case.rate, kind=case.kind, speed=case.speed, sources=case.sources
    )
    seconds = time.process_time() - start
    if found is None or found[0] is None:
        return scored(case, name, np.nan, seconds=seconds)
    x, sigma = np.asarray(found[0], float), found[1]
    if x.shape != case.truth.shape:
        raise ValueError(f"{name} returned positions of shape {x.shape}; {case.name} needs {case.truth.shape}")
    claim = np.nan if sigma is None else 1e3 * float(np.sqrt(np.mean(np.square(sigma))))
    return scored(case, name, error_mm(x, case.truth), claim, seconds)


def scored(case: Case, method: str, error: float, claim: float = np.nan, seconds: float = np.nan) -> Score:
    """Return the score of an error, millimetres."""
    size = 1e3 * float(np.sqrt(np.mean(np.sum((case.truth - case.truth.mean(axis=0)) ** 2, axis=1))))
    return Score(case.name, case.draw, method, size, error, claim, seconds)


def error_mm(found: np.ndarray, truth: np.ndarray) -> float:
    """Return the RMS error after the best rigid motion (Kabsch), a mirror image allowed, millimetres."""
    if not np.isfinite(found).all():
        return np.nan
    a, b = found - found.mean(axis=0), truth - truth.mean(axis=0)
    left, _, right = np.linalg.svd(a.T @ b)
    return 1e3 * float(np.sqrt(np.mean(np.sum((a @ left @ right - b) ** 2, axis=1))))


def method_of(text: str) -> Method:
    """Return the function that "module:function" names; modules of the current folder are found."""
    module, _, function = text.partition(":")
    sys.path.insert(0, "")
    try:
        return getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, TypeError, ValueError) as error:  # the last two: of a malformed name
        raise SystemExit(f"{text} names no function: {error}; write module:function") from None


def read_reference() -> list[Score]:
    """Return the reference results."""
    with REFERENCE.open(newline="") as file:
        kinds: dict[str, Any] = {one.name: one.type for one in fields(Score)}
        return [Score(**{name: kind(row[name]) for name, kind in kinds.items()}) for row in csv.DictReader(file)]


def write_reference(scores: Iterable[Score]) -> None:
    """Write the reference results."""
    with REFERENCE.open("w", newline="") as file:
        writer = csv.DictWriter(file, [one.name for one in fields(Score)], lineterminator="\n")
        writer.writeheader()
        for one in scores:
            writer.writerow({key: f"{value:.3g}" if isinstance(value, float) else value
                             for key, value in asdict(one).items()})  # fmt: skip


def table(scores: Iterable[Score]) -> str:
    """Return a table in Markdown: a line for each case with its draws, a column for each method.

    The last line has the seconds of one draw of each case.
    """
    every = list(scores)
    methods = list(dict.fromkeys(one.method for one in every))
    lines = ["| case | draws | " + " | ".join(methods) + " |", "|---" * (len(methods) + 2) + "|"]
    seconds = np.zeros(len(methods))
    for case in (name for name in NAMES if any(one.case == name for one in every)):
        row = [[one for one in every if (one.case, one.method) == (case, method)] for method in methods]
        seconds += np.array([np.mean([one.seconds for one in cell]) if cell else 0.0 for cell in row])
        lines.append(f"| {case} | {max(map(len, row))} | {' | '.join(map(_cell, row))} |")
    lines.append("| all: seconds | | " + " | ".join(f"{s:.0f}" if np.isfinite(s) else "" for s in seconds) + " |")
    return "\n".join(lines)


def _cell(scores: list[Score]) -> str:
    """Return the median error and claim, and how many failed; "" if the method never gave positions."""
    errors, claims = (np.array([getattr(one, key) for one in scores]) for key in ("error_mm", "claim_mm"))
    if not np.isfinite(errors).any():
        return ""
    failed = sum(one.failed for one in scores)
    text = f"{np.median(np.nan_to_num(errors, nan=np.inf)):.1f}"
    text += f" (claims {np.nanmedian(claims):.1f})" if np.isfinite(claims).any() else ""
    return text + (f", {failed} failed" if failed else "")
