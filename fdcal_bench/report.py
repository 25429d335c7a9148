"""What a study found: its figures as PNG and SVG in one page of HTML, or a page in Markdown.

The page in Markdown says whether error bars and verdicts hold: coverage, rank histograms, verdicts. Simulation-based
calibration (Talts et al., "Validating Bayesian Inference Algorithms with Simulation-Based Calibration", 2018): where
the claim is right, the rank of the truth in what is claimed is uniform, and an ellipse of probability p holds a
fraction p. The microphones of a draw are not independent, so that draws are the clusters of all standard errors.
"""

import itertools
import math
from collections import Counter
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pandas
from matplotlib.figure import Figure
from scipy.stats import binomtest

from fdcal.graphics.figures import figure_bytes
from fdcal.model.storage import parse_text, read_bytes, write_atomically
from fdcal.model.validation import InputError, StorageError

from . import statistics
from .code import CodeVersion
from .run import Head
from .statistics import BINS, COLUMNS, LEVELS
from .study import SCENARIO

MAX_PANELS = 8
MAX_COLUMNS = 4
MIN_WIDTH = 7.5  # inches, of a figure, so that its legend has room
FRAME = 0.8  # inches, for the legend and the name of the x axis
NOISE_AXIS = "snr_db"  # along x unless another is chosen
LABELS = {
    "snr_db": "signal-to-noise ratio (dB)",
    "solver.modes": "frequencies",
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
        """Return a figure, at least `width` x `height` inches for each panel, and its axes with their panels."""
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
LONG = 24  # characters: if an entry of a legend is longer, a line has two entries, otherwise six


def draw_success(rows: pandas.DataFrame, axes: dict, shown: StudyPanels) -> Figure:
    """Return maps of the fraction of calibrations that found the array, a map for each panel."""
    x, y = axes[shown.x], axes.get(shown.y, [""])
    figure, panels = shown.drawn(1.4 + 0.6 * len(x), 1.2 + 0.45 * len(y))
    drawn: Any = None
    for panel, values in panels:
        fraction = statistics.share_grid(statistics.rows_of(rows, values), axes, (shown.y, shown.x), "found")
        drawn = panel.imshow(fraction, vmin=0, vmax=1, cmap="viridis", aspect="auto", origin="lower")
        for (i, j), one in np.ndenumerate(fraction):
            if np.isfinite(one):
                colour = "black" if one > 0.6 else "white"
                panel.text(j, i, f"{100 * one:.0f} %", ha="center", va="center", color=colour, fontsize=SMALL)
        panel.set_yticks(range(len(y)), [str(value) for value in y])
        panel.set_xticks(range(len(x)), [str(value) for value in x])
    _name_axes(figure, shown, label_of(shown.y))
    figure.colorbar(drawn, ax=[panel for panel, _ in panels], label="fraction that found the array")
    return figure


def draw_error(rows: pandas.DataFrame, axes: dict, shown: StudyPanels) -> Figure:
    """Return the median error along the x axis beside the bound, a line for each value of the y axis."""
    figure, panels = shown.drawn(2.6, 2.6)
    places = np.arange(len(axes[shown.x]))
    for panel, values in panels:
        for number, value in enumerate(axes.get(shown.y, [""])):
            part = statistics.rows_of(rows, values | ({shown.y: value} if shown.y else {}))
            low, middle, high = 1e3 * statistics.quantiles(part, axes, shown.x, "rms_error_m").T
            bound = 1e3 * statistics.quantiles(part, axes, shown.x, "bound_m", (0.5,))[:, 0]
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
        inside = statistics.rows_of(known, values)
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
    """Return bars of how often verdicts were right and wrong, good and not good, along the x axis."""
    figure, panels = shown.drawn(2.6, 2.4)
    kinds = (
        ("good", "good, and true", "tab:green"),
        ("doubted", "not good, though the array was found", "tab:olive"),
        ("lost", "not good, and the array was not found", "tab:grey"),
        ("wrong", "good, and wrong", "tab:red"),
    )
    for panel, values in panels:
        part, base = statistics.rows_of(rows, values), np.zeros(len(axes[shown.x]))
        for column, text, colour in kinds:
            fraction = np.nan_to_num(statistics.share_grid(part, axes, (shown.x, ""), column)[:, 0])
            panel.bar(range(len(base)), 100 * fraction, bottom=100 * base, color=colour, label=text)
            base = base + fraction
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
CAPTIONS = {
    "success": "An array counts as found where the error is below 5 mm, or three times the Cramer-Rao bound.",
    "error": "Median error of the microphones that are sought, 10 to 90 % shaded; dashed the bound in a diffuse field.",
    "error-bars": "Error against the one sigma that each calibration claims.",
    "verdicts": "Right and wrong verdicts; good and wrong: an error above 5 mm and three claimed sigmas, or that"
    " of one microphone above 10 mm and five.",
}


def write_report(
    folder: str | Path, head: Head, rows: pandas.DataFrame, names: tuple[str, str] | None, at: dict[str, str]
) -> Path:
    """Write the report of a study into the folder `report` inside its folder, and return its page.

    `head`, `rows`: from `read_results`; `names`: axes along y and x; `at`: values of other axes, as text.
    """
    axes = head.axes
    for name in names or ():
        if name not in axes:
            raise InputError(f"the study has no axis {name}", f"use {', '.join(axes)}", key="axes")
    rows = statistics.classified(statistics.selected(rows, axes, at))
    if not len(rows):
        raise InputError("no calibration of the study has these values", "leave out --at", key="at")
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
    """Return a sentence that names the code of the rows of a study, or each code and the number of its rows."""
    codes = [tuple(code) for code in rows[["version", "source", "commit"]].itertuples(index=False)]
    counts = Counter(str(CodeVersion(v, source, c if isinstance(c, str) else None)) for v, source, c in codes)
    if len(counts) == 1:
        return f"Computed by {next(iter(counts))}."
    return f"Computed by different code: {'; '.join(f'{count} by {text}' for text, count in counts.most_common())}."


MAX_LINES = 200  # largest number of lines of a table


def _points(rows: Any, axes: dict[str, list]) -> tuple[list[str], list[list[str]]]:
    """Return the heads and lines of a table of all points, with 95 % intervals (Wilson)."""
    names = [name for name, values in axes.items() if len(values) > 1]
    lines = []
    part: Any
    for values in itertools.product(*(axes[name] for name in names)):
        part = statistics.rows_of(rows, dict(zip(names, values, strict=True)))
        if len(part):
            cells = [f"{1e3 * part[column].median():.3g}" for column in ("rms_error_m", "claimed_sigma_m", "bound_m")]
            shares = [_share(part[column]) for column in ("found", "trusted")]
            lines.append([*map(str, values), str(len(part)), *shares, str(int(part["wrong"].sum())), *cells])
    heads = [*map(label_of, names), "draws", "found (%)", "good (%)", "good and wrong", "error (mm)", "claim (mm)"]
    return [*heads, "bound (mm)"], lines


def _share(flags: Any) -> str:
    low, high = binomtest(int(flags.sum()), len(flags)).proportion_ci(method="wilson")
    return f"{100 * flags.mean():.0f} ({100 * low:.0f} to {100 * high:.0f})"


def _wrong(rows: Any, axes: dict[str, list]) -> tuple[list[str], list[list[str]]]:
    """Return the heads and lines of a table of the calibrations that are good and wrong, the largest error first."""
    wrong = rows[rows["wrong"]].sort_values("rms_error_m", ascending=False).to_dict("records")
    lines = [
        [
            *(str(row[name]) for name in axes),
            str(row["seed"]),
            *(f"{1e3 * row[key]:.3g}" for key in COLUMNS[:3]),
        ]
        for row in wrong
    ]
    return [*map(label_of, axes), "seed", "error (mm)", "largest (mm)", "claim (mm)"], lines


def _page(head: Head, rows: pandas.DataFrame, axes: dict[str, list], at: dict[str, str]) -> str:
    where = "".join(f", {escape(key)} = {escape(value)}" for key, value in at.items())
    summary = (
        f"{len(rows)} of {head.count} calibrations{where}: the array found in {rows['found'].mean():.1%}, verdict"
        f" good in {rows['trusted'].mean():.1%}, good and wrong in {rows['wrong'].mean():.2%};"
        f" {rows['seconds'].median():.2g} s of processor time each (median). {escape(code_text(rows))}"
    )
    pictures = "".join(
        f'<h2>{escape(name.replace("-", " ").capitalize())}</h2><p>{escape(text)}</p><a href="{name}.svg">'
        f'<img src="{name}.png" alt="{escape(text)}"></a>'
        for name, text in CAPTIONS.items()
    )
    about = "".join(f"<li>{escape(str(line))}</li>" for line in head.about)
    tables = ""
    for words, (heads, lines) in (
        ("Every point", _points(rows, axes)), ("Good and wrong", _wrong(rows, axes))
    ):  # fmt: skip
        names = "".join(f"<th>{escape(text)}</th>" for text in heads)
        body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in lines[:MAX_LINES])
        if len(lines) > MAX_LINES:
            body += f'<tr><td colspan="{len(heads)}">and {len(lines) - MAX_LINES} more</td></tr>'
        shown = f"<table><thead><tr>{names}</tr></thead><tbody>{body}</tbody></table>" if lines else "<p>None.</p>"
        tables += f"<h2>{words}</h2>{shown}"
    title = escape(str(head.title))
    top = f'<meta charset="utf-8"><title>{title}</title><style>{STYLE}</style>'
    body = f"<h1>{title}</h1><p>{summary}</p><ul>{about}</ul>{pictures}{tables}"
    return f'<!doctype html><html lang="en">{top}{body}</html>\n'


