"""How more takes reduce the error if they divide the frequencies: 64 microphones in a living room, 32 in a hall.

No position is given; one, two and four takes of 8 s of noise at 30 dB, as in `fdcal_bench`. The table has the expected
and the least error of `fdcal plan` beside the RMS error of FDCAL_BENCH_DRAWS draws, 4 unless given.
"""

import os
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from fdcal.session.plan import Layout, PlanRequest, make_plan
from fdcal_bench.cases import HALL, LIVING, SNR_DB, Family
from fdcal_bench.methods import fdcal
from fdcal_bench.scores import score

DRAWS = int(os.environ.get("FDCAL_BENCH_DRAWS", "4"))
CASES = (Family("living room 0.4 s, 64 in 0.4 m", LIVING, 0.4, "noise", 64, 0.4),
         Family("hall 1 s, 32 in 0.4 m", HALL, 1.0, "noise", 32, 0.4))  # fmt: skip
TAKES = (1, 2, 4)


def table() -> Iterator[str]:
    """Yield the lines of a table in Markdown."""
    yield "| case | takes | frequencies of a take | least error (mm) | expected (mm) | reached (mm) |"
    yield "|---|---|---|---|---|---|"
    for family in CASES:
        places, cases = family.places(0), [family.draw(draw) for draw in range(DRAWS)]
        layout = Layout("drawn", tuple(map(str, range(len(places)))), places)
        for takes in TAKES:
            request = PlanRequest(layout, family.room, family.reverberation, SNR_DB, takes=takes)
            plan = make_plan(request)
            errors = [
                score(replace(case, recordings=case.recordings[:takes]), fdcal, "fdcal").error_mm for case in cases
            ]
            yield (
                f"| {family.name} | {takes} | {len(request.frequencies)} | {1e3 * plan.bound.rms:.1f}"
                f" | {1e3 * plan.forecast.rms:.1f} | {np.sqrt(np.mean(np.square(errors))):.1f} |"
            )


run = table
