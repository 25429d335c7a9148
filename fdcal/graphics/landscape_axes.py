"""What is drawn into one panel of a figure of landscapes: a map or its basins, marks, and the axes."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..cost.basins import OUTSIDE, basins_of, local_minima
from ..cost.maps import map_positions
from ..model.settings import Search
from .basin_map import TABLE, basin_image
from .colour_bar import COLOUR_MAP
from .heatmap import DECADES
from .markers import ESTIMATE, LOWEST
from .picture import PLANE_MARKER
from .theme import fractions


def draw_map(panel: Any, cost: np.ndarray, search: Search, decibels: bool) -> Any:
    """Draw one map in decades of cost, as on the page; a pixel is one cell of the lattice."""
    from matplotlib.colors import LogNorm, Normalize

    high = max(float(cost.max()), float(np.finfo(float).tiny))
    low = max(float(cost.min()), high * 10.0**-DECADES)
    high = high if high > low else 2 * low
    norm: Normalize = LogNorm(low, high, clip=True)
    if decibels:
        cost, norm = 10 * np.log10(np.maximum(cost, low)), Normalize(10 * np.log10(low), 10 * np.log10(high), clip=True)
    return panel.imshow(
        cost, origin="lower", extent=_extent(search, cost.shape), cmap=COLOUR_MAP, norm=norm, interpolation="nearest"
    )


def draw_basins(panel: Any, cost: np.ndarray, search: Search, place, name: str) -> None:
    """Draw the basins of attraction of one map, with their legend at its right.

    `cost` (ny, nx) float64; `search`: its lattice; `place` (2,) metres, whose basin has the first colour; or None;
    `name`: of that place.
    """
    from matplotlib.patches import Patch

    basins = basins_of(cost)
    image = basin_image(basins, OUTSIDE if place is None else basins.at(search, place), name)
    panel.imshow(TABLE[image.numbers], origin="lower", extent=_extent(search, cost.shape), interpolation="nearest")
    patches = [
        Patch(facecolor=f"#{bytes(area.colour).hex()}", edgecolor="black", linewidth=0.5, label=area.text)
        for area in image.areas
    ]
    style = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0), "frameon": False, "fontsize": "small"}
    panel.legend(handles=patches, handlelength=1.2, **style)


def _extent(search: Search, shape: tuple[int, ...]) -> tuple[float, float, float, float]:
    """The edges of a map (ny, nx), of which a pixel is one cell of the lattice."""
    half, (x, y), (ny, nx) = search.step / 2, search.origin[:2], shape
    return x - half, x + nx * search.step - half, y - half, y + ny * search.step - half


def label_axes(axes, count: int, columns: int) -> None:
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


def draw_marks(panel: Any, cost: np.ndarray, search: Search, lowest, truth, estimate) -> None:
    """Draw the marks of the page on one map, each with a white halo."""
    from matplotlib import patheffects

    amber, red = fractions(LOWEST), fractions(ESTIMATE)
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
