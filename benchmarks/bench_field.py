"""Calibrate the cases of `benchmarks.field`, which were not chosen for the solver, by the command line.

FDCAL_BENCH_DRAWS is the number of cases of each family, 8 unless given; FDCAL_BENCH_FAMILIES names the families, all
unless given, separated by commas; FDCAL_BENCH_SOLVER the solver, the default of fdcal unless given. FDCAL_BENCH_SEED, 0
unless given, is added to the seed of every case: it gives cases on which no constant was chosen. FDCAL_BENCH_CSV names
a file that gets one row for each case.
"""

import csv
import os
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from fdcal.model.storage import cache_folder

from .field.cases import NoCaseError, build
from .field.families import FAMILIES
from .field.score import Score, run_case
from .report import Figure

ALONE = True
DRAWS = int(os.environ.get("FDCAL_BENCH_DRAWS", "8"))
WANTED = [name for name in os.environ.get("FDCAL_BENCH_FAMILIES", "").split(",") if name] or list(FAMILIES)
SOLVER = os.environ.get("FDCAL_BENCH_SOLVER", "")
SEED = int(os.environ.get("FDCAL_BENCH_SEED", "0"))
RIGHT = {  # fraction of the cases of a family that must be right
    "clean2d": 0.95,
    "clean3d": 0.85,
    "clean3d_takes": 0.85,
    "fem2d": 0.95,
    "big2d": 0.8,
    "blindcircle": 0.75,
    "noisy2d": 0.95,
    "channels": 0.9,
    "gainest": 0.9,
    "oneaway": 0.9,
    "knownfault": 0.85,
}
MEDIAN_S, LONGEST_S = 2.3, 15.0  # of processor
LEAST_COVERED, MOST_COVERED = 90.0, 98.0  # percent


def run() -> Iterator[Figure]:
    rows: list[dict] = []
    for name in WANTED:
        scores = list(_scores(name, rows))
        yield from _figures(name, scores)
    seconds = [row["seconds"] for row in rows]
    if seconds:
        yield Figure("all: median processor time", float(np.median(seconds)), "s", f"at most {MEDIAN_S}")
        yield Figure("all: longest processor time", max(seconds), "s", f"at most {LONGEST_S}")
    if rows and "FDCAL_BENCH_CSV" in os.environ:
        with open(os.environ["FDCAL_BENCH_CSV"], "w", newline="") as file:
            writer = csv.DictWriter(file, rows[0])
            writer.writeheader()
            writer.writerows(rows)


def _scores(name: str, rows: list[dict]) -> Iterator[Score]:
    folder = Path(cache_folder()) / "field"
    for number, spec in enumerate(FAMILIES[name](DRAWS)):
        try:
            score = run_case(
                build(replace(spec, seed=spec.seed + SEED), folder), arguments=("--solver", SOLVER) if SOLVER else ()
            )
        except NoCaseError:
            continue
        rows.append({"family": name, "case": number, "fault": spec.fault, **asdict(score)})
        yield score


def _figures(name: str, scores: list[Score]) -> Iterator[Figure]:
    count, part = len(scores), RIGHT.get(name)
    right, wrong = sum(s.right for s in scores), sum(s.confidently_wrong for s in scores)
    target = "" if part is None else f"at least {part:.0%}"
    yield Figure(f"{name}: right", right, f"of {count}", target, None if part is None else right >= part * count)
    yield Figure(f"{name}: verdict good", sum(s.verdict == "good" for s in scores), f"of {count}")
    placed = [s for s in scores if s.right and s.placeable]
    called = sum(s.verdict == "good" for s in placed)
    yield Figure(f"{name}: good of those right, and certain to a tenth of the radius", called, f"of {len(placed)}")
    yield Figure(f"{name}: good and wrong", wrong, f"of {count}", "0", wrong == 0)
    yield Figure(f"{name}: what is at fault is named", sum(s.named for s in scores), f"of {count}")
    good = [s for s in scores if s.verdict == "good"]
    share = 100 * sum(s.covered for s in good) / max(1, sum(s.judged for s in good))
    met = LEAST_COVERED <= share <= MOST_COVERED if good else None
    yield Figure(f"{name}: inside the ellipses of 95 %, where good", share, "%", "90 to 98", met)
    failed = sum(s.outcome in ("hang", "crash") for s in scores)
    yield Figure(f"{name}: hang or crash", failed, f"of {count}", "0", failed == 0)
