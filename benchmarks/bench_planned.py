"""What `fdcal plan` forecasts beside what recordings of the same array reach: living rooms, a hall, studios.

No position is given; four takes of 8 s of noise, or four impulses, as in `fdcal_bench`. Planned: the expected error and
its range from `fdcal plan` for this array, room, reverberation time, sound, four takes and 30 dB. Reached: RMS after
the best rigid motion.

Not all draws test the forecast. Its extra scatter was chosen by the cases of `fdcal_bench`, and its factor for
impulses by these and by the first three draws of each further case with impulses. The model was chosen with the first
three draws of the further cases with noise in the living room. So only these are a test: the further draws with noise
in the office, and those in the living room after the third.

FDCAL_BENCH_DRAWS sets the draws of the further cases, 3 unless given; the others are the reference draws of
`fdcal_bench`.
"""

import os
from collections.abc import Iterator

import numpy as np

from fdcal.session.plan import Layout, PlanRequest, make_plan
from fdcal_bench.cases import FAMILIES, LIVING, SNR_DB, TAKES, Family
from fdcal_bench.methods import fdcal
from fdcal_bench.scores import read_reference, score

ALONE = True
DRAWS = int(os.environ.get("FDCAL_BENCH_DRAWS", "3"))
WITHIN = 1.3  # factor
SEEN = 3  # first draws of each further case in the living room, which were known when the model was chosen
FURTHER = tuple(Family(f"living room 0.4 s, {words}, {count} in 0.4 m", LIVING, 0.4, kind, count, 0.4)
            for count in (24, 48, 64) for kind, words in (("noise", "noise"), ("impulse", "impulses")))  # fmt: skip
FURTHER += tuple(Family(f"office 0.6 s, noise, {count} in 0.4 m", (7.0, 5.0, 3.0), 0.6, "noise", count, 0.4)
             for count in (20, 40))  # fmt: skip


def planned(family: Family, draw: int) -> tuple[float, float, float]:
    """Return the expected error of a draw and the ends of its range, millimetres."""
    places = family.places(draw)
    request = PlanRequest(
        Layout("drawn", tuple(map(str, range(len(places)))), places),
        room=family.room,
        reverberation_time=family.reverberation,
        snr_db=SNR_DB,
        takes=TAKES,
        kind="impulse" if family.kind == "impulse" else "stationary",
    )
    found = make_plan(request).forecast
    return 1e3 * found.rms, 1e3 * found.low, 1e3 * found.high


def reached(family: Family) -> list[float]:
    """Return the errors of the draws of a case, millimetres, from the reference results if these have the case."""
    stored = [one for one in read_reference() if (one.case, one.method) == (family.name, "fdcal")]
    if stored:
        return [one.error_mm for one in sorted(stored, key=lambda one: one.draw)]
    return [score(family.draw(draw), fdcal, "fdcal").error_mm for draw in range(DRAWS)]


def table() -> Iterator[str]:
    """Yield a table in Markdown: a line for each case, then those of all draws and of all further draws."""
    yield "| case | draws | planned (mm), 8 of 10 | reached (mm), RMS | over planned | in the range |"
    yield "|---|---|---|---|---|---|"
    totals: dict[str, list[np.ndarray]] = {}
    seen: dict[str, int] = {}
    for family in (*(one for one in FAMILIES if one.kind != "speech"), *FURTHER):
        errors = np.array(reached(family))
        plans = np.array([planned(family, draw) for draw in range(len(errors))])
        rms, low, high = np.sqrt(np.mean(plans**2, axis=0))
        inside = (errors >= plans[:, 1]) & (errors <= plans[:, 2])
        over = np.sqrt(np.mean(errors**2) / np.mean(plans[:, 0] ** 2))
        yield (
            f"| {family.name} | {len(errors)} | {rms:.1f}, {low:.1f} to {high:.1f} | {np.sqrt(np.mean(errors**2)):.1f}"
            f" | {over:.2f} | {inside.sum()} of {len(errors)} |"
        )
        words = "impulses" if family.kind == "impulse" else "noise"
        words = f"{'further ' if family in FURTHER else ''}draws, {words}"
        seen[words] = seen.get(words, 0) + (min(SEEN, len(errors)) if family.room == LIVING else 0)
        totals.setdefault(words, []).append(np.column_stack([errors / plans[:, 0], inside]))
    for words, parts in totals.items():
        ratio, inside = np.concatenate(parts).T
        near = 100 * np.mean((ratio < WITHIN) & (ratio > 1 / WITHIN))
        over = f"{np.sqrt(np.mean(ratio**2)):.2f}; {near:.0f} % within a factor of {WITHIN:g}"
        known = f" ({seen[words]} seen before)" if words.startswith("further") else ""
        yield f"| all {words}{known} | {len(ratio)} | | | {over} | {inside.sum():.0f} of {len(ratio)} |"


run = table
