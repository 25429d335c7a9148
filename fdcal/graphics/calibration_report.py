"""Whether error bars and verdicts hold, as a page in Markdown with one figure: coverage, rank histograms, verdicts.

Simulation-based calibration (Talts et al., "Validating Bayesian Inference Algorithms with Simulation-Based
Calibration", 2018): where the claim is right, the rank of the truth in what is claimed is uniform, and an ellipse of
probability p holds a fraction p. The microphones of a draw are not independent, so that draws are the clusters of all
standard errors.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..assessment.study_statistics import BINS, LEVELS, clustered, json_columns, judged
from ..model.reading import parse_toml, read_bytes
from ..model.storage import write_atomically
from ..model.validation import InputError
from .landscape import figure_bytes
from .study_report import code_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = 5  # panels in a row of the figure
BAND = 2.0  # standard errors, half width of a band
KEPT = (  # columns of the data file
    "draw seed source verdict rms_error_m claimed_sigma_m bound_m judged inside ranks error_m2 claimed_m2 worst_sigmas"
    " sound accused faults named right_given wrongly_doubted wrong_given doubted_given"
).split()

HEAD = """# {title}

How often is the true position inside the ellipse that is claimed, and how often is a verdict wrong? `{name}`
answers for {settings} settings: each draw has its own room, array, source, noise, channels and given positions, and is
calibrated with the solver's own settings. {count} draws, {least} to {most} of each setting, of {planned} that are
planned; seeds {first} to {last}. {code}

This page is written by

```sh
{commands}
```

from the rows in [{stem}.csv]({stem}.csv). [Uncertainty](uncertainty.md) says how the covariance is computed.
{about}

## Error bars

Of the draws with the verdict `good`: the fraction of microphones inside the ellipse of each probability, with one
standard error (the draws are independent, the microphones of one are not), and the median over the draws of the mean
squared error over the claimed variance (1 is right; more: the claim is too narrow). Microphones count that are sought
and whose channels have no fault. One sigma of a position is the root of the trace of its covariance.

| setting | good | error mm | claim mm | error over claim | {levels} |
|---|---|---|---|---|{rules}|
"""
FIGURE = """
```{{image}} ../pictures/{stem}.png
:alt: Rank histograms of the coordinates in every setting, with bands
```

Ranks of the true coordinates in what is claimed, of the same draws, in {bins} bins; the band is two standard errors
about the uniform distribution. A hill says that the claim is too wide, a valley that it is too narrow, a slope that
there is a bias.

## Verdicts

An array is *right* where its error (root mean square) is below 5 mm, or three times the Cramer-Rao bound of a diffuse
field. *Good and wrong*: the verdict is `good`, and the error is above 5 mm and three claimed sigmas, or that of one
microphone above 10 mm and five. *Accused*: sound channels that are named as faulty, and given positions that are
right (to the error of the tape) and named as wrong. *Found*: channels with a fault, and wrong given positions, that are
named. *Refused*: draws that are not calibrated, but for a reason that is said; they are neither right nor wrong.

