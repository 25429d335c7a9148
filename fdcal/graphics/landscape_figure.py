"""The paper's Fig. 1: the cost landscape of one microphone, mode by mode and summed.

landscape_panels  computes the landscapes
panels_of         takes landscapes that exist
draw_landscape    draws them
figure_bytes      the figure as a file
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..cost.landscapes import local_minima, map_positions
from ..cost.lattice_search import lattice_landscape
from ..cost.mode_limits import require_modes, require_plane_field, search_lattice
from ..model.problem import Problem
from ..model.settings import Search
from ..model.validation import frozen_array
from .heatmap import DECADES
from .markers import ESTIMATE, LOWEST
from .picture import PLANE_MARKER
from .primitives import COLOUR_MAP

if TYPE_CHECKING:
    from matplotlib.figure import Figure


MAX_TICKS = 5  # of a colour bar in decibels


@dataclass(frozen=True)
class LandscapePanels:
    """Landscapes of one microphone.

    Attributes
    ----------
    microphone : int
        Counted from 0.
    modes : (P,) int64
        Counted from 1.
    frequencies : (P,) float64
        Hz.
    maps : (P + 1, ny, nx) float64
        Dimensionless; one for each mode, the last their sum; row 0 at low y.
    minima : (P + 1, 2) float64
        Metres, the minimum of each map.
    search : Search
    mode_count : int
        Modes in the sum, not all of which need a map here.
    """

    microphone: int
    modes: np.ndarray
    frequencies: np.ndarray
    maps: np.ndarray
    minima: np.ndarray
    search: Search
    mode_count: int

    def plot(self, truth=None) -> Figure:
        """Return a matplotlib figure of the maps.

        Parameters
        ----------
        truth : (2,) array_like, optional
            True position of the microphone, metres, drawn as a circle.

        Returns
        -------
        matplotlib.figure.Figure
        """
        return draw_landscape(self, truth)


def landscape_panels(problem: Problem, positions, n: int, modes: Sequence[int], order_offset: int) -> LandscapePanels:
    """Return the cost of Eq. 7 over the search lattice with microphone `n` moved and the others at `positions`.

    Parameters
    ----------
    problem : Problem
    positions : (N, 2) float64, metres
    n : microphone, counted from 0
    modes : P modes, counted from 1
    order_offset : added to the order of Eq. 3

    Raises
    ------
    InputError
        The field is not two-dimensional, there is no search domain, or the microphones are too few for the order of a
        mode.
    """
    require_plane_field(problem)
    if problem.search is not None:
        require_modes(problem, order_offset, max(modes))
    index = np.asarray(modes) - 1
    names = ("pressures", "wavenumbers", "frequencies")
    selected = replace(problem, noise_power=None, **{name: getattr(problem, name)[index] for name in names})
    lattice = search_lattice(selected, order_offset)
    centre = lattice.nearest(np.mean(positions, axis=0))
    maps = lattice_landscape(selected, lattice, positions, n, centre, slice(0, len(index)))
    maps = np.concatenate([maps, maps.sum(axis=0, keepdims=True)])
    minima = lattice.points[maps.reshape(len(maps), -1).argmin(axis=1)]
    return LandscapePanels(
        microphone=n,
        modes=frozen_array(modes, np.int64),
        frequencies=frozen_array(selected.frequencies, float),
        maps=frozen_array(maps, float),
        minima=frozen_array(minima, float),
        search=lattice.search,
        mode_count=len(index),
    )


def panels_of(maps, total, modes: Sequence[int], frequencies, n: int, search: Search, count: int) -> LandscapePanels:
    """Return panels of maps that exist, the last of the sum.

    Parameters
    ----------
    maps : (P, ny, nx) float64, of `modes`
    total : (ny, nx) float64, the sum, perhaps over more modes
    modes : P modes, counted from 1
    frequencies : (M,) Hz, of all modes measured
    n : microphone, counted from 0
    search : lattice of the maps
    count : modes in the sum
    """
    drawn = np.concatenate([np.asarray(maps, float), np.asarray(total, float)[None]])
    lowest = np.column_stack(np.divmod(drawn.reshape(len(drawn), -1).argmin(axis=1), drawn.shape[2]))
    return LandscapePanels(
        microphone=n,
        modes=frozen_array(modes, np.int64),
        frequencies=frozen_array(np.asarray(frequencies)[np.asarray(modes) - 1], float),
        maps=frozen_array(drawn, float),
        minima=frozen_array(map_positions(lowest, search), float),
        search=search,
        mode_count=count,
    )


def draw_landscape(
    panels: LandscapePanels,
    truth=None,
    label: str = "cost (dimensionless)",
    heading: str = "",
    estimate=None,
    decibels: bool = False,
) -> Figure:
    """Return a figure of the panels with the marks of the page: diamonds at the minima, the lowest one large.

    Parameters
    ----------
    panels : LandscapePanels
    truth : (2,) metres, the true position, drawn as a circle; or None
    label : of the colour bars
    heading : of the figure; by default it names the microphone
    estimate : (2,) metres, the estimated position, drawn as a cross; or None
    decibels : whether the scales have decibels re 1, as on the page
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    count = len(panels.maps)
    columns = int(np.ceil(np.sqrt(count)))
    rows = int(np.ceil(count / columns))
    figure = Figure(figsize=(4.4 * columns, 3.7 * rows), dpi=120, layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    titles = [f"mode {m}, {f:.1f} Hz" for m, f in zip(panels.modes, panels.frequencies, strict=True)]
    titles.append(f"sum of the {panels.mode_count} modes" if panels.mode_count > 1 else "sum (one mode)")
    for panel, title, cost, minimum in zip(axes, titles, panels.maps, panels.minima, strict=False):
        image = _draw_map(panel, cost, panels.search, decibels)
        _draw_marks(panel, cost, panels.search, minimum, truth, estimate)
        panel.set_title(title)
        ticks = MaxNLocator(MAX_TICKS, steps=[1, 2, 5, 10]) if decibels else None
        figure.colorbar(image, ax=panel, label=label, ticks=ticks)
    _label_axes(axes, count, columns)
    heading = heading or f"Cost of moving microphone {panels.microphone}"
    figure.suptitle(heading, x=0.02, ha="left", parse_math=False)
    marks = {name: line for panel in axes for line, name in zip(*panel.get_legend_handles_labels(), strict=True)}
    figure.legend(marks.values(), marks.keys(), loc="outside upper right", ncols=4, frameon=False)
    return figure


def _draw_marks(panel: Any, cost: np.ndarray, search: Search, lowest, truth, estimate) -> None:
    """Draw the marks of the page on one map, each with a white halo."""
    from matplotlib import patheffects

    amber, red = (tuple(value / 255 for value in colour) for colour in (LOWEST, ESTIMATE))
    others = map_positions(local_minima(cost), search)
    near = PLANE_MARKER * search.step * max(cost.shape)
    others = others[np.hypot(*(others - lowest).T) > near]
    marks = [("true", truth, "o", "black", 15, 2.0), ("other minimum", others, "D", amber, 5, 1.5)]
    marks += [("lowest cost", lowest, "D", amber, 11, 2.0), ("estimate", estimate, "x", red, 11, 2.5)]
    for name, places, shape, colour, size, width in marks:
        if places is None or not len(places):
            continue
        x, y = np.reshape(places, (-1, 2)).T
        style = {"markersize": size, "markeredgewidth": width, "fillstyle": "none", "linestyle": "none"}
        halo = [patheffects.withStroke(linewidth=width + 2, foreground="white")]
        panel.plot(x, y, shape, color=colour, label=name, path_effects=halo, **style)


def figure_bytes(figure: Figure, file_format: str) -> bytes:
    """Return the figure as a "png" or "svg" file; texts of an SVG remain texts."""
    import matplotlib

    file = io.BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        figure.savefig(file, format=file_format)
    return file.getvalue()


def _draw_map(panel: Any, cost: np.ndarray, search: Search, decibels: bool) -> Any:
    """Draw one map in decades of cost, as on the page; a pixel is one cell of the lattice."""
    from matplotlib.colors import LogNorm, Normalize

    high = max(float(cost.max()), float(np.finfo(float).tiny))
    low = max(float(cost.min()), high * 10.0**-DECADES)
    half = search.step / 2
    (x, y), (ny, nx) = search.origin[:2], cost.shape
    extent = (x - half, x + nx * search.step - half, y - half, y + ny * search.step - half)
    high = high if high > low else 2 * low
    norm: Normalize = LogNorm(low, high, clip=True)
    if decibels:
        cost, norm = 10 * np.log10(np.maximum(cost, low)), Normalize(10 * np.log10(low), 10 * np.log10(high), clip=True)
    return panel.imshow(cost, origin="lower", extent=extent, cmap=COLOUR_MAP, norm=norm, interpolation="nearest")


def _label_axes(axes, count: int, columns: int) -> None:
    """Label the outer panels in metres, and hide the frames without a panel."""
    for i, panel in enumerate(axes):
        if i >= count:
            panel.set_visible(False)
            continue
        panel.tick_params(labelbottom=True)
        if i + columns >= count:
            panel.set_xlabel("x (m)")
        if i % columns == 0:
            panel.set_ylabel("y (m)")