RANK_COLUMNS = 5  # panels in a row of the figure
BAND = 2.0  # standard errors, half width of a band
KEPT = (  # columns of the data file
    "draw seed source verdict rms_error_m claimed_sigma_m bound_m judged inside ranks error_m2 claimed_m2 worst_sigmas"
    " sound accused faults named right_given wrongly_doubted wrong_given doubted_given"
).split()

HEAD = """# {title}

How often is the true position inside the ellipse that is claimed, and how often is a verdict wrong? `{name}`
answers for {scenarios} scenarios: each draw has its own room, array, source, noise, channels and given positions, and
is calibrated with the solver's own settings. {count} draws, {least} to {most} of each scenario, of {planned} that are
planned; seeds {first} to {last}. {code}

This page is written by

```sh
{commands}
```

from the rows in [{stem}.csv]({stem}.csv).
{about}

## Error bars

Of the draws with the verdict `good`: the fraction of microphones inside the ellipse of each probability, with one
standard error (the draws are independent, the microphones of one are not), and the median over the draws of the mean
squared error over the claimed variance (1 is right; more: the claim is too narrow). Only microphones that are sought
and whose channels have no fault are counted. One sigma of a position is the root of the trace of its covariance.

| scenario | good | error mm | claim mm | error over claim | {levels} |
|---|---|---|---|---|{rules}|
"""
FIGURE = """
```{{image}} pictures/{stem}.png
:alt: Rank histograms of the coordinates in every scenario, with bands
```

Ranks of the true coordinates in what is claimed, of the same draws, in {bins} bins; the band is two standard errors
about the uniform distribution. A hill shows that the claim is too wide, a valley that it is too narrow, a slope that
there is a bias.

## Verdicts

An array is *right* where its error (root mean square) is below 5 mm, or three times the Cramer-Rao bound of a diffuse
field. *Good and wrong*: the verdict is `good`, and the error is above 5 mm and three claimed sigmas, or that of one
microphone above 10 mm and five. *Accused*: healthy channels that are named as faulty, and given positions that are
right (to the error of the tape) and named as wrong. *Named*: channels with a fault, and wrong given positions, that are
named. *Refused*: draws that fdcal refuses to calibrate, with the reason; they are neither right nor wrong.

| scenario | draws | refused | right | right and good | good | good and wrong | accused | named |
|---|---|---|---|---|---|---|---|---|
"""


