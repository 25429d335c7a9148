"""A calibration for a notebook: as a figure, as HTML, and as a page that plays."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape
from itertools import takewhile

import numpy as np
from matplotlib.figure import Figure

from ..assessment.calibration import Calibration
from ..assessment.uncertainty import confidence_factor, ellipse_axes
from ..assessment.words import result_title
from ..cost.eq7 import reference_cost_of
from ..model.gauge import align
from ..model.settings import search_around
from ..model.validation import InputError
from .landscape import figure_bytes
from .marks import ELLIPSE, plot_marks
from .overlays import enlargement
from .primitives import fractions
from .replay import replay_html

SIDES = 60  # of the polygon that is drawn for an ellipse
MARK_SCALE = 2 / 3  # of marks, of those on a map: there are many


def draw_calibration(self: Calibration, truth=None) -> Figure:
    """Return a matplotlib figure of the positions, with error ellipses and the known microphones.

    Of an array in space it has a plan and a side view. Small ellipses are enlarged by a round factor, which the legend
    names.

    Parameters
    ----------
    truth : (N, D) array_like, optional
        True positions to draw as well, metres, in the axes of the result. Without known microphones they are aligned
        with the result by a rigid motion, which may include a mirror image.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        `truth` has another shape than the positions.

    Examples
    --------
    >>> import fdcal
    >>> measurement = fdcal.load("tiny")
    >>> figure = fdcal.calibrate(measurement, modes=12).plot(measurement.positions)
    >>> figure.axes[0].get_xlabel()
    'x (m)'
    """
    D = self.positions.shape[1]
    true = None if truth is None else np.asarray(truth, float)
    if true is not None and true.shape != self.positions.shape:
        problem = f"truth has shape {true.shape} and the positions {self.positions.shape}"
        raise InputError(problem, "give one position for each microphone", key="truth")
    known = np.isin(self.names, self.known or ())
    if true is not None and not known.any():
        true = align(true, self.positions)
    views = ((0, 1),) if D == 2 else ((0, 1), (0, 2))
    figure = Figure(figsize=(5.6 * len(views), 5.6), dpi=100, layout="constrained")
    for panel, view in zip(figure.subplots(1, len(views), squeeze=False).ravel(), views, strict=True):
        axes, shown = list(view), self.positions[:, view]
        if self.covariance is not None:
            enlarged_ellipses(panel, shown, self.covariance[:, axes][:, :, axes], self.positions)
        if true is not None:
            plot_marks(panel, "microphones/true", true[:, axes], scale=MARK_SCALE)
        plot_marks(panel, "microphones/estimate", shown[~known], scale=MARK_SCALE)
        plot_marks(panel, "microphones/known", shown[known], scale=MARK_SCALE)
        panel.set_aspect("equal", adjustable="datalim")
        panel.set(xlabel=f"{'xyz'[view[0]]} (m)", ylabel=f"{'xyz'[view[1]]} (m)")
        panel.grid(alpha=0.3)
    figure.suptitle(result_title(self), parse_math=False)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2 * len(views), frameon=False)
    return figure


def enlarged_ellipses(panel, places: np.ndarray, covariance: np.ndarray, positions: np.ndarray) -> None:
    """Draw 95 % ellipses at (N, 2), metres, enlarged by a round factor if they are small beside the array (N, D)."""
    axes = ellipse_axes(covariance, confidence_factor(0.95, 2))
    longest = np.linalg.norm(axes[:, -1], axis=1)
    shown = longest > 0
    if not shown.any():
        return
    factor = enlargement(float(np.median(longest[shown])), float(np.ptp(positions, axis=0).max()))
    angles = np.linspace(0, 2 * np.pi, SIDES + 1)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    label = "95 % ellipse" + (f", {factor:g} times enlarged" if factor > 1 else "")
    for place, pair in zip(places[shown], axes[shown], strict=True):
        panel.plot(*(place + factor * circle @ pair).T, "-", color=fractions(ELLIPSE), linewidth=1.2, label=label)
        label = "_"  # one entry of the legend for all


def html_table(heads: Sequence[str], rows: Sequence[Sequence[str]], omitted: int = 0) -> str:
    """Return a table, with a line for the number of rows that are left out."""
    head = "".join(f"<th>{text}</th>" for text in heads)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    more = f'<tr><td colspan="{len(heads)}">and {omitted} more</td></tr>' if omitted else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}{more}</tbody></table>"


ROWS = 12  # microphones that are listed; the first ones


def calibration_html(result: Calibration) -> str:
    """Return the verdict with its text, the figure of `draw_calibration`, and a table of the microphones."""
    count, known = len(result.names), result.known or ()
    sigma, error = (
        [""] * count if values is None else [f"{1e3 * value:.2f}" for value in values]
        for values in (result.uncertainty, result.errors)
    )
    sigma = ["known" if name in known else text for name, text in zip(result.names, sigma, strict=True)]
    axes = [f"{axis} (m)" for axis in "xyz"[: result.positions.shape[1]]]
    heads = ["microphone", *axes, "one sigma (mm)", "error (mm)"]
    cells = zip(result.names, result.positions, sigma, error, strict=True)
    rows = [[name, *(f"{value:z.4f}" for value in position), *others] for name, position, *others in cells][:ROWS]
    f, verdict, text = result.frequencies, escape(result.verdict.replace("_", " ")), escape(result.verdict_text)
    run = f"solver {result.solver}, {len(f)} modes, {f[0]:.1f} to {f[-1]:.1f} Hz, {result.elapsed:.1f} s"
    coded = base64.b64encode(figure_bytes(draw_calibration(result), "png")).decode()
    return (
        f"<p><b>{verdict}</b>: {text}<br>{escape(run)}</p>"
        f'<img alt="positions of the microphones" style="max-width:100%" src="data:image/png;base64,{coded}">'
        f"{html_table(heads, rows, max(0, count - ROWS))}"
    )


@dataclass(frozen=True)
class Replay:
    """A page that a notebook shows inline.

    Attributes
    ----------
    html : str
        The page, which loads nothing: written to a file it opens in any browser.
    """

    html: str

    def _repr_html_(self) -> str:
        style = "width: 100%; height: 640px; border: 1px solid #8884; border-radius: 8px"
        return f'<iframe srcdoc="{escape(self.html)}" sandbox="allow-scripts" style="{style}" title="Replay"></iframe>'


def show_calibration(self: Calibration) -> Replay:
    """Return the run as a page that plays inline in a notebook, as `fdcal replay` writes it to a file.

    The solver takes its steps again. In the page a microphone can be dragged, and the solvers' steps can be taken.

    Returns
    -------
    Replay
        What a notebook shows as the last value of a cell; its `html` is the page.

    Raises
    ------
    InputError
        The result was read from a file, which holds no measurement.

    Examples
    --------
    >>> import fdcal
    >>> page = fdcal.calibrate(fdcal.load("tiny"), modes=12, solver="joint").show()
    >>> page.html[:15]
    '<!DOCTYPE html>'
    """
    if self.run is None:
        remedy = "show what fdcal.calibrate returns, or write a page with the command fdcal replay"
        raise InputError("this result was read from a file, which holds no measurement", remedy, key="run")
    run = self.run
    states = list(takewhile(lambda state: state.step <= run.step, run.states()))  # the run may have been stopped
    search = search_around(states[-1].positions, run.measurement.search)
    measurement = replace(run.measurement, search=search)
    sought = self.counted([n for n, name in enumerate(self.names) if name in (self.known or ())])
    problem = replace(run.problem, search=measurement.search)
    if not len(problem.known):
        measurement = replace(measurement, known=(), known_positions=None)
    return Replay(
        replay_html(None, measurement, states, result_title(self), reference_cost_of(problem), sought, problem=problem)
    )
