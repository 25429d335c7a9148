"""Figs. 2 to 5 of the paper in its layout, from given runs."""

import numpy as np

from .study import PRINTED, Array, Trail, title_of

BLACK, RED, BLUE, GREY = "#000000", "#d61828", "#005ab5", "#8a8f98"
PANEL = 4.6, 3.9  # inches, width and height of the panel of one array


def _panels(count: int, height: float = PANEL[1]):
    """Return a figure with one panel per array, side by side."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(PANEL[0] * count, height), dpi=120, layout="constrained")
    return figure, figure.subplots(1, count, squeeze=False)[0]


def iteration_of(array: Array, run: Trail) -> int:
    """Return the sweep that Fig. 2 shows: the paper's, or half of a run that is shorter or of another array."""
    printed = PRINTED.get(array.name)
    return printed.iteration if printed and printed.iteration <= run.sweeps else (run.sweeps + 1) // 2


def draw_states(arrays: list[Array], runs: list[Trail]):
    """Return Fig. 2: the positions during a run of solver descent."""
    figure, axes = _panels(len(arrays), 4.6)
    for panel, array, run in zip(axes, arrays, runs, strict=True):
        sweep, truth, known = iteration_of(array, run), array.truth, array.problem.known
        panel.plot(*truth.T, "o", color=BLACK, fillstyle="none", markersize=7, label="true")
        panel.plot(*run.positions[sweep].T, "x", color=RED, markersize=6, markeredgewidth=1.4, label="estimated")
        panel.plot(*truth[known].T, "s", color=BLUE, fillstyle="none", markersize=11, label="known")
        panel.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
        error = 1e3 * run.errors(truth)[sweep].mean()
        panel.set_title(f"{title_of(array.name)}: iteration {sweep} of {run.sweeps}, mean error {error:.0f} mm")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure


def draw_iterations(arrays: list[Array], runs: list[Trail]):
    """Return Fig. 3: mean error after every sweep, with a dashed line where a mode is added."""
    figure, axes = _panels(len(arrays))
    for panel, array, run in zip(axes, arrays, runs, strict=True):
        added = np.flatnonzero(np.diff(run.modes)) + 0.5
        panel.vlines(added, 0, 1, transform=panel.get_xaxis_transform(), color=RED, linestyles="--", linewidth=0.4)
        panel.plot(run.errors(array.truth).mean(axis=1), color=BLACK, linewidth=1.5)
        panel.set(xlabel="iteration", ylabel="mean error (m)", ylim=(0, None), xlim=(0, run.sweeps))
        panel.set_title(f"{title_of(array.name)}: descent, modes {run.modes[0]} to {run.modes[-1]}")
    return figure


def draw_modes(arrays: list[Array], runs: list[Trail], joint: list[tuple[list[int], list[float]]]):
    """Return Fig. 4: mean error at the end of solver descent with each number of modes, and that of solver joint."""
    figure, axes = _panels(len(arrays), 4.3)
    for panel, array, run, (numbers, errors) in zip(axes, arrays, runs, joint, strict=True):
        modes = np.unique(run.modes)
        means = run.errors(array.truth).mean(axis=1)
        panel.plot(modes, [means[run.end_of(M)] for M in modes], color=BLACK, label="descent")
        panel.plot(numbers, errors, "o", color=BLUE, markersize=5, clip_on=False, zorder=3, label="joint")
        printed = PRINTED.get(array.name)
        if printed is not None:
            panel.plot(printed.modes, 0, "*", color=RED, markersize=13, clip_on=False, zorder=4, label="paper: exact")
        panel.set(xlabel="number of modes", ylabel="mean error (m)", ylim=(0, None))
        panel.set_title(title_of(array.name))
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure


def reference_of(array: Array) -> int:
    """Return the known microphone furthest from the centre of the array: at a corner of it, as in the paper."""
    truth = array.truth
    known = array.problem.known
    return int(known[np.argmax(np.linalg.norm(truth[known] - truth.mean(axis=0), axis=1))])


def draw_distances(array: Array, run: Trail):
    """Return Fig. 5: mean error of each microphone before the last sweep ends, over its distance to the reference."""
    figure, (panel,) = _panels(1)
    truth, reference = array.truth, reference_of(array)
    free, distance = array.problem.free, np.linalg.norm(truth - truth[reference], axis=1)
    mean = run.errors(truth)[:-1].mean(axis=0)
    panel.plot(distance[free], mean[free], "x", color=BLACK, label="unknown")
    panel.plot(distance[array.problem.known], mean[array.problem.known], "s", color=BLUE, clip_on=False, label="known")
    panel.set(xlabel=f"distance to microphone {reference} (m)", ylabel="mean error (m)", ylim=(0, None))
    panel.set_title(f"{title_of(array.name)}: mean of {run.sweeps} iterations")
    panel.legend(frameon=False)
    return figure
