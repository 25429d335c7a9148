"""The table "paper | descent | joint", as Markdown and as CSV."""

import csv
import io

from .study import NEAR, PRINTED, Array, Outcome, title_of

WHY = """\
- Exact: every microphone ends on its true cell of the search lattice ({step:g} cm), as in the paper.
  "Frequencies needed" is the least number with which all seeds end so; if there is none, the rows below are of all.
- The paper shows one run of each array. It states no time, no total of iterations and no success rate over starts.
- descent is the paper's method with two changes: a weight on the known microphones, and an order that grows. It ends
  near the true positions but not on them. The remaining error is a smooth deformation of the whole array, which would
  need steps smaller than a cell from each single microphone; more modes do not help, since the lattice is the limit.
- joint has its own starts, which do not depend on the seed unless random arrays follow: its seeds agree.
- Error, sweeps and processor time are medians over the seeds.
"""


def markdown(arrays: list[Array], found: list[tuple[Outcome, ...]]) -> str:
    """Return one table per array, and what its words mean."""
    parts = [_table(array, outcomes) for array, outcomes in zip(arrays, found, strict=True)]
    return "\n\n".join([*parts, WHY.format(step=100 * arrays[0].search.step)])


def _table(array: Array, outcomes: tuple[Outcome, ...]) -> str:
    seeds = outcomes[0].seeds
    head = [title_of(array.name), "paper", *(o.solver for o in outcomes)]
    rows = [head, ["---"] * len(head)]
    for name, printed, ours in _rows(array, seeds):
        rows.append([name, printed, *(ours(o) for o in outcomes)])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _rows(array: Array, seeds: int):
    """Return for every row its name, what the paper states, and a function from an outcome to text."""
    stated = PRINTED.get(array.name)
    return (
        ("frequencies needed for exact positions", f"{stated.modes}" if stated else "-", _needed),
        ("highest frequency", f"{stated.highest:.0f} Hz" if stated else "-", lambda o: f"{o.highest:.0f} Hz"),
        ("mean error", "0, as printed" if stated else "-", lambda o: _length(o.error)),
        ("sweeps", f"not stated; above {stated.iteration} (Fig. 2)" if stated else "-", lambda o: f"{o.sweeps:.0f}"),
        ("processor time", "not stated" if stated else "-", lambda o: f"{_seconds(o.seconds)} s"),
        (f"exact, of {_seeds(seeds)}", "not stated; one run shown" if stated else "-", _success),
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
    """Return two significant digits, without an exponent."""
    return f"{float(f'{seconds:.2g}'):g}"


def comma_separated(arrays: list[Array], found: list[tuple[Outcome, ...]]) -> str:
    """Return one line per array and solver, in metres, Hz and seconds; unknown values are empty."""
    out = io.StringIO()
    write = csv.writer(out, lineterminator="\n").writerow
    write(
        ["array", "solver", "modes_needed", "modes", "highest_hz", "mean_error_m", "sweeps", "processor_s", "exact",
         "within_5_cm", "seeds"]
    )  # fmt: skip
    for array, outcomes in zip(arrays, found, strict=True):
        if array.name in PRINTED:
            stated = PRINTED[array.name]
            write([array.name, "paper", stated.modes, stated.modes, stated.highest, 0, "", "", "", "", ""])
        for o in outcomes:
            write([array.name, o.solver, o.needed or "", o.modes, o.highest, o.error, o.sweeps, o.seconds, o.exact,
                   o.near, o.seeds])  # fmt: skip
    return out.getvalue()
