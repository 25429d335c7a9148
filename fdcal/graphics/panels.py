"""Several maps side by side, as one image: the paper's Fig. 1 at the size of a side panel."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from ..cost.maps import minima_of
from ..cost.scale import LEAST_RANGE, Minima
from ..model.settings import Search
from .annotations import font
from .heatmap import colour_limits, normalise, to_rgb
from .marks import MARKS, symbol
from .primitives import DARK, Theme

CELL, GAP, CAPTION = 252, 18, 34  # pixels: longer edge of a map, between maps, above each
FONT_SIZE = 21  # pixels, of the captions over two columns
DARK_PANEL = (36, 36, 36)  # behind the controls of a dark page
EDGES = {"microphones/true": 31, "minima": 26, "lowest": 37, "microphones/estimate": 31}  # pixels, of symbols

Point = tuple[float, float]
NONE = Minima(np.zeros((0, 2)), np.zeros((0, 2)), 0, None)


@dataclass(frozen=True)
class Marks:
    """Positions to be marked on every map, metres; None for no mark."""

    true: Point | None = None  # of the microphone
    estimate: Point | None = None  # its estimated position
    minima: bool = True  # whether the minima are marked


def mosaic(
    maps: Sequence[np.ndarray],
    captions: Sequence[str],
    search: Search,
    marks: Marks,
    theme: Theme,
    *,
    log: bool = True,
    shared: bool = False,
    columns: int = 2,
    least: float = LEAST_RANGE,
) -> np.ndarray:
    """Return the maps side by side, each with its caption, diamonds at its lowest costs and its minima, and the marks.

    `maps`: each (ny, nx) float64, row 0 at low y; `captions`: one for each map; `search`: the lattice of the maps;
    `log`: whether the scales are logarithmic; `shared`: one scale for all maps instead of one for each; `columns`: of
    maps; `least`: of `heatmap.colour_limits`. Returns (H, W, 3) uint8.
    """
    count, largest = len(maps), max(maps[0].shape)
    height, width = (round(CELL * n / largest) for n in maps[0].shape)
    rows = -(-count // columns)
    size = columns * (width + GAP) - GAP, rows * (height + CAPTION + GAP) - GAP
    image = Image.new("RGB", size, DARK_PANEL if theme is DARK else theme.background)
    draw, letters = ImageDraw.Draw(image), font(FONT_SIZE * columns / 2)  # the panel shrinks all columns to its width
    limits = colour_limits(np.stack(maps), log, least) if shared else None
    for i, (cost, caption) in enumerate(zip(maps, captions, strict=True)):
        left, top = (i % columns) * (width + GAP), (i // columns) * (height + CAPTION + GAP)
        draw.text((left, top), caption, fill=theme.foreground, font=letters)
        low, high, _ = limits or colour_limits(cost, log, least)
        rgb = to_rgb(normalise(cost, low, high, log))[::-1]  # an image's first row is its highest
        tile = Image.fromarray(rgb).resize((width, height), Image.Resampling.NEAREST)
        image.paste(tile, (left, top + CAPTION))
        _draw_marks(_Tile(image, (left, top + CAPTION), (width, height), search, cost), marks)
    return np.asarray(image)


@dataclass(frozen=True)
class _Tile:
    """One map in the image: its corner and size in pixels."""

    image: Image.Image
    corner: tuple[int, int]
    size: tuple[int, int]
    search: Search
    cost: np.ndarray

    def pixel(self, place: Sequence[float] | np.ndarray) -> Point | None:
        """The pixel of a place, metres; None outside the map."""
        across, up = ((place[a] - self.search.origin[a]) / self.search.step + 0.5 for a in (0, 1))
        (ny, nx), (left, top), (width, height) = self.cost.shape, self.corner, self.size
        x, y = left + across * width / nx, top + height * (1 - up / ny)
        return (x, y) if left <= x <= left + width and top <= y <= top + height else None


def _draw_marks(tile: _Tile, marks: Marks) -> None:
    """Draw a circle at the truth, diamonds at the minima, the lowest large, and a cross at the estimate."""
    minima = minima_of(tile.cost, tile.search) if marks.minima else NONE
    groups = ([marks.true], minima.others, minima.lowest, [marks.estimate])
    for (name, edge), places in zip(EDGES.items(), groups, strict=True):
        stamp = symbol(MARKS[name], edge)
        for place in places:
            pixel = None if place is None else tile.pixel(place)
            if pixel is not None:
                tile.image.paste(stamp, (round(pixel[0] - edge / 2), round(pixel[1] - edge / 2)), stamp)