| setting | draws | refused | right | right and good | good | good and wrong | accused | found |
|---|---|---|---|---|---|---|---|---|
"""


def calibration_page(head: dict, rows: Any, name: str, stem: str, commands: str, cases: dict | None = None) -> str:
    """Return the page of a study's file `name`; `rows` as of `read_results`, `stem`: of the page's file name.

    `cases`: why draws are good and wrong: "cases", each with "setting", "seed" and "why", and a "text" on them all.
    """
    every, rows, key = rows, _scored(rows), next(iter(head["axes"]))
    names = [value for value in head["axes"][key] if np.any(every[key] == value)]
    counts = every.groupby(key).size()
    text = HEAD.format(
        title=head["title"],
        name=name,
        commands=commands,
        stem=stem,
        settings=len(names),
        count=len(every),
        least=counts.min(),
        most=counts.max(),
        planned=head["count"],
        first=every["seed"].min(),
        last=every["seed"].max(),
        code=code_text(rows),
        levels=" | ".join(f"{100 * level:.0f} %" for level in LEVELS),
        rules="---|" * (len(LEVELS) - 1) + "---",
        about="".join(f"\n- {line}" for line in head.get("about", ())),
    )
    parts = [(value, rows[rows[key] == value]) for value in names]
    text += "".join(_bars_line(value, part) for value, part in (*parts, ("all", rows)))
    text += FIGURE.format(stem=stem, bins=BINS)
    planned = dict(counts) | {"all": len(every)}
    text += "".join(_verdict_line(value, part, planned[value]) for value, part in (*parts, ("all", rows)))
    refused, wrong = every.drop(rows.index), rows[rows["wrong"]]
    text += _counted("Refused", len(refused), len(every))
    for row in refused.to_dict("records"):
        text += f"\n- {row[key]}, seed {row['seed']}: {row['reason']}"
    text += "\n" * bool(len(refused)) + _counted("Good and wrong", len(wrong), len(every))
    text += _one_by_one(wrong, key, cases or {}) if len(wrong) else ""
    return text.rstrip("\n") + "\n"


WRONG = """
| setting | seed | error mm | claim mm | the worst microphone, sigma | why |
|---|---|---|---|---|---|
"""
UNEXPLAINED = "not examined yet"


def _one_by_one(wrong: Any, key: str, cases: dict) -> str:
    """The table of the draws that are good and wrong, with why each is, and what the `cases` have in common."""
    why = {(one["setting"], one["seed"]): one["why"] for one in cases.get("cases", ())}
    text = WRONG
    for row in wrong.to_dict("records"):
        text += (
            f"| {row[key]} | {row['seed']} | {1e3 * row['rms_error_m']:.2g} | {1e3 * row['claimed_sigma_m']:.2g} |"
            f" {row['worst_sigmas']:.1f} | {why.get((row[key], row['seed']), UNEXPLAINED)} |\n"
        )
    return f"{text}\n{cases.get('text', '')}"


def _counted(what: str, count: int, draws: int) -> str:
    return f"\n{what}: {count} of {draws} draws{':' if count else '.'}\n"


def _scored(rows: Any) -> Any:
    """Rows that are judged; refused draws have no scores."""
    if "inside" not in rows or not rows["inside"].notna().any():
        problem = "the rows of this study say nothing of coverage"
        raise InputError(problem, "run it again with this fdcal", key="report")
    return judged(rows[rows["inside"].notna()])


def _bars_line(name: str, part: Any) -> str:
    good = part[part["trusted"] & (part["judged"] > 0)]
    if not len(good):
        return f"| {name} | 0 |" + " |" * (3 + len(LEVELS)) + "\n"
    share, error = clustered(json_columns(good, "inside"), good["judged"].to_numpy(float))
    cells = " | ".join(f"{100 * p:.1f} ± {100 * e:.1f}" for p, e in zip(share, error, strict=True))
    ratio = (good["error_m2"] / good["claimed_m2"]).median()
    sizes = " | ".join(f"{1e3 * np.sqrt(good[column].median()):.2g}" for column in ("error_m2", "claimed_m2"))
    return f"| {name} | {len(good)} | {sizes} | {ratio:.2f} | {cells} |\n"


def _verdict_line(name: str, part: Any, draws: int) -> str:
    right = part["found"]
    accused, sound = (part[[a, b]].to_numpy(float).sum() for a, b in (ACCUSED, SOUND))
    named, faults = (part[[a, b]].to_numpy(float).sum() for a, b in (NAMED, FAULTS))
    return (
        f"| {name} | {draws} | {draws - len(part)} | {right.sum()} | {(right & part['trusted']).sum()} |"
        f" {part['trusted'].sum()} | {part['wrong'].sum()} | {accused:.0f} of {sound:.0f} |"
        f" {f'{named:.0f} of {faults:.0f}' if faults else ''} |\n"
    )


ACCUSED, SOUND = ("accused", "wrongly_doubted"), ("sound", "right_given")
NAMED, FAULTS = ("named", "doubted_given"), ("faults", "wrong_given")


def draw_ranks(head: dict, rows: Any) -> Figure:
    """Return the rank histograms of the good draws of every setting, with bands, and the coverage of all of them."""
    from matplotlib.figure import Figure

    rows, key = _scored(rows), next(iter(head["axes"]))
    good = rows[rows["trusted"] & (rows["judged"] > 0)]
    names = [value for value in head["axes"][key] if np.any(good[key] == value)]
    lines = -(-(len(names) + 1) // COLUMNS)
    figure = Figure(figsize=(2.2 * COLUMNS, 1.5 * lines), dpi=80)
    figure.set_layout_engine("constrained")
    cells: list[Any] = list(figure.subplots(lines, COLUMNS, squeeze=False).flat)
    for cell in cells[len(names) + 1 :]:
        cell.set_visible(False)
    share, error = clustered(json_columns(good, "inside"), good["judged"].to_numpy(float))
    cells[0].plot([0, 1], [0, 1], color="grey", linewidth=0.8)
    cells[0].errorbar(LEVELS, share, BAND * error, fmt="o", markersize=3)
    cells[0].set_title("coverage, all settings", fontsize=7)
    edges = np.linspace(0, 1, BINS + 1)
    for cell, name in zip(cells[1:], names, strict=False):
        counts = json_columns(good[good[key] == name], "ranks")
        share, error = clustered(counts, counts.sum(axis=1))
        cell.stairs(BINS * share, edges, fill=True, color="tab:blue", alpha=0.7)
        cell.fill_between(edges, *(1 + sign * BAND * BINS * _stepped(error) for sign in (-1, 1)), step="post",
                          color="grey", alpha=0.4)  # fmt: skip
        cell.axhline(1, color="black", linewidth=0.6)
        cell.set_ylim(0, 3)
        cell.set_title(f"{name} ({len(counts)})", fontsize=7)
    for cell in cells:
        cell.tick_params(labelsize=6)
    return figure


def _stepped(values: np.ndarray) -> np.ndarray:
    return np.append(values, values[-1])


def write_page(page: Path, head: dict, rows: Any, name: str, commands: str) -> None:
    """Write the page, its rows as CSV beside it, and its figure into the folder `pictures` beside that of the page.

    Why a draw is good and wrong nobody can compute: the page takes it from a file beside it that ends in .cases.toml.
    """
    pictures = page.resolve().parent.parent / "pictures"
    if not pictures.is_dir():
        problem = f"{page} has no folder pictures beside its own"
        raise InputError(problem, "give a page in a folder of the documentation", key="page", value=str(page))
    written = page.with_suffix(".cases.toml")
    cases = parse_toml(read_bytes(written), written) if written.exists() else None
    text, key = calibration_page(head, rows, name, page.stem, commands, cases), next(iter(head["axes"]))
    picture = figure_bytes(draw_ranks(head, rows), "png")
    table = rows[[key, *KEPT]].sort_values(["draw", key]).to_csv(index=False, float_format="%.4g")
    write_atomically(page, lambda file: file.write_text(text, encoding="utf-8"), True)
    write_atomically(page.with_suffix(".csv"), lambda file: file.write_text(table, encoding="utf-8"), True)
    write_atomically(pictures / f"{page.stem}.png", lambda file: file.write_bytes(picture), True)
