"""Cost maps of one microphone side by side, the paper's Fig. 1: a figure by matplotlib.

matplotlib is loaded with the first figure.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

from ..cost.maps import LandscapePanels
from ..cost.scale import DECADES, LEAST_RANGE
from .heatmap import SHOWN
from .marks import plot_marks
from .primitives import COLOUR_MAP

if TYPE_CHECKING:
    from matplotlib.figure import Figure


MAX_TICKS = 6  # of a colour bar
TITLE_PAD = 12.0  # points: a mark at the edge of a map does not reach its title


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
        In place of the usual one.
    quantity : str, optional
        What the cost is called.

    Returns
    -------
    matplotlib.figure.Figure
    """
    panels = self
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    count = len(panels.maps)
    columns = int(np.ceil(np.sqrt(count)))
    rows = int(np.ceil(count / columns))
    figure = Figure(figsize=(3.9 * columns, 4.0 * rows + 0.8), dpi=120, layout="compressed")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    titles = [f"mode {m}, {f:.1f} Hz" for m, f in zip(panels.modes, panels.frequencies, strict=True)]
    titles.append(f"sum of the {panels.mode_count} modes" if panels.mode_count > 1 else "sum (one mode)")
    scaled = [10 * np.log10(np.maximum(cost / cost.max(), 10.0**-DECADES)) for cost in panels.maps]
    ends = np.array([np.percentile(one, SHOWN) for one in scaled])
    low, high = float(ends[:, 0].min()), float(ends[:, 1].max())
    half, (x, y), (ny, nx) = panels.search.step / 2, panels.search.origin[:2], panels.maps.shape[1:]
    edges = x - half, x + nx * panels.search.step - half, y - half, y + ny * panels.search.step - half
    style: dict[str, Any] = {"origin": "lower", "interpolation": "nearest", "cmap": COLOUR_MAP, "extent": edges}
    style["norm"] = Normalize(low, max(high, low + LEAST_RANGE), clip=True)
    images, (left, right, bottom, top) = [], edges
    known = {"microphones/true": truth, "microphones/estimate": estimate}
    inside = {name: [place] for name, place in known.items()
              if place is not None and left <= place[0] <= right and bottom <= place[1] <= top}  # fmt: skip
    for panel, title, shown, minima in zip(axes, titles, scaled, panels.marks, strict=False):
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
    figure.suptitle(heading or f"Cost of moving microphone {panels.microphone}", parse_math=False)
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
