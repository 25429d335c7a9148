"""The figures in the documentation, computed and written into it.

A figure stands between marks, in a text or as a whole table:

    <!-- figure: KEY -->text<!-- /figure -->

and in docs/figures.json under its key, with which a test compares the documents. FDCAL_BENCH_KEYS names some keys,
separated by commas; all take about an hour of one processor. `python -m benchmarks documents` writes both. What a
command prints keeps the lines and the words that the document has, and gets the numbers of a run (`printed.renewed`).
Then the tests in checks/ run (`pip install -e '.[test]'`): all pages, examples, numbers in lessons, and figures of the
paper. The exit code is 1 if one of them fails.
"""

import contextlib
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

from fdcal.model.scene import scene_names
from fdcal.session.calibration_run import solve
from fdcal.session.sources import load_input, with_settings
from fdcal_bench.scores import read_reference, table

from . import bench_comparison, bench_doctor, bench_leave_one_out, bench_planned
from .documents import ALL, BLOCK, DOCS, text_of
from .printed import renewed, run_fdcal

ALONE = True
STORE = DOCS / "figures.json"
IN_SHORT = (0, 2, 3, 4, 5, 9)  # rows of `benchmarks comparison` in the README
TIME_LIMIT = 600.0  # s of processor time, so that the verdict does not depend on the machine
MARK = re.compile(r"(<!-- figure: ([\w-]+) -->)(.*?)(<!-- /figure -->)", re.DOTALL)


def bench() -> str:
    """Return the reference results of fdcal_bench, which `python -m fdcal_bench run --reference` computes."""
    return table(read_reference())


def scenes() -> str:
    """Return a table of the errors of both solvers in every scene."""
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
    """Return a table of leave-one-out errors in draws of array 2 and the ball."""
    lines = [
        "| | leave-one-out error | worst frequency | worst microphone | position error, RMS, median draw | draws not"
        " found |",
        "|---|---|---|---|---|---|",
    ]
    for name, snr, words in (("array2_random", 40, "array 2, 40 dB"), ("array2_random", 20, "array 2, 20 dB"),
                             ("ball3d", 40, "`ball3d`, 40 dB")):  # fmt: skip
        found = bench_leave_one_out.figures_of(name, snr)
        cells = [f"{found[key].value:.1f} dB" for key in ("whole", "modes", "microphones")]
        place, lost = found["median"].value, found["lost"]
        lines.append(f"| {words} | {' | '.join(cells)} | {place:.2g} mm | {lost.value:g} {lost.unit} |")
    return "\n".join(lines)


def displaced() -> str:
    """Return in words the leave-one-out errors at true positions with random displacements."""
    found = [one.value for one in bench_leave_one_out.figures_displaced()][::2]
    parts = [f"{value:.1f}" for value in found]
    far = [f"{mm:g} mm" for mm in bench_leave_one_out.DISPLACEMENTS]
    cells = [f"{value} ({mm})" for value, mm in zip(parts, far, strict=True)]
    return f"{', '.join(cells[:-1])} and {parts[-1]} dB ({far[-1]})"


def doctor() -> str:
    """Return a table of how many injected faults `fdcal doctor` names."""
    return doctor_table(bench_doctor.run())


def planned() -> str:
    """Return the table of forecasts and reached errors, of all cases together."""
    head, rule, *lines = bench_planned.table()
    return "\n".join([head, rule, *(line for line in lines if line.startswith("| all"))])


@cache
def compared() -> tuple[str, ...]:
    """Return the table of fdcal beside other methods, without the row of the seconds."""
    return tuple(bench_comparison.run())[:-1]


def comparison_in_short() -> str:
    """Return some rows of the same table without the verdicts, for the README."""
    head, rule, *rows = (re.sub(r"[^|]*\|$", "", line) for line in compared())
    return "\n".join([head, rule, *(rows[n] for n in IN_SHORT)])


def doctor_table(lines) -> str:
    """Return the lines of `benchmarks doctor` as a table in Markdown, without faults that are always found."""
    rows = [re.fullmatch(r" *(\S.*?) +(\d+ of) +(\d+)(?:  +(\d+ of) +(\d+))?  .*", line) for line in lines]
    cells = [f"| {row[1]} | {row[2]} {row[3]} | {f'{row[4]} {row[5]}' if row[4] else ''} |" for row in rows if row]
    cells = [cell for cell in cells if "| 12 of 12 | 12 of 12 |" not in cell]
    return "\n".join(["| injected | named | as what it is |", "|---|---|---|", *cells])


