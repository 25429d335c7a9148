"""Several maps side by side, as one image: the paper's Fig. 1 at the size of a side panel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..model.settings import Search
from .heatmap import colour_limits, normalise, to_rgb
from .primitives import DARK, Theme

CELL, GAP, CAPTION = 252, 18, 34  # pixels: edge of a map, between maps, above each
POINTS = 21  # of the letters above two columns
DARK_PANEL = (36, 36, 36)  # behind the controls of a dark page
ESTIMATE, LOWEST = (214, 24, 40), (255, 176, 0)


@dataclass(frozen=True)
class Marks:
    """Where on every map to put marks, metres: the true position, the supposed one; None for none."""

    true: tuple[float, float] | None = None
    estimate: tuple[float, float] | None = None


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
) -> np.ndarray:
    """The maps (ny, nx) side by side, each with its caption, its lowest point and the marks : (H, W, 3) uint8.

    With `shared` all have one scale, otherwise each its own.
    """
    count, largest = len(maps), max(maps[0].shape)
    height, width = (round(CELL * n / largest) for n in maps[0].shape)
    rows = -(-count // columns)
    size = columns * (width + GAP) - GAP, rows * (height + CAPTION + GAP) - GAP
    image = Image.new("RGB", size, DARK_PANEL if theme is DARK else theme.background)
    draw, font = ImageDraw.Draw(image), _font(POINTS * columns / 2)  # the panel shrinks all columns to its width
    scale = colour_limits(np.stack(maps), log) if shared else None
    for i, (cost, caption) in enumerate(zip(maps, captions, strict=True)):
        left, top = (i % columns) * (width + GAP), (i // columns) * (height + CAPTION + GAP)
        draw.text((left, top), caption, fill=theme.foreground, font=font)
        low, high, _ = scale or colour_limits(cost, log)
        rgb = to_rgb(normalise(cost, low, high, log))[::-1]  # an image's first row is its highest
        tile = Image.fromarray(rgb).resize((width, height), Image.Resampling.NEAREST)
        image.paste(tile, (left, top + CAPTION))
        row, column = np.unravel_index(cost.argmin(), cost.shape)
        lowest = (search.origin[0] + column * search.step, search.origin[1] + row * search.step)
        _mark(draw, (left, top + CAPTION), (width, height), search, cost.shape, marks, lowest)
    return np.asarray(image)


def _mark(draw, corner, size, search: Search, shape, marks: Marks, lowest) -> None:
    """Circle at the truth, diamond at the lowest point, cross at the supposed position: black or colour on white."""

    def pixel(place):
        x, y = ((place[a] - search.origin[a]) / search.step + 0.5 for a in (0, 1))
        return corner[0] + x * size[0] / shape[1], corner[1] + size[1] * (1 - y / shape[0])

    def inside(place):
        x, y = pixel(place)
        return corner[0] <= x <= corner[0] + size[0] and corner[1] <= y <= corner[1] + size[1]

    for place, name, colour, reach in (
        (marks.true, "circle", (0, 0, 0), 9),
        (lowest, "diamond", LOWEST, 13),
        (marks.estimate, "cross", ESTIMATE, 8),
    ):
        if place is None or not inside(place):
            continue
        x, y = pixel(place)
        for ink, width in (((255, 255, 255), 7), (colour, 3)):
            _draw_mark(draw, name, x, y, reach, ink, width)


def _draw_mark(draw, name: str, x: float, y: float, reach: float, ink, width: int) -> None:
    if name == "circle":
        edge = reach + width / 2
        draw.ellipse([x - edge, y - edge, x + edge, y + edge], outline=ink, width=width)
    elif name == "diamond":
        corners = [(x + reach, y), (x, y + reach), (x - reach, y), (x, y - reach)]
        draw.line([*corners, *corners[:2]], fill=ink, width=width, joint="curve")
    else:
        draw.line([x - reach, y - reach, x + reach, y + reach], fill=ink, width=width + 1)
        draw.line([x - reach, y + reach, x + reach, y - reach], fill=ink, width=width + 1)


def _font(points: float) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf", points)
