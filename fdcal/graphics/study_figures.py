"""The figures of a study: success over two axes, error beside the bound, error bars, and verdicts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..assessment.study_statistics import quantiles, share_grid

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

SMALL = "small"


def draw_success(rows: pandas.DataFrame, axes: dict, names: tuple[str, str]) -> Figure:
    """Return a map of the share of calibrations that found the array, over two axes."""
    from matplotlib.figure import Figure

    grid = share_grid(rows, axes, names, "found")
    height, width = grid.share.shape
    figure = Figure(figsize=(2.6 + 0.9 * width, 1.8 + 0.6 * height), dpi=100, layout="constrained")
    panel: Any = figure.subplots()
    drawn = panel.imshow(grid.share, vmin=0, vmax=1, cmap="viridis", aspect="auto", origin="lower")
    for (i, j), share in np.ndenumerate(grid.share):
        if np.isfinite(share):
            colour = "black" if share > 0.6 else "white"
            panel.text(j, i, f"{100 * share:.0f} %", ha="center", va="center", color=colour, fontsize=SMALL)
    panel.set_yticks(range(height), [str(value) for value in grid.values[0]])
    panel.set_xticks(range(width), [str(value) for value in grid.values[1]])
    panel.set_ylabel(label_of(names[0]))
    panel.set_xlabel(label_of(names[1]))
    panel.set_title("Share of calibrations that found the array")
    figure.colorbar(drawn, ax=panel)
    return figure


def draw_error(rows: pandas.DataFrame, axes: dict, names: tuple[str, str]) -> Figure:
    """Return the median error against the second axis, a line for each value of the first, beside the bound."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 5), dpi=100, layout="constrained")
    panel: Any = figure.subplots()
    lines, x_name = (axes.get(names[0], [""]), names[1]) if names[1] else ([""], names[0])
    x = np.arange(len(axes[x_name]))
    for number, value in enumerate(lines):
        part: Any = rows if value == "" else rows[rows[names[0]].astype(str) == str(value)]
        low, middle, high = 1e3 * quantiles(part, axes, x_name, "rms_error_m").T
        colour = f"C{number % 10}"
        label = "error, median" if value == "" else f"{label_of(names[0])} {value}"
        panel.plot(x, middle, "o-", color=colour, label=label)
        panel.fill_between(x, low, high, color=colour, alpha=0.15)
        bound = 1e3 * quantiles(part, axes, x_name, "bound_m", (0.5,))[:, 0]
        panel.plot(x, bound, "--", color=colour)
    panel.plot([], [], "--", color="grey", label="Cramer-Rao bound")
    panel.set_yscale("log")
    panel.set_xticks(x, [str(value) for value in axes[x_name]])
    panel.set_xlabel(label_of(x_name))
    panel.set_ylabel("error (mm rms); shaded 10 to 90 %")
    panel.grid(alpha=0.3)
    panel.legend(fontsize=SMALL)
    return figure


def draw_error_bars(rows: pandas.DataFrame) -> Figure:
    """Return the error of every calibration against the one sigma that it claims."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 5.5), dpi=100, layout="constrained")
    panel: Any = figure.subplots()
    known = rows.dropna(subset=["claimed_sigma_m", "rms_error_m"])
    for trusted, mark, name in ((True, ".", "verdict good"), (False, "x", "another verdict")):
        part = known[known["trusted"] == trusted]
        panel.loglog(1e3 * part["claimed_sigma_m"], 1e3 * part["rms_error_m"], mark, alpha=0.4, label=name)
    if len(known):
        ends = 1e3 * np.array([known["claimed_sigma_m"].min(), known["claimed_sigma_m"].max()])
        panel.loglog(ends, ends, "k-", linewidth=1, label="error as claimed")
        panel.loglog(ends, 3 * ends, "k:", linewidth=1, label="three times that")
    panel.set_xlabel("claimed one sigma (mm rms)")
    panel.set_ylabel("error (mm rms)")
    panel.grid(alpha=0.3)
    panel.legend(fontsize=SMALL)
    return figure


def draw_verdicts(rows: pandas.DataFrame, axes: dict, name: str) -> Figure:
    """Return bars of how often the verdict was right or wrong either way, along one axis."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 4.5), dpi=100, layout="constrained")
    panel: Any = figure.subplots()
    rows = rows.assign(
        good=rows["trusted"] & ~rows["wrong"],
        doubted=~rows["trusted"] & rows["found"],
        lost=~rows["trusted"] & ~rows["found"],
    )
    kinds = (
        ("good", "good, and true", "tab:green"),
        ("doubted", "not good, though the array was found", "tab:olive"),
        ("lost", "not good, and the array was not found", "tab:grey"),
        ("wrong", "good, and wrong", "tab:red"),
    )
    base = np.zeros(len(axes[name]))
    for column, text, colour in kinds:
        share = np.nan_to_num(share_grid(rows, axes, (name, ""), column).share[:, 0])
        panel.bar(range(len(base)), 100 * share, bottom=100 * base, color=colour, label=text)
        base = base + share
    panel.set_xticks(range(len(base)), [str(value) for value in axes[name]])
    panel.set_xlabel(label_of(name))
    panel.set_ylabel("calibrations (%)")
    figure.legend(fontsize=SMALL, loc="outside lower center", ncols=2)
    return figure


LABELS = {
    "snr_db": "signal-to-noise ratio (dB)",
    "solver.modes": "modes",
    "solver.name": "solver",
    "faults.gain_db": "channel gains, standard deviation (dB)",
    "radius": "radius of the array (m)",
    "source.duration": "recording (s)",
}


def label_of(name: str) -> str:
    """Return what an axis of a study is called in a figure."""
    return LABELS.get(name, name.replace("_", " "))
