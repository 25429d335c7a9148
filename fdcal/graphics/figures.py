"""Figures by matplotlib: cost maps side by side, like the paper's Fig. 1, and a calibration, also as HTML.

`matplotlib.figure` is loaded with the first figure.
"""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass, replace
from html import escape
from itertools import takewhile
from typing import TYPE_CHECKING, Any

import numpy as np

from ..assessment.calibration import Calibration
from ..assessment.uncertainty import confidence_factor, ellipse_axes
from ..assessment.words import result_title
from ..cost.eq7 import reference_cost_of
from ..cost.maps import LandscapePanels
from ..cost.scale import DECADES, LEAST_RANGE
from ..model.gauge import align
from ..model.settings import search_around
from ..model.validation import InputError
from .heatmap import SHOWN
from .marks import ELLIPSE, plot_marks
from .picture import NO_ELLIPSE, ellipse_scale
from .primitives import COLOUR_MAP, fractions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_TICKS = 6  # largest number of ticks of a colour bar
TITLE_PAD = 12.0  # points between map and title, so that a mark at the edge does not reach the title


def draw_landscape(
    self: LandscapePanels, truth=None, *, estimate=None, heading: str = "", quantity: str = "cost"
) -> Figure:
    """Return a matplotlib figure of the maps on one scale, in decibels relative to the highest cost of each map.

    Diamonds mark the lowest costs and the other minima.

    Parameters
    ----------
    truth, estimate : (2,) array_like, optional
        True and estimated position of the microphone, metres, drawn as a circle and a cross.
    heading : str, optional
        Heading of the figure, instead of the usual one.
    quantity : str, optional
        Name of the cost in the label of the colour bar.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    count = len(self.maps)
    columns = int(np.ceil(np.sqrt(count)))
    rows = int(np.ceil(count / columns))
    figure = Figure(figsize=(3.9 * columns, 4.0 * rows + 0.8), dpi=120, layout="compressed")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    titles = [f"frequency {m}, {f:.1f} Hz" for m, f in zip(self.modes, self.frequencies, strict=True)]
    titles.append(f"sum of the {self.mode_count} frequencies" if self.mode_count > 1 else "sum (one frequency)")
    scaled = [10 * np.log10(np.maximum(cost / cost.max(), 10.0**-DECADES)) for cost in self.maps]
    ends = np.array([np.percentile(one, SHOWN) for one in scaled])
    low, high = float(ends[:, 0].min()), float(ends[:, 1].max())
    half, (x, y), (ny, nx) = self.search.step / 2, self.search.origin[:2], self.maps.shape[1:]
    edges = x - half, x + nx * self.search.step - half, y - half, y + ny * self.search.step - half
    style: dict[str, Any] = {"origin": "lower", "interpolation": "nearest", "cmap": COLOUR_MAP, "extent": edges}
    style["norm"] = Normalize(low, max(high, low + LEAST_RANGE), clip=True)
    images, (left, right, bottom, top) = [], edges
    given = {"microphones/true": truth, "microphones/estimate": estimate}
    inside = {name: [place] for name, place in given.items()
              if place is not None and left <= place[0] <= right and bottom <= place[1] <= top}  # fmt: skip
    for panel, title, shown, minima in zip(axes, titles, scaled, self.marks, strict=False):
        images.append(panel.imshow(shown, **style))
        plot_marks(panel, "microphones/true", inside.get("microphones/true"))
        plot_marks(panel, "minima", minima.others)
        plot_marks(panel, "lowest", minima.lowest)
        plot_marks(panel, "microphones/estimate", inside.get("microphones/estimate"))
        panel.set_title(title, pad=TITLE_PAD)
    label = f"{quantity} (dB re the highest of each map)"
    ticks = MaxNLocator(MAX_TICKS, steps=[1, 2, 5, 10])
    figure.colorbar(images[-1], ax=axes.tolist(), label=label, ticks=ticks, extend="both", extendfrac=0.02, aspect=40)
    for i, panel in enumerate(axes):
        panel.set_visible(i < count)
        panel.tick_params(labelbottom=True)
        panel.set(xlabel="x (m)" if i + columns >= count else "", ylabel="" if i % columns else "y (m)")
    figure.suptitle(heading or f"Cost of moving microphone {self.microphone}", parse_math=False)
    marks = {name: line for panel in axes for line, name in zip(*panel.get_legend_handles_labels(), strict=True)}
    figure.legend(marks.values(), marks.keys(), loc="outside lower center", ncols=4, frameon=False)
    return figure


def figure_bytes(figure: Figure, file_format: str) -> bytes:
    """Return the figure as a "png" or "svg" file; texts of an SVG remain texts."""
    import matplotlib

    file = io.BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        figure.savefig(file, format=file_format)
    return file.getvalue()


def landscape_bytes(file_format: str, panels: LandscapePanels, drawn: dict[str, Any]) -> bytes:
    """Return `figure_bytes` of `draw_landscape`."""
    return figure_bytes(draw_landscape(panels, **drawn), file_format)


SIDES = 60  # number of sides of the polygon that is drawn for an ellipse
MARK_SCALE = 2 / 3  # ratio of the size of the marks to that of marks on a map; below 1, because there are many


def draw_calibration(self: Calibration, truth=None, label: str = "true") -> Figure:
    """Return a matplotlib figure of the positions, with error ellipses and the known microphones.

    For an array in space it has a plan and a side view. Small ellipses are enlarged by a round factor, which the legend
    states.

    Parameters
    ----------
    truth : (N, D) array_like, optional
        True positions to draw as well, metres, in the axes of the result. Without known microphones they are aligned
        with the result by a rigid motion, which may include a mirror image.
    label : str
        Name of these positions in the legend, such as "nominal".

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
    from matplotlib.figure import Figure

    D, C, extent = self.positions.shape[1], self.covariance, float(np.ptp(self.positions, axis=0).max())
    true = None if truth is None else np.asarray(truth, float)
    if true is not None and true.shape != self.positions.shape:
        problem = f"truth has shape {true.shape}, but the positions have shape {self.positions.shape}"
        raise InputError(problem, "give one position for each microphone", key="truth")
    known = np.isin(self.names, self.known or ())
    if true is not None and not known.any():
        true = align(true, self.positions)
    views = ((0, 1),) if D == 2 else ((0, 1), (0, 2))
    factor = 1.0 if C is None else ellipse_scale(ellipse_axes(C, confidence_factor(0.95, 2)), extent)
    figure = Figure(figsize=(5.6 * len(views), 5.6), dpi=100, layout="constrained")
    for panel, view in zip(figure.subplots(1, len(views), squeeze=False).ravel(), views, strict=True):
        axes, shown = list(view), self.positions[:, view]
        if C is not None:
            enlarged_ellipses(panel, shown, C[:, axes][:, :, axes], factor)
        if true is not None:
            plot_marks(panel, "microphones/true", true[:, axes], MARK_SCALE, label)
        plot_marks(panel, "microphones/estimate", shown[~known], scale=MARK_SCALE)
        plot_marks(panel, "microphones/known", shown[known], scale=MARK_SCALE)
        panel.set_aspect("equal", adjustable="datalim")
        panel.set(xlabel=f"{'xyz'[view[0]]} (m)", ylabel=f"{'xyz'[view[1]]} (m)")
        panel.grid(alpha=0.3)
    figure.suptitle(result_title(self), parse_math=False)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2 * len(views), frameon=False)
    return figure


