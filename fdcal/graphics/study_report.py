"""The report of a study: its figures as PNG and SVG, and one page of HTML."""

from __future__ import annotations

from collections import Counter
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from ..assessment.study_statistics import judged, selected
from ..model.storage import write_atomically
from ..model.validation import InputError
from ..session.study.definition import version_text
from .landscape_figure import figure_bytes
from .study_figures import draw_error, draw_error_bars, draw_success, draw_verdicts
from .study_panels import study_panels

if TYPE_CHECKING:
    import pandas

STYLE = "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto}img{max-width:100%}"
UNKNOWN = "an fdcal that did not note its sources"
CAPTIONS = {
    "success": "An array counts as found where the error is below 5 mm, or three times the Cramer-Rao bound.",
    "error": "Median error of the microphones that are sought, 10 to 90 % shaded; dashed the bound in a diffuse field.",
    "error-bars": "Error against the one sigma that each calibration claims.",
    "verdicts": "Verdicts, right and wrong either way; wrong is an error above 5 mm and three claimed sigmas.",
}


def write_report(
    folder: str | Path, head: dict, rows: pandas.DataFrame, names: tuple[str, str] | None, at: dict[str, str]
) -> Path:
    """Write the report of a study into the folder `report` of its own, and return its page.

    `head`, `rows`: as of `fdcal.session.study.results.read_results`; `names`: axes along y and x of the figures; as of
    `study_panels` unless given; `at`: values of other axes, as text. Raises InputError: an axis or a value is not of
    the study.
    """
    axes = head["axes"]
    _require_axes(axes, names)
    rows = judged(selected(rows, axes, at))
    if not len(rows):
        raise InputError("no calibration of the study has these values", "leave out <at>", key="at")
    axes = {name: values for name, values in axes.items() if name not in at or name in (names or ())}
    shown = study_panels(axes, names)
    figures = {
        "success": draw_success(rows, axes, shown),
        "error": draw_error(rows, axes, shown),
        "error-bars": draw_error_bars(rows, shown),
        "verdicts": draw_verdicts(rows, axes, shown),
    }
    target = Path(folder) / "report"
    target.mkdir(exist_ok=True)
    for name, figure in figures.items():
        for kind in ("png", "svg"):
            content = figure_bytes(figure, kind)
            write_atomically(target / f"{name}.{kind}", lambda file, c=content: file.write_bytes(c), True)
    page = target / "index.html"
    text = _page(head, rows, at)
    write_atomically(page, lambda file: file.write_text(text, encoding="utf-8"), True)
    return page


def _require_axes(axes: dict, names: tuple[str, str] | None) -> None:
    for name in names or ():
        if name not in axes:
            raise InputError(f"the study has no axis {name}", f"use {', '.join(axes)}", key="axes", value=name)


def code_text(rows: pandas.DataFrame) -> str:
    """Return in a sentence which code computed the rows of a study, and how many each where there are several."""
    counts: Counter = Counter()
    for row in rows.to_dict("records"):
        source, commit = row.get("source"), row.get("commit")
        known = isinstance(source, str)
        text = version_text(row["version"], source, commit if isinstance(commit, str) else None) if known else UNKNOWN
        counts[text] += 1
    if len(counts) == 1:
        return f"Computed by {next(iter(counts))}."
    return f"Computed by different code: {'; '.join(f'{count} by {text}' for text, count in counts.most_common())}."


def _page(head: dict, rows: pandas.DataFrame, at: dict[str, str]) -> str:
    where = "".join(f", {escape(key)} = {escape(value)}" for key, value in at.items())
    summary = (
        f"{len(rows)} of {head['count']} calibrations{where}: the array found in {rows['found'].mean():.1%}, verdict"
        f" good in {rows['trusted'].mean():.1%}, good and wrong in {rows['wrong'].mean():.2%};"
        f" {rows['seconds'].median():.2g} s of processor time each (median). {escape(code_text(rows))}"
    )
    pictures = "".join(
        f'<h2>{escape(name.replace("-", " ").capitalize())}</h2><p>{escape(text)}</p><a href="{name}.svg">'
        f'<img src="{name}.png" alt="{escape(text)}"></a>'
        for name, text in CAPTIONS.items()
    )
    title = escape(str(head["title"]))
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title><style>{STYLE}</style>'
        f"<h1>{title}</h1><p>{summary}</p>{pictures}</html>\n"
    )