WRONG = """
| scenario | seed | error mm | claim mm | the worst microphone, sigma | why |
|---|---|---|---|---|---|
"""
UNEXPLAINED = "not examined yet"


def calibration_page(head: Head, rows: Any, name: str, stem: str, commands: str, cases: dict | None = None) -> str:
    """Return the page of a study's file `name`; `rows`: from `read_results`; `stem`: that of the page's file name.

    `cases`: why draws are good and wrong: "cases", each with "scenario", "seed" and "why", and a "text" on all.
    """
    every, rows = rows, _scored(rows)
    names = [value for value in head.axes[SCENARIO] if np.any(every[SCENARIO] == value)]
    counts = every.groupby(SCENARIO).size()
    text = HEAD.format(
        title=head.title,
        name=name,
        commands=commands,
        stem=stem,
        scenarios=len(names),
        count=len(every),
        least=counts.min(),
        most=counts.max(),
        planned=head.count,
        first=every["seed"].min(),
        last=every["seed"].max(),
        code=code_text(rows),
        levels=" | ".join(f"{100 * level:.0f} %" for level in LEVELS),
        rules="---|" * (len(LEVELS) - 1) + "---",
        about="".join(f"\n- {line}" for line in head.about),
    )
    parts = [(value, rows[rows[SCENARIO] == value]) for value in names]
    text += "".join(_bars_line(value, part) for value, part in (*parts, ("all", rows)))
    text += FIGURE.format(stem=stem, bins=BINS)
    planned = dict(counts) | {"all": len(every)}
    text += "".join(_verdict_line(value, part, planned[value]) for value, part in (*parts, ("all", rows)))
    refused, wrong = every.drop(rows.index), rows[rows["wrong"]]
    text += f"\nRefused: {len(refused)} of {len(every)} draws{':' if len(refused) else '.'}\n"
    for row in refused.to_dict("records"):
        text += f"\n- {row[SCENARIO]}, seed {row['seed']}: {row['reason']}"
    text += "\n" * bool(len(refused))
    text += f"\nGood and wrong: {len(wrong)} of {len(every)} draws{':' if len(wrong) else '.'}\n"
    if len(wrong):
        why = {(one["scenario"], one["seed"]): one["why"] for one in (cases or {}).get("cases", ())}
        text += WRONG
        for row in wrong.to_dict("records"):
            sizes = f"{1e3 * row['rms_error_m']:.2g} | {1e3 * row['claimed_sigma_m']:.2g} | {row['worst_sigmas']:.1f}"
            reason = why.get((row[SCENARIO], row["seed"]), UNEXPLAINED)
            text += f"| {row[SCENARIO]} | {row['seed']} | {sizes} | {reason} |\n"
        text += f"\n{(cases or {}).get('text', '')}"
    return text.rstrip("\n") + "\n"


