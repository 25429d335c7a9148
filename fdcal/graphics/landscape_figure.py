"""The paper's Fig. 1: the cost landscape of one microphone, mode by mode and summed.

landscape_panels  computes the landscapes
panels_of         takes landscapes that exist
draw_landscape    draws them
figure_bytes      the figure as a file
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..cost.expansion import require_modes, require_plane_field, search_domain
from ..cost.maps import descent_maps, map_positions
from ..model.problem import Problem
from ..model.settings import Search
from ..model.validation import frozen_array
from .landscape_axes import draw_basins, draw_map, draw_marks, label_axes

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

    def plot(self, truth=None, basins: bool = False) -> Figure:
        """Return a matplotlib figure of the maps.

        Parameters
        ----------
        truth : (2,) array_like, optional
            True position of the microphone, metres, drawn as a circle.
        basins : bool, optional
            Draw the basins of attraction, in place of the cost: from each place, the minimum where descent ends.

        Returns
        -------
        matplotlib.figure.Figure
        """
        return draw_landscape(self, truth, basins=basins)


def landscape_panels(problem: Problem, positions, n: int, modes: Sequence[int], order_offset: int) -> LandscapePanels:
    """Return the cost of Eq. 7 over the search lattice with microphone `n` moved and the others at `positions`.

    `positions` (N, 2) float64, metres; `n`: microphone, counted from 0; `modes`: P modes, counted from 1;
    `order_offset`: added to the order of Eq. 3. Raises InputError: the field is not two-dimensional, there is no search
    domain, or the microphones are too few for the order of a mode.
    """
    require_plane_field(problem)
    if problem.search is not None:
        require_modes(problem, order_offset, max(modes))
    maps, search = descent_maps(problem, positions, n, modes, order_offset), search_domain(problem)
    return panels_of(maps, maps.sum(axis=0), modes, problem.frequencies, n, search, len(modes))


def panels_of(maps, total, modes: Sequence[int], frequencies, n: int, search: Search, count: int) -> LandscapePanels:
    """Return panels of maps that exist, the last of the sum.

    `maps` (P, ny, nx) float64, of `modes`; `total` (ny, nx) float64, the sum, perhaps over more modes; `modes`: P
    modes, counted from 1; `frequencies` (M,) Hz, of all modes measured; `n`: microphone, counted from 0; `search`:
    lattice of the maps; `count`: modes in the sum.
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
    basins: bool = False,
) -> Figure:
    """Return a figure of the panels with the marks of the page: diamonds at the minima, the lowest one large.

    `truth` (2,) metres, the true position, drawn as a circle; or None; `label`: of the colour bars; `heading`: of the
    figure; by default it names the microphone; `estimate` (2,) metres, the estimated position, drawn as a cross; or
    None; `decibels`: whether the scales have decibels re 1, as on the page; `basins`: whether the maps show basins of
    attraction, that of the true position, or of the estimate, first.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    count = len(panels.maps)
    columns = int(np.ceil(np.sqrt(count)))
    rows = int(np.ceil(count / columns))
    width, layout = (5.4, "compressed") if basins else (4.4, "constrained")  # the first has room for legends
    figure = Figure(figsize=(width * columns, 3.7 * rows), dpi=120, layout=layout)
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    titles = [f"mode {m}, {f:.1f} Hz" for m, f in zip(panels.modes, panels.frequencies, strict=True)]
    titles.append(f"sum of the {panels.mode_count} modes" if panels.mode_count > 1 else "sum (one mode)")
    for panel, title, cost, minimum in zip(axes, titles, panels.maps, panels.minima, strict=False):
        if basins:
            place = (estimate, "estimate") if truth is None else (truth, "true position")
            draw_basins(panel, cost, panels.search, *place)
        else:
            ticks = MaxNLocator(MAX_TICKS, steps=[1, 2, 5, 10]) if decibels else None
            figure.colorbar(draw_map(panel, cost, panels.search, decibels), ax=panel, label=label, ticks=ticks)
        draw_marks(panel, cost, panels.search, minimum, truth, estimate)
        panel.set_title(title)
    label_axes(axes, count, columns)
    heading = heading or f"{'Basins of attraction' if basins else 'Cost'} of moving microphone {panels.microphone}"
    figure.suptitle(heading, x=0.02, ha="left", parse_math=False)
    marks = {name: line for panel in axes for line, name in zip(*panel.get_legend_handles_labels(), strict=True)}
    figure.legend(marks.values(), marks.keys(), loc="outside upper right", ncols=4, frameon=False)
    return figure


def figure_bytes(figure: Figure, file_format: str) -> bytes:
    """Return the figure as a "png" or "svg" file; texts of an SVG remain texts."""
    import matplotlib

    file = io.BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        figure.savefig(file, format=file_format)
    return file.getvalue()