def enlarged_ellipses(panel, places: np.ndarray, covariance: np.ndarray, factor: float) -> None:
    """Draw 95 % ellipses of covariances (N, 2, 2), square metres, at (N, 2), metres, enlarged by `factor`."""
    axes = ellipse_axes(covariance, confidence_factor(0.95, 2))
    shown = np.linalg.norm(axes[:, -1], axis=1) > NO_ELLIPSE
    angles = np.linspace(0, 2 * np.pi, SIDES + 1)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    label = "95 % ellipse" + (f", enlarged {factor:g} times" if factor > 1 else "")
    for place, pair in zip(places[shown], axes[shown], strict=True):
        panel.plot(*(place + factor * circle @ pair).T, "-", color=fractions(ELLIPSE), linewidth=1.2, label=label)
        label = "_"  # one entry of the legend for all


ROWS = 12  # largest number of microphones in the table


def calibration_html(result: Calibration) -> str:
    """Return the verdict with its text, the figure of `draw_calibration`, and a table of the microphones."""
    count, known = len(result.names), result.known or ()
    sigma, error = (
        [""] * count if values is None else [f"{1e3 * value:.2f}" for value in values]
        for values in (result.uncertainty, result.errors)
    )
    sigma = ["known" if name in known else text for name, text in zip(result.names, sigma, strict=True)]
    axes = [f"{axis} (m)" for axis in "xyz"[: result.positions.shape[1]]]
    heads = "".join(f"<th>{text}</th>" for text in ("microphone", *axes, "one sigma (mm)", "error (mm)"))
    cells = zip(result.names, result.positions, sigma, error, strict=True)
    rows = [[name, *(f"{value:z.4f}" for value in position), *others] for name, position, *others in cells][:ROWS]
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    body += f"<tr><td colspan='{len(axes) + 3}'>and {count - ROWS} more</td></tr>" if count > ROWS else ""
    f, verdict, text = result.frequencies, escape(result.verdict.replace("_", " ")), escape(result.verdict_text)
    run = f"solver {result.solver}, {len(f)} frequencies, {f[0]:.1f} to {f[-1]:.1f} Hz, {result.elapsed:.1f} s"
    coded = base64.b64encode(figure_bytes(draw_calibration(result), "png")).decode()
    return (
        f"<p><b>{verdict}</b>: {text}<br>{escape(run)}</p>"
        f'<img alt="positions of the microphones" style="max-width:100%" src="data:image/png;base64,{coded}">'
        f"<table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table>"
    )