def _scored(rows: Any) -> Any:
    """Return the classified rows that have scores; refused draws have none."""
    if "inside" not in rows or not rows["inside"].notna().any():
        problem = "the rows of this study have no figures of coverage"
        raise InputError(problem, "run it again with this fdcal", key="report")
    return statistics.classified(rows[rows["inside"].notna()])


def _bars_line(name: str, part: Any) -> str:
    good = part[part["trusted"] & (part["judged"] > 0)]
    if not len(good):
        return f"| {name} | 0 |" + " |" * (3 + len(LEVELS)) + "\n"
    fraction, error = statistics.clustered(statistics.json_columns(good, "inside"), good["judged"].to_numpy(float))
    cells = " | ".join(f"{100 * p:.1f} ± {100 * e:.1f}" for p, e in zip(fraction, error, strict=True))
    ratio = (good["error_m2"] / good["claimed_m2"]).median()
    sizes = " | ".join(f"{1e3 * np.sqrt(good[column].median()):.2g}" for column in ("error_m2", "claimed_m2"))
    return f"| {name} | {len(good)} | {sizes} | {ratio:.2f} | {cells} |\n"


def _verdict_line(name: str, part: Any, draws: int) -> str:
    right = part["found"]
    accused, healthy = part["accused"] + part["wrongly_doubted"], part["sound"] + part["right_given"]
    named, faults = part["named"] + part["doubted_given"], part["faults"] + part["wrong_given"]
    return (
        f"| {name} | {draws} | {draws - len(part)} | {right.sum()} | {(right & part['trusted']).sum()} |"
        f" {part['trusted'].sum()} | {part['wrong'].sum()} | {accused.sum():.0f} of {healthy.sum():.0f} |"
        f" {f'{named.sum():.0f} of {faults.sum():.0f}' if faults.sum() else ''} |\n"
    )


