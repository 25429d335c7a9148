"""The legend of a picture, written in rows below the image of its scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from .legend import Entry
from .theme import Colour, Theme

SYMBOL, GAP, ROW = 18, 22, 27  # edge of a symbol, space between entries and height of a row, at a 16-pixel font
FINER = 4  # times finer than the image, for smooth edges
HALO_WIDTH = 0.3  # by how much a halo is wider than its line, in halves of a symbol's edge


def legend_rows(
    entries: Sequence[Entry], width: float, letters: ImageFont.FreeTypeFont
) -> tuple[tuple[Entry, ...], ...]:
    """Return the entries in rows that fit into `width` pixels."""
    rows: list[list[Entry]] = []
    used = 0.0
    for entry in entries:
        length = entry_width(entry, letters)
        if not rows or used + length > width:
            rows.append([])
            used = 0.0
        rows[-1].append(entry)
        used += length
    return tuple(tuple(row) for row in rows)


def entry_width(entry: Entry, letters: ImageFont.FreeTypeFont) -> float:
    """Return the pixels that an entry takes, with the space to the next one."""
    return (SYMBOL * 1.35 + GAP) * letters.size / 16 + letters.getlength(entry.text)


def draw_legend(
    image: Image.Image,
    rows: Sequence[Sequence[Entry]],
    corner: tuple[float, float],
    letters: ImageFont.FreeTypeFont,
    theme: Theme,
) -> None:
    """Write rows of entries over an image.

    `image`: PIL.Image.Image; `rows`: of `legend_rows`; `corner`: left and top of the first row, pixels; `letters`:
    font.
    """
    draw, scale = ImageDraw.Draw(image), letters.size / 16
    left, top = corner
    for i, row in enumerate(rows):
        x, middle = left, top + (i + 0.5) * ROW * scale
        for entry in row:
            edge = round(SYMBOL * scale)
            stamp = symbol(entry, edge)
            image.paste(stamp, (round(x), round(middle - edge / 2)), stamp)
            draw.text((x + 1.35 * edge, middle), entry.text, fill=theme.foreground, font=letters, anchor="lm")
            x += entry_width(entry, letters)


def symbol(entry: Entry, edge: int) -> Image.Image:
    """Return the symbol of an entry on a transparent square of `edge` pixels."""
    size = FINER * edge
    image = Image.new("RGBA", (size, size))
    draw = ImageDraw.Draw(image)
    if entry.halo:
        _draw_paths(draw, entry, entry.halo_colour, entry.width + HALO_WIDTH, size)
    _draw_paths(draw, entry, entry.colour, entry.width, size)
    return image.resize((edge, edge), Image.Resampling.LANCZOS)


def _draw_paths(draw: ImageDraw.ImageDraw, entry: Entry, colour: Colour, width: float, size: int) -> None:
    for i, path in enumerate(entry.paths):
        pixels = [(float(x), float(y)) for x, y in size / 2 * (1 + np.array(path) * [1.0, -1.0])]
        if entry.filled and i == 0:
            draw.polygon(pixels, fill=colour)
        draw.line(pixels, fill=colour, width=max(round(width * size / 2), 1), joint="curve")
