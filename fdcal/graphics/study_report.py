"""The report of a study: its figures as PNG and SVG, and one page of HTML."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..assessment.study_statistics import COLUMNS, judged, quantiles, rows_of, selected, share_grid
from ..model.storage import write_atomically
from ..model.validation import InputError
from ..session.study import version_text
from .calibration_figure import html_table
from .landscape import figure_bytes

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure


MAX_PANELS = 8
MAX_COLUMNS = 4
MIN_WIDTH = 7.5  # inches, of a figure, so that its legend has room
FRAME = 0.8  # inches, for the legend and the name of the x axis
NOISE_AXIS = "snr_db"  # along x unless another is chosen
LABELS = {
    "snr_db": "signal-to-noise ratio (dB)",
    "solver.modes": "modes",
    "solver.name": "solver",
    "faults.gain_db": "channel gains, standard deviation (dB)",
    "radius": "radius of the array (m)",
    "known": "known microphones",
    "source.duration": "recording (s)",
}


@dataclass(frozen=True)
class StudyPanels:
    """How the axes of a study are laid out in a figure."""

    # y, x: names of axes; y is "" for a study of one axis
    y: str
    x: str
    # the values of other axes of each panel, by name; one empty dict without other axes
    panels: tuple[dict[str, Any], ...]
    columns: int  # panels in a row
    averaged: tuple[str, ...]  # axes over which every panel averages, since they would give too many panels

    def drawn(self, width: float, height: float) -> tuple[Figure, list[tuple[Any, dict[str, Any]]]]:
        """Return a figure with one matplotlib axes for each panel, `width` x `height` inches or more, and panels."""
        from matplotlib.figure import Figure

        rows = -(-len(self.panels) // self.columns)
        wide = max(width * self.columns, MIN_WIDTH)
        figure = Figure(figsize=(wide, FRAME + rows * max(height, 0.45 * wide / self.columns)), dpi=100)
        figure.set_layout_engine("constrained")
        cells = list(figure.subplots(rows, self.columns, squeeze=False, sharex=True, sharey=True).flat)
        for cell in cells[len(self.panels) :]:
            cell.set_visible(False)
        for cell, values in zip(cells, self.panels, strict=False):
            words = (one if isinstance(one, str) else f"{label_of(name)}: {one}" for name, one in values.items())
            cell.set_title(", ".join(words), fontsize="medium")
        return figure, list(zip(cells, self.panels, strict=False))


def study_panels(axes: dict[str, list], names: tuple[str, str] | None = None) -> StudyPanels:
    """Return the layout of the axes of a study, two along y and x, a panel for each combination of the others.

    `names`: axes along y and x; unless given, the signal-to-noise ratio along x and the last other axis of numbers
    along y, so that solvers and scenes are compared side by side.
    """
    y, x = names or _usual(axes)
    others = [name for name, values in axes.items() if name not in (y, x) and len(values) > 1]
    kept = list(others)
    while math.prod(len(axes[name]) for name in kept) > MAX_PANELS:
        kept.pop()
    kept.sort(key=lambda name: len(axes[name]))  # the longest fills the rows
    combinations = itertools.product(*(axes[name] for name in kept))
    panels = tuple(dict(zip(kept, values, strict=True)) for values in combinations)
    columns = len(axes[kept[-1]]) if len(kept) > 1 else min(len(panels), MAX_COLUMNS)
    return StudyPanels(y, x, panels, columns, tuple(name for name in others if name not in kept))


def _usual(axes: dict[str, list]) -> tuple[str, str]:
    several = [name for name, values in axes.items() if len(values) > 1] or list(axes)
    numbers = [name for name in several if all(isinstance(value, (int, float)) for value in axes[name])]
    x = NOISE_AXIS if NOISE_AXIS in several else (numbers or several)[-1]
    rest = [name for name in numbers if name != x] or [name for name in several if name != x]
    return rest[-1] if rest else "", x


def label_of(name: str) -> str:
    """Return what an axis of a study is called in a figure."""
    return LABELS.get(name, name.replace("_", " "))


SMALL = "small"
LONG = 24  # characters of an entry of a legend, above which there are two in a line


def draw_success(rows: pandas.DataFrame, axes: dict, shown: StudyPanels) -> Figure:
    """Return maps of the fraction of calibrations that found the array, a map for each panel."""
    x, y = axes[shown.x], axes.get(shown.y, [""])
    figure, panels = shown.drawn(1.4 + 0.6 * len(x), 1.2 + 0.45 * len(y))
    drawn: Any = None
    for panel, values in panels:
        share = share_grid(rows_of(rows, values), axes, (shown.y, shown.x), "found")
        drawn = panel.imshow(share, vmin=0, vmax=1, cmap="viridis", aspect="auto", origin="lower")
        for (i, j), one in np.ndenumerate(share):
            if np.isfinite(one):
                colour = "black" if one > 0.6 else "white"
                panel.text(j, i, f"{100 * one:.0f} %", ha="center", va="center", color=colour, fontsize=SMALL)
        panel.set_yticks(range(len(y)), [str(value) for value in y])
        panel.set_xticks(range(len(x)), [str(value) for value in x])
    _name_axes(figure, shown, label_of(shown.y))
    figure.colorbar(drawn, ax=[panel for panel, _ in panels], label="share that found the array")
    return figure


def draw_error(rows: pandas.DataFrame, axes: dict, shown: StudyPanels) -> Figure:
    """Return the median error along the x axis beside the bound, a line for each value of the y axis."""
    figure, panels = shown.drawn(2.6, 2.6)
    places = np.arange(len(axes[shown.x]))
    for panel, values in panels:
        for number, value in enumerate(axes.get(shown.y, [""])):
            part = rows_of(rows, values | ({shown.y: value} if shown.y else {}))
            low, middle, high = 1e3 * quantiles(part, axes, shown.x, "rms_error_m").T
            bound = 1e3 * quantiles(part, axes, shown.x, "bound_m", (0.5,))[:, 0]
            colour = f"C{number % 10}"
            panel.plot(places, middle, "o-", color=colour, label=str(value) if shown.y else "error")
            panel.fill_between(places, low, high, color=colour, alpha=0.15)
            panel.plot(places, bound, "--", color=colour)
        panel.set_yscale("log")
        panel.set_xticks(places, [str(value) for value in axes[shown.x]])
        panel.grid(alpha=0.3)
    panels[0][0].plot([], [], "--", color="grey", label="Cramer-Rao bound")
    _name_axes(figure, shown, "median error (mm rms)")
    _add_legend(figure, panels[0][0], label_of(shown.y))
    return figure


def draw_error_bars(rows: pandas.DataFrame, shown: StudyPanels) -> Figure:
    """Return the error of every calibration against the one sigma that it claims."""
    figure, panels = shown.drawn(2.6, 2.8)
    known = rows.dropna(subset=["claimed_sigma_m", "rms_error_m"])
    ends = 1e3 * np.array([known["claimed_sigma_m"].min(), known["claimed_sigma_m"].max()])
    for panel, values in panels:
        inside = rows_of(known, values)
        for trusted, mark, name in ((True, ".", "verdict good"), (False, "x", "another verdict")):
            part = inside[inside["trusted"] == trusted]
            panel.loglog(1e3 * part["claimed_sigma_m"], 1e3 * part["rms_error_m"], mark, alpha=0.4, label=name)
        panel.loglog(ends, ends, "k-", linewidth=1, label="error as claimed")
        panel.loglog(ends, 3 * ends, "k:", linewidth=1, label="three times that")
        panel.grid(alpha=0.3)
    figure.supxlabel("claimed one sigma (mm rms)", fontsize="medium")
    figure.supylabel("error (mm rms)", fontsize="medium")
    _add_legend(figure, panels[0][0])
    return figure


def draw_verdicts(rows: pandas.DataFrame, axes: dict, shown: StudyPanels) -> Figure:
    """Return bars of how often the verdict was right or wrong either way, along the x axis."""
    figure, panels = shown.drawn(2.6, 2.4)
    kinds = (
        ("good", "good, and true", "tab:green"),
        ("doubted", "not good, though the array was found", "tab:olive"),
        ("lost", "not good, and the array was not found", "tab:grey"),
        ("wrong", "good, and wrong", "tab:red"),
    )
    for panel, values in panels:
        part, base = rows_of(rows, values), np.zeros(len(axes[shown.x]))
        for column, text, colour in kinds:
            share = np.nan_to_num(share_grid(part, axes, (shown.x, ""), column)[:, 0])
            panel.bar(range(len(base)), 100 * share, bottom=100 * base, color=colour, label=text)
            base = base + share
        panel.set_xticks(range(len(base)), [str(value) for value in axes[shown.x]])
    _name_axes(figure, shown, "calibrations (%)")
    _add_legend(figure, panels[0][0])
    return figure


def _name_axes(figure: Figure, shown: StudyPanels, vertical: str) -> None:
    """Label the axes once for all panels, and say over which axes they average."""
    over = f"   (all of: {', '.join(label_of(name) for name in shown.averaged)})" if shown.averaged else ""
    figure.supxlabel(label_of(shown.x) + over, fontsize="medium")
    figure.supylabel(vertical, fontsize="medium")


def _add_legend(figure: Figure, panel: Any, title: str = "") -> None:
    handles, labels = panel.get_legend_handles_labels()
    columns = 2 if max(map(len, labels)) > LONG else 6
    place = "outside upper center"
    figure.legend(handles, labels, fontsize=SMALL, loc=place, ncols=columns, title=title or None, title_fontsize=SMALL)


STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto}img{max-width:100%}"
    "td,th{text-align:right;padding:.1rem .6rem}"
)
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

    `head`, `rows`: as of `fdcal.session.study.run.read_results`; `names`: axes along y and x; `at`: values of other
    axes, as text.
    """
    axes = head["axes"]
    for name in names or ():
        if name not in axes:
            raise InputError(f"the study has no axis {name}", f"use {', '.join(axes)}", key="axes", value=name)
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
    text = _page(head, rows, axes, at)
    write_atomically(page, lambda file: file.write_text(text, encoding="utf-8"), True)
    return page


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


