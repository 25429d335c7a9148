"""The table "paper | descent | descent + joint | joint": in Markdown to be read, in CSV to be worked on."""

from __future__ import annotations

import csv
import io

from .printed import PRINTED, title_of
from .study import NEAR, Array, Outcome

SOLVERS = {"descent": "descent", "descent+joint": "descent + joint", "joint": "joint"}
WHY = """\
- Exact: every microphone ends on its true cell of the search lattice ({step:g} cm), the paper's sense of the word.
  "Modes needed" is the least number with which all seeds end so; where none does, what stands below is of all modes.
- The paper shows one run of each array. It tells no time, no total of iterations and no success over starts.
- descent is the paper's method with two changes: a weight on the known microphones, and an order that grows. It ends
  near the truth but not on it. What is left is a smooth deformation of the whole array, whose step for each
  microphone alone is a fraction of a cell and rounds to nothing; more modes do not help, for it is the grid that
  holds it.
- descent + joint goes on from where descent has ended with as many modes as its column tells; sweeps and time are of
  both. joint alone starts in closed form, not at random: its seeds agree.
- Error, sweeps and processor time are medians over the seeds.
"""


def markdown(arrays: list[Array], found: list[tuple[Outcome, ...]]) -> str:
    """One table an array, and what its words mean."""
    parts = [_table(array, outcomes) for array, outcomes in zip(arrays, found, strict=True)]
    return "\n\n".join([*parts, WHY.format(step=100 * arrays[0].search.step)])


def _table(array: Array, outcomes: tuple[Outcome, ...]) -> str:
    seeds = outcomes[0].seeds
    head = [title_of(array.name), "paper", *(SOLVERS[o.solver] for o in outcomes)]
    rows = [head, ["---"] * len(head)]
    for name, printed, ours in _rows(array, seeds):
        rows.append([name, printed, *(ours(o) for o in outcomes)])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _rows(array: Array, seeds: int):
    """Of every row its name, what the paper prints, and a function of an outcome to words."""
    told = PRINTED.get(array.name)
    return (
        ("modes needed for exact positions", f"{told.modes}" if told else "-", _needed),
        ("highest frequency", f"{told.highest:.0f} Hz" if told else "-", lambda o: f"{o.highest:.0f} Hz"),
        ("mean error", "0, as printed" if told else "-", lambda o: _length(o.error)),
        ("sweeps", f"not told; above {told.iteration} (Fig. 2)" if told else "-", lambda o: f"{o.sweeps:.0f}"),
        ("processor time", "not told" if told else "-", lambda o: f"{_seconds(o.seconds)} s"),
        (f"exact, of {_seeds(seeds)}", "not told; one run shown" if told else "-", _success),
    )


def _needed(outcome: Outcome) -> str:
    return f"{outcome.needed}" if outcome.needed else f"not reached with {outcome.modes}"


def _success(outcome: Outcome) -> str:
    words = f"{outcome.exact}"
    return words if outcome.exact == outcome.seeds else f"{words}; {outcome.near} within {100 * NEAR:g} cm"


def _seeds(count: int) -> str:
    return "one seed" if count == 1 else f"{count} seeds"


def _length(metres: float) -> str:
    return f"{1e3 * metres:.2g} mm"


def _seconds(seconds: float) -> str:
    """Two figures, without an exponent."""
    return f"{float(f'{seconds:.2g}'):g}"


def comma_separated(arrays: list[Array], found: list[tuple[Outcome, ...]]) -> str:
    """One line an array and solver, in metres, Hz and seconds; empty where nothing is told or needed is not reached."""
    out = io.StringIO()
    write = csv.writer(out, lineterminator="\n").writerow
    write(
        ["array", "solver", "modes_needed", "modes", "highest_hz", "mean_error_m", "sweeps", "processor_s", "exact",
         "within_5_cm", "seeds"]
    )  # fmt: skip
    for array, outcomes in zip(arrays, found, strict=True):
        if array.name in PRINTED:
            told = PRINTED[array.name]
            write([array.name, "paper", told.modes, told.modes, told.highest, 0, "", "", "", "", ""])
        for o in outcomes:
            write([array.name, o.solver, o.needed or "", o.modes, o.highest, o.error, o.sweeps, o.seconds, o.exact,
                   o.near, o.seeds])  # fmt: skip
    return out.getvalue()