def draw_ranks(head: Head, rows: Any) -> Figure:
    """Return the rank histograms of the good draws of every scenario, with bands, and the coverage of all of them."""
    rows = _scored(rows)
    good = rows[rows["trusted"] & (rows["judged"] > 0)]
    names = [value for value in head.axes[SCENARIO] if np.any(good[SCENARIO] == value)]
    lines = -(-(len(names) + 1) // RANK_COLUMNS)
    figure = Figure(figsize=(2.2 * RANK_COLUMNS, 1.5 * lines), dpi=80)
    figure.set_layout_engine("constrained")
    cells: list[Any] = list(figure.subplots(lines, RANK_COLUMNS, squeeze=False).flat)
    for cell in cells[len(names) + 1 :]:
        cell.set_visible(False)
    fraction, error = statistics.clustered(statistics.json_columns(good, "inside"), good["judged"].to_numpy(float))
    cells[0].plot([0, 1], [0, 1], color="grey", linewidth=0.8)
    cells[0].errorbar(LEVELS, fraction, BAND * error, fmt="o", markersize=3)
    cells[0].set_title("coverage, all scenarios", fontsize=7)
    edges = np.linspace(0, 1, BINS + 1)
    for cell, name in zip(cells[1:], names, strict=False):
        counts = statistics.json_columns(good[good[SCENARIO] == name], "ranks")
        fraction, error = statistics.clustered(counts, counts.sum(axis=1))
        cell.stairs(BINS * fraction, edges, fill=True, color="tab:blue", alpha=0.7)
        band = BAND * BINS * np.append(error, error[-1])
        cell.fill_between(edges, 1 - band, 1 + band, step="post", color="grey", alpha=0.4)
        cell.axhline(1, color="black", linewidth=0.6)
        cell.set_ylim(0, 3)
        cell.set_title(f"{name} ({len(counts)})", fontsize=7)
    for cell in cells:
        cell.tick_params(labelsize=6)
    return figure


def write_page(page: Path, head: Head, rows: Any, folder: str, commands: str) -> None:
    """Write the page of a study of scenarios, its rows as CSV beside it, and its figure into a folder `pictures`.

    `folder` has the results; `commands`: how the page is made, with the names study, folder and page in braces. Why a
    draw is good and wrong cannot be computed: this is read from a file beside the page that ends in .cases.toml.
    """
    commands = commands.format(study="STUDY.toml", folder=folder, page=page)
    written = page.with_suffix(".cases.toml")
    cases = parse_text(read_bytes(written), "TOML", written) if written.exists() else None
    text = calibration_page(head, rows, str(head.title), page.stem, commands, cases)
    picture = figure_bytes(draw_ranks(head, rows), "png")
    table = rows[[SCENARIO, *KEPT]].sort_values(["draw", SCENARIO]).to_csv(index=False, float_format="%.4g")
    figures = page.resolve().parent / "pictures"
    try:
        figures.mkdir(exist_ok=True)
    except OSError as error:
        raise StorageError(f"cannot make the folder {figures}: {error.strerror}") from error
    write_atomically(page, lambda file: file.write_text(text, encoding="utf-8"), True)
    write_atomically(page.with_suffix(".csv"), lambda file: file.write_text(table, encoding="utf-8"), True)
    write_atomically(figures / f"{page.stem}.png", lambda file: file.write_bytes(picture), True)
