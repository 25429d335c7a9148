"""The figures of a study: success over two axes, error beside the bound, error bars, and verdicts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..assessment.study_statistics import quantiles, rows_of, share_grid
from .study_panels import StudyPanels, label_of

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

SMALL = "small"
LONG = 24  # characters of an entry of a legend, above which there are two in a line


def draw_success(rows: pandas.DataFrame, axes: dict, shown: StudyPanels) -> Figure:
    """Return maps of the share of calibrations that found the array, a map for each panel."""
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