@dataclass(frozen=True)
class Replay:
    """A page that a notebook shows inline.

    Attributes
    ----------
    html : str
        The page. It loads no other file; written to a file, it opens in any browser.
    """

    html: str

    def _repr_html_(self) -> str:
        style = "width: 100%; height: 640px; border: 1px solid #8884; border-radius: 8px"
        return f'<iframe srcdoc="{escape(self.html)}" sandbox="allow-scripts" style="{style}" title="Replay"></iframe>'


def show_calibration(self: Calibration) -> Replay:
    """Return the run as a page that plays inside a notebook; it is the page that `fdcal replay` writes to a file.

    The solver runs again, with the same result. On the page a microphone can be dragged. If array and field are plane
    and the known microphones fix the axes, the page can also take steps of the paper's method.

    Returns
    -------
    Replay
        A notebook shows it if it is the last value of a cell; its `html` is the page.

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
    from .replay import replay_html

    if self.run is None:
        remedy = "show what fdcal.calibrate returns, or write a page with the command fdcal replay"
        raise InputError("this result was read from a file, which holds no measurement", remedy, key="run")
    run = self.run
    states = list(takewhile(lambda state: state.step <= run.step, run.states()))  # a run may have been stopped
    measurement = replace(run.measurement, search=search_around(states[-1].positions, run.measurement.search))
    sought = self.counted([n for n, name in enumerate(self.names) if name in (self.known or ())])
    problem = replace(run.problem, search=measurement.search)
    if not len(problem.known):
        measurement = replace(measurement, known=(), known_positions=None)
    return Replay(
        replay_html(None, measurement, states, result_title(self), reference_cost_of(problem), sought, problem=problem)
    )