@cache
def printed(commands: str) -> str:
    """Return what commands print in a folder with nothing but the examples of the repository."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        Path("examples").symlink_to(DOCS.parent / "examples")
        return run_fdcal(commands)


@cache
def tutorial() -> list[str]:
    """Return what each command of the tutorial prints, and the comparison after two rows of the list are swapped."""
    code = BLOCK.findall(text_of(DOCS / "tutorials" / "first-recording.md"))
    compare = "fdcal calibrate plate.npz --check --positions layout.csv --known none"
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        exec(next(text for language, text in code if language == "python"), {})
        found = [run_fdcal(text) for language, text in code if language == "sh"]
        rows = Path("layout.csv").read_text().splitlines()
        rows[4], rows[13] = rows[13].replace("12,", "3,", 1), rows[4].replace("3,", "12,", 1)
        Path("layout.csv").write_text("\n".join(rows))
        return [*found, run_fdcal(compare)]


def excerpt(key: str, output: str) -> str:
    """Return the block `text` between the marks of a key in a document, with the numbers of an output."""
    found = {mark: value for page in ALL for mark, value in figures_in(text_of(page)).items()}
    return fenced(renewed(found[key].removeprefix("```text").removesuffix("```"), output).splitlines())


def fenced(lines: list[str]) -> str:
    """Return lines as a block of text."""
    return "\n".join(["```text", *lines, "```"])


def one(pattern: str, output: str, form: str = "{}") -> str:
    """Return the number that a pattern finds in an output."""
    found = re.findall(pattern, output)
    if len(found) != 1:
        raise ValueError(f"{pattern} is found {len(found)} times in\n{output}")
    return form.format(float(found[0]))


FRL = "examples/frl_array"
FRL_TAKES = " ".join(f"{FRL}/source{angle}.flac" for angle in ("000", "090", "180", "270"))
TINY = "fdcal calibrate tiny"
RECORD = (
    f"fdcal record -o take1.wav --replay {FRL}/source000.flac --replay {FRL}/source180.flac"
    f" --positions {FRL}/nominal.csv --temperature 20"
)
DOCTOR = f"fdcal doctor {FRL_TAKES} --positions {FRL}/nominal.csv"
MEASURED = (
    f"fdcal import {FRL_TAKES} -o array.npz --temperature 20\nfdcal calibrate array.npz --positions {FRL}/nominal.csv"
)
MEAN, SIGMA, MILLIMETRES = r"error +mean ([\d.]+) mm", r"one sigma ([\d.]+) mm", "{:.2g} mm"

FIGURES: dict[str, Callable[[], str]] = {
    "bench": bench, "scenes": scenes, "leave-one-out": leave_one_out, "displaced": displaced, "doctor": doctor,
    "planned": planned,
    "comparison": lambda: "\n".join(compared()),
    "comparison-in-short": comparison_in_short,
    "tiny": lambda: one(MEAN, printed(TINY), MILLIMETRES),
    "record": lambda: excerpt("record", printed(RECORD)),
    "doctor-frl": lambda: excerpt("doctor-frl", printed(DOCTOR)),
    "frl-error": lambda: one(MEAN, printed(MEASURED), MILLIMETRES),
    "frl-verdict": lambda: f"`{re.findall(r'^verdict (.*?):', printed(MEASURED), re.MULTILINE)[0]}`",
    "frl-scene": lambda: one(MEAN, printed("fdcal calibrate frl_array"), MILLIMETRES),
    "frl-sigma": lambda: one(r"error .*" + SIGMA, printed(MEASURED), MILLIMETRES),
    "plate-import": lambda: excerpt("plate-import", tutorial()[0]),
    "plate-verdict": lambda: excerpt("plate-verdict", tutorial()[1]),
    "plate-prediction": lambda: one(r"leave-one-out error (-[\d.]+) dB", tutorial()[1], "{:.0f} dB"),
    "plate-largest": lambda: one(r"are swapped\n +\w+ +([\d.]+) mm", tutorial()[2], MILLIMETRES),
    "plate-swapped": lambda: fenced(tutorial()[-1].partition("good: ")[2].splitlines()[1:6]),
    "faults": lambda: excerpt("faults", printed("fdcal calibrate array2_faults")),
}  # fmt: skip
QUICK = ("bench",)  # which a test computes again


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
    if wanted == list(FIGURES):
        failed = subprocess.run([sys.executable, "-m", "pytest", Path(__file__).with_name("checks")]).returncode
        yield f"pages, examples, lessons and paper: {'a test failed' if failed else 'all tests pass'}"
        if failed:
            sys.exit(1)


def write(stored: dict[str, str]) -> None:
    """Write figures into the store and the documents."""
    STORE.write_text(json.dumps(dict(sorted(stored.items())), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    for page in ALL:
        text = text_of(page)
        if MARK.search(text):
            page.write_text(with_figures(text, stored), encoding="utf-8")
