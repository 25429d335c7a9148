"""What `fdcal plan` promises beside what recordings of the same array reach, for 16 to 64 microphones in a living room.

A ball of 0.4 m in a room of 5 x 4 x 2.6 m, 0.4 s, by image sources, nothing given; four takes of 8 s of noise, or four
impulses, as of `fdcal_bench`. Planned: the least error of `fdcal plan` for this array, room, reverberation time, four
takes and 30 dB, in a diffuse field, and in the room's own. Reached: RMS after the best rigid motion, of each draw.

FDCAL_BENCH_DRAWS sets the draws, 3 unless given.
"""

import os
from collections.abc import Iterator

import numpy as np

from fdcal.session.planning.plan import make_plan
from fdcal.session.planning.request import Layout, PlanRequest
from fdcal_bench.cases import LIVING, SNR_DB, TAKES, Family
from fdcal_bench.methods import fdcal
from fdcal_bench.scores import score

ALONE = True
DRAWS = int(os.environ.get("FDCAL_BENCH_DRAWS", "3"))
COUNTS, RADIUS, REVERBERATION = (16, 24, 32, 48, 64), 0.4, 0.4  # m, s
WITHIN = 1.3  # factor


def planned(places: np.ndarray) -> tuple[float, float]:
    """The least error in a diffuse field, and in the room's own, millimetres."""
    layout = Layout("drawn", tuple(map(str, range(len(places)))), places)
    request = PlanRequest(layout, room=LIVING, reverberation_time=REVERBERATION, snr_db=SNR_DB, takes=TAKES)
    plan = make_plan(request, with_advice=False)
    return 1e3 * plan.bound.rms, np.nan if plan.room_bound is None else 1e3 * plan.room_bound.rms


def table() -> Iterator[str]:
    """The lines of a table in Markdown: a line for each number of microphones and kind of sound."""
    yield "| microphones | sound | planned (mm) | planned in the room (mm) | reached (mm) | reached over planned |"
    yield "|---|---|---|---|---|---|"
    ratios = []
    for count in COUNTS:
        for kind in ("noise", "impulse"):
            cases = [Family("", LIVING, REVERBERATION, kind, count, RADIUS).draw(seed) for seed in range(DRAWS)]
            plans = np.array([planned(case.truth) for case in cases])
            reached = [score(case, fdcal, "fdcal").error_mm for case in cases]
            ratio = np.array(reached) / plans[:, 0]
            ratios += [ratio] * (kind == "noise")
            cells = [" / ".join(f"{value:.1f}" for value in values) for values in (plans[:, 0], plans[:, 1], reached)]
            yield f"| {count} | {kind} | {' | '.join(cells)} | {' / '.join(f'{one:.1f}' for one in ratio)} |"
    every = np.concatenate(ratios)
    share = np.mean((every < WITHIN) & (every > 1 / WITHIN))
    words = f"median {np.nanmedian(every):.1f}, within a factor of {WITHIN:g} in {100 * share:.0f} %"
    yield f"| all | noise | | | | {words} |"


run = table
