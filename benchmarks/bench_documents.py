"""The figures in the documentation, computed and written into it.

A figure stands between marks, in a text or as a whole table:

    <!-- figure: KEY -->text<!-- /figure -->

and in docs/figures.json under its key, with which a test compares the documents. FDCAL_BENCH_KEYS names some keys,
separated by commas; all take about half an hour of one processor. `python -m benchmarks documents` writes both.
"""

import json
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from fdcal.model.scene_file import scene_names
from fdcal.session.calibration_run import solve
from fdcal.session.sources import load_input, with_settings
from fdcal_bench.scores import read_reference, table

from . import bench_doctor, bench_leave_one_out, bench_planned

ALONE = True
DOCS = Path(__file__).parents[1] / "docs"
STORE = DOCS / "figures.json"
TIME_LIMIT = 600.0  # s of processor time, so that the verdict does not depend on the machine
MARK = re.compile(r"(<!-- figure: ([\w-]+) -->)(.*?)(<!-- /figure -->)", re.DOTALL)


def bench() -> str:
    """The reference results of fdcal_bench, which `python -m fdcal_bench --reference` computes."""
    return table(read_reference())


def scenes() -> str:
    """The error of both solvers in every scene."""
    lines = ["| scene | `joint` | verdict | `robust` | verdict |", "|---|---|---|---|---|"]
    for name in scene_names():
        cells = []
        inputs = load_input(name)
        for solver in ("joint", "robust"):
            found = solve(replace(with_settings(inputs, solver), time_limit=TIME_LIMIT))
            error = "" if found.mean_error is None else f"{1e3 * found.mean_error:.2g}"
            cells += [error, f"`{found.verdict}`"]
        lines.append(f"| `{name}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def leave_one_out() -> str:
    """Leave-one-out errors of draws of array 2 and the ball."""
    lines = [
        "| | leave-one-out error | worst frequency | worst microphone | error of the field inside the array | position"
        " error, RMS, median draw | draws that are lost |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, snr, words in (("array2_random", 40, "array 2, 40 dB"), ("array2_random", 20, "array 2, 20 dB"),
                             ("ball3d", 40, "`ball3d`, 40 dB")):  # fmt: skip
        found = bench_leave_one_out.figures_of(name, snr)
        cells = [f"{found[key].value:.1f} dB" for key in ("whole", "modes", "microphones", "inside")]
        place, lost = found["median"].value, found["lost"]
        lines.append(f"| {words} | {' | '.join(cells)} | {place:.2g} mm | {lost.value:g} {lost.unit} |")
    return "\n".join(lines)


def displaced() -> str:
    """Leave-one-out errors at true positions with random displacements, in words."""
    found = [one.value for one in bench_leave_one_out.figures_aside()][::2]
    parts = [f"{value:.1f}" for value in found]
    far = [f"{mm:g} mm" for mm in bench_leave_one_out.ASIDE]
    cells = [f"{value} ({mm})" for value, mm in zip(parts, far, strict=True)]
    return f"{', '.join(cells[:-1])} and {parts[-1]} dB ({far[-1]})"


def doctor() -> str:
    """How many injected faults `fdcal doctor` names."""
    return doctor_table(bench_doctor.run())


def planned() -> str:
    """What a plan promises beside what recordings reach."""
    return "\n".join(bench_planned.table())


def doctor_table(lines) -> str:
    """Return the lines of `benchmarks doctor` as a table in Markdown."""
    rows = [re.fullmatch(r" *(\S.*?) +(\d+ of) +(\d+)(?:  +(\d+ of) +(\d+))?  .*", line) for line in lines]
    cells = [f"| {row[1]} | {row[2]} {row[3]} | {f'{row[4]} {row[5]}' if row[4] else ''} |" for row in rows if row]
    return "\n".join(["| injected | named | as what it is |", "|---|---|---|", *cells])


FIGURES: dict[str, Callable[[], str]] = {
    "bench": bench, "scenes": scenes, "leave-one-out": leave_one_out, "displaced": displaced, "doctor": doctor,
    "planned": planned,
}  # fmt: skip
QUICK = ("bench",)  # which a test computes again


def pages() -> list[Path]:
    """The documents that may hold figures."""
    return sorted(DOCS.rglob("*.md"))


def figures_in(text: str) -> dict[str, str]:
    """Return the figures of a document, by key."""
    return {mark[2]: mark[3].strip() for mark in MARK.finditer(text)}


def with_figures(text: str, figures: dict[str, str]) -> str:
    """Return a document with figures, by key, between their marks; a table gets lines of its own."""

    def replaced(mark: re.Match) -> str:
        value = figures.get(mark[2], mark[3].strip())
        return f"{mark[1]}\n\n{value}\n\n{mark[4]}" if "\n" in value else f"{mark[1]}{value}{mark[4]}"

    return MARK.sub(replaced, text)


def run() -> Iterator[str]:
    wanted = [key for key in os.environ.get("FDCAL_BENCH_KEYS", "").split(",") if key] or list(FIGURES)
    stored = json.loads(STORE.read_text(encoding="utf-8")) if STORE.exists() else {}
    for key in wanted:
        before, stored[key] = stored.get(key), FIGURES[key]()
        write(stored)
        yield f"{key}: {'unchanged' if before == stored[key] else 'changed'}"


def write(stored: dict[str, str]) -> None:
    """Write figures into the store and the documents."""
    STORE.write_text(json.dumps(dict(sorted(stored.items())), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    for page in pages():
        text = page.read_text(encoding="utf-8")
        if MARK.search(text):
            page.write_text(with_figures(text, stored), encoding="utf-8")