MAX_LINES = 200  # of a table


def _points(rows: Any, axes: dict[str, list]) -> tuple[list[str], list[list[str]]]:
    """Return the heads and lines of a table of all points, with 95 % intervals (Wilson)."""
    names = [name for name, values in axes.items() if len(values) > 1]
    lines = []
    part: Any
    for values in itertools.product(*(axes[name] for name in names)):
        part = rows_of(rows, dict(zip(names, values, strict=True)))
        if len(part):
            cells = [f"{1e3 * part[column].median():.3g}" for column in ("rms_error_m", "claimed_sigma_m", "bound_m")]
            shares = [_share(part[column]) for column in ("found", "trusted")]
            lines.append([*map(str, values), str(len(part)), *shares, str(int(part["wrong"].sum())), *cells])
    heads = [*map(label_of, names), "draws", "found (%)", "good (%)", "good and wrong", "error (mm)", "claim (mm)"]
    return [*heads, "bound (mm)"], lines


def _share(flags: Any) -> str:
    from scipy.stats import binomtest

    low, high = binomtest(int(flags.sum()), len(flags)).proportion_ci(method="wilson")
    return f"{100 * flags.mean():.0f} ({100 * low:.0f} to {100 * high:.0f})"


def _wrong(rows: Any, axes: dict[str, list]) -> tuple[list[str], list[list[str]]]:
    """Return the heads and lines of a table of the calibrations that are good and wrong, the largest error first."""
    wrong = rows[rows["wrong"]].sort_values("rms_error_m", ascending=False).to_dict("records")
    lines = [
        [*(str(row[name]) for name in axes), str(row["seed"]), *(f"{1e3 * row[key]:.3g}" for key in COLUMNS[:3])]
        for row in wrong
    ]
    return [*map(label_of, axes), "seed", "error (mm)", "largest (mm)", "claim (mm)"], lines


def _page(head: dict, rows: pandas.DataFrame, axes: dict[str, list], at: dict[str, str]) -> str:
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
    about = "".join(f"<li>{escape(str(line))}</li>" for line in head.get("about", ()))  # older folders do not say
    tables = ""
    for words, (heads, lines) in (
        ("Every point", _points(rows, axes)), ("Good and wrong", _wrong(rows, axes))
    ):  # fmt: skip
        shown = html_table(list(map(escape, heads)), lines[:MAX_LINES], max(0, len(lines) - MAX_LINES))
        tables += f"<h2>{words}</h2>{shown if lines else '<p>None.</p>'}"
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title><style>{STYLE}</style>'
        f"<h1>{title}</h1><p>{summary}</p><ul>{about}</ul>{pictures}{tables}</html>\n"
    )
