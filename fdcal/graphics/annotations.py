"""Title, labels, legend and colour bar of a picture, written over the image of its scene.

The legend has exactly the marks that are drawn, in one order, for every renderer: the page, the PNG and the test of
both read the same entries. A symbol is drawn in a square from -1 to 1, y upwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from .camera import Camera, lifted, project
from .glyphs import stars
from .markers import CUT, ELLIPSE, ESTIMATE, FAULTY, KNOWN, LOWEST, TRAIL, TRUE
from .overlays import ELLIPSE_TEXT
from .primitives import Colour, ColourBar, Label, Lines, Mesh, Picture, Theme, by_rank, halo_of

CIRCLE_SIDES = 24
OUTLINE: Colour = (128, 128, 128)  # of an area, which may be as light as the page
LOW_COST: Colour = (59, 82, 139)  # of COLOUR_MAP, at a quarter of the scale

HALO_WIDTH = 0.3  # by how much a halo is wider than its line, in halves of a symbol's edge
Curve = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Entry:
    """One mark of a legend."""

    name: str  # of the part of the picture that it explains
    text: str  # what the mark stands for
    paths: tuple[Curve, ...]  # its lines, each a sequence of corners from -1 to 1
    colour: Colour
    width: float = 0.26  # of its lines, in halves of the symbol's edge
    filled: bool = False  # whether the first path is filled
    halo: bool = True  # whether it has a halo, as in the scene
    halo_colour: Colour = (255, 255, 255)
    halo_width: float = HALO_WIDTH
    below: Entry | None = None  # another mark that it stands on


def _path(points: np.ndarray) -> Curve:
    return tuple((float(x), float(y)) for x, y in points[:, :2])


def _ring(radius: float, squeezed: float = 1.0) -> Curve:
    angles = 2 * np.pi * np.arange(CIRCLE_SIDES + 1) / CIRCLE_SIDES
    return _path(radius * np.column_stack([np.cos(angles), squeezed * np.sin(angles)]))


def _star(radius: float) -> tuple[Curve, ...]:
    return tuple(_path(pair) for pair in stars(np.zeros((1, 3)), radius))


def _diamond(radius: float) -> Curve:
    return ((radius, 0.0), (0.0, radius), (-radius, 0.0), (0.0, -radius), (radius, 0.0))


def _square(half: float) -> Curve:
    return ((-half, -half), (half, -half), (half, half), (-half, half), (-half, -half))


LEVEL: Curve = ((-0.9, 0.0), (0.9, 0.0))
MARKS = {
    entry.name: entry
    for entry in (
        Entry("microphones/ball", "this microphone", (_ring(0.5),), ESTIMATE, 0.1, filled=True),
        Entry("microphones/true", "true", (_ring(0.58),), TRUE, 0.22),
        Entry("microphones/estimate", "estimate", _star(0.75), ESTIMATE, 0.28),
        Entry("microphones/known", "known", (_square(0.5),), KNOWN, 0.1, filled=True),
        Entry("microphones/error", "error", (LEVEL,), TRUE, 0.14),
        Entry("lowest", "lowest cost", (_diamond(0.7),), LOWEST, 0.16, halo_width=0.16),
        Entry("minima", "other minimum", (_diamond(0.55),), LOWEST, 0.16, halo_width=0.16),
        # their halo shows on a dark page
        Entry("isosurfaces", "isosurface", (_ring(0.66), _ring(0.28)), LOW_COST, 0.2),
        Entry("slice", "slice", (_square(0.6),), LOW_COST, 0.1, filled=True),
        Entry("trails", "trail", (LEVEL,), TRAIL, 0.24, halo=False),
        Entry("ellipses", ELLIPSE_TEXT, (_ring(0.8, 0.5),), ELLIPSE, 0.24, halo=False),
        Entry("cut", "cut from A to B", (LEVEL,), CUT, 0.24, halo=False),
        Entry("microphones/faulty", "faulty channel", (_ring(0.66), ((-0.47, 0.47), (0.47, -0.47))), FAULTY, 0.2),
    )
}


def legend_of(picture: Picture) -> tuple[Entry, ...]:
    """Return the entries of a picture: areas of its map, the marks that can be seen in the order of MARKS."""
    seen = {part.name for part in (*picture.meshes, *picture.lines) if _is_visible(part)}
    seen |= {"isosurfaces"} if picture.surfaces else set()
    seen |= {plate.name for plate in picture.plates}
    captions = dict(picture.captions)
    entries = [entry for name, entry in MARKS.items() if name in seen]
    if picture.areas:  # the slice has the colours of the areas
        entries = [replace(entry, filled=False) if entry.name == "slice" else entry for entry in entries]
    if "microphones/true" in seen:  # a known microphone has its square in the circle
        known, circle = "microphones/known", MARKS["microphones/true"]
        entries = [
            replace(entry, paths=(_square(0.29),), below=circle) if entry.name == known else entry for entry in entries
        ]
    named = tuple(replace(entry, text=captions.get(entry.name, entry.text)) for entry in entries)
    square = (_square(0.75),)  # an area has a colour and no mark
    areas = (Entry(a.name, a.text, square, a.colour, 0.1, True, halo_colour=OUTLINE) for a in picture.areas)
    return (*areas, *named)


def _is_visible(part: Mesh | Lines) -> bool:
    """Whether a part has anything to be seen."""
    return bool(len(part.segments if isinstance(part, Lines) else part.faces))


SYMBOL, GAP, ROW = 18, 22, 27  # edge of a symbol, space between entries and height of a row, at a 16-pixel font
FINER = 4  # times finer than the image, for smooth edges


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
    """Write rows of entries, of `legend_rows`, over an image; `corner`: left and top of the first row, pixels."""
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
    for one in (entry.below, entry):
        if one is not None and one.halo:
            _draw_paths(draw, one, one.halo_colour, one.width + one.halo_width, size)
        if one is not None:
            _draw_paths(draw, one, one.colour, one.width, size)
    return image.resize((edge, edge), Image.Resampling.LANCZOS)


def _draw_paths(draw: ImageDraw.ImageDraw, entry: Entry, colour: Colour, width: float, size: int) -> None:
    for i, path in enumerate(entry.paths):
        pixels = [(float(x), float(y)) for x, y in size / 2 * (1 + np.array(path) * [1.0, -1.0])]
        if entry.filled and i == 0:
            draw.polygon(pixels, fill=colour)
        draw.line(pixels, fill=colour, width=max(round(width * size / 2), 1), joint="curve")


ANCHORS = {"left": "l", "center": "m", "right": "r", "top": "a", "bottom": "d"}  # of a label, to Pillow's
SMALLEST_FONT = 6  # pixels
LEGEND_EDGE = 20  # pixels left and right of the legend, at a 16-pixel font


def text_scale(size: tuple[int, int]) -> float:
    """Return the pixels of one point of text: an image 800 pixels high has a 16-pixel font, in the usual size."""
    return min(size[0] / 1000, size[1] / 800)


def font(points: float) -> ImageFont.FreeTypeFont:
    """Return the font of all texts in a size in pixels."""
    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(str(folder / "DejaVuSans.ttf"), max(points, SMALLEST_FONT))


def margins(picture: Picture, size: tuple[int, int]) -> tuple[float, float, float, float]:
    """Return the pixels that rulers, legend, colour bar and title take: left, bottom, right, top."""
    scale, right = text_scale(size), 40 if picture.bar is None else 160
    return 90 * scale, 62 * scale + legend_height(picture, size), right * scale, 104 * scale


def legend_height(picture: Picture, size: tuple[int, int]) -> float:
    """Return the pixels that the legend takes below a picture."""
    return len(_legend(picture, size)) * ROW * text_scale(size)


def _legend(picture: Picture, size: tuple[int, int]) -> tuple[tuple[Entry, ...], ...]:
    scale = text_scale(size)
    return legend_rows(legend_of(picture), size[0] - 2 * LEGEND_EDGE * scale, font(16 * scale))


def annotate(pixels: np.ndarray, picture: Picture, camera: Camera) -> np.ndarray:
    """Return a copy of an image (H, W, 3), made with `camera`, with all texts, the legend and the colour bar."""
    image = Image.fromarray(pixels)
    size, scale = image.size, text_scale(image.size)
    draw = ImageDraw.Draw(image)
    letters = font(16 * scale)
    for label, place in uncovered(draw, picture, camera, letters):
        outline = halo_of(label.colour, picture.theme)
        _write(draw, place, label.text, letters, label.colour, anchor(label), outline, scale)
    _draw_title(draw, picture, scale)
    corner = LEGEND_EDGE * scale, size[1] - legend_height(picture, size) - LEGEND_EDGE / 4 * scale
    draw_legend(image, _legend(picture, size), corner, letters, picture.theme)
    if picture.bar is not None:
        _draw_bar(draw, picture.bar, picture.theme, letters, _bar_place(picture, camera, size))
    return np.asarray(image)


def uncovered(draw, picture: Picture, camera: Camera, letters) -> list[tuple[Label, tuple[float, float]]]:
    """The texts of a scene and their pixels, without those that would cover one that comes before, as on the page."""
    labels, taken, seen = by_rank(picture.labels), [], []
    points = np.array([label.position for label in labels]).reshape(-1, 3)
    places = project(camera, draw.im.size, lifted(camera, points, [label.lift for label in labels])).tolist()
    heights = [y for label, (_, y) in zip(labels, places, strict=True) if label.name.startswith("frame/z")]
    upright = bool(heights) and max(heights) - min(heights) > 4 * letters.size
    for label, (x, y) in zip(labels, places, strict=True):
        if label.name.startswith("frame/z" if not upright else "frame/range"):
            continue
        a, b, c, d = draw.textbbox((x, y), label.text, font=letters, anchor=anchor(label))
        if all(a > right or c < left or b > bottom or d < top for left, top, right, bottom in taken):
            taken.append((a, b, c, d))
            seen.append((label, (x, y)))
    return seen


def anchor(label: Label) -> str:
    """Return the anchor of a text as Pillow has it."""
    vertical, horizontal = label.anchor.split("-")
    return ANCHORS[horizontal] + ANCHORS[vertical]


def _write(draw, place: tuple[float, float], text: str, letters, colour, anchor: str, outline, scale: float) -> None:
    width = max(round(2.5 * scale), 1)
    draw.text(place, text, fill=colour, font=letters, anchor=anchor, stroke_width=width, stroke_fill=outline)


def _draw_title(draw, picture: Picture, scale: float) -> None:
    """The title in the upper left corner, on a rectangle of the background's colour."""
    if not picture.title:
        return
    place, edge, points = (18 * scale, 13 * scale), 7 * scale, 19 * scale
    end = draw.multiline_textbbox(place, picture.title, font=font(points))[2]
    letters = font(points * min(1.0, (draw.im.size[0] - 2 * place[0]) / (end - place[0])))
    left, top, right, bottom = draw.multiline_textbbox(place, picture.title, font=letters)
    draw.rectangle([left - edge, top - edge, right + edge, bottom + edge], fill=picture.theme.background)
    draw.multiline_text(place, picture.title, font=letters, fill=picture.theme.foreground)


def _bar_place(picture: Picture, camera: Camera, size: tuple[int, int]) -> tuple[float, float, float]:
    """Left, top and bottom edge of the colour bar, pixels: beside the map from the top, at the image's edge in 3-D."""
    scale = text_scale(size)
    edge = size[0] - 126 * scale
    if camera.fov:
        return edge, 0.24 * size[1], 0.86 * size[1]
    corners = [(*picture.focus[:2], picture.z_range[0]), (*picture.focus[2:], picture.z_range[0])]
    (_, bottom), (right, top) = project(camera, size, corners)
    return min(right + 46 * scale, edge), top + 46 * scale, bottom


def _draw_bar(draw, bar: ColourBar, theme: Theme, letters, place: tuple[float, float, float]) -> None:
    """The colour bar with its ticks, and its label above."""
    scale = letters.size / 16
    left, top, bottom = place
    right, rows, stroke = left + 22 * scale, np.arange(round(top), round(bottom)), max(round(scale), 1)
    colours = matplotlib.colormaps[bar.colour_map]((bottom - rows) / (bottom - top), bytes=True)[:, :3]
    for row, colour in zip(rows, colours, strict=True):
        draw.line([(left, row), (right, row)], fill=tuple(map(int, colour)))
    draw.rectangle([left, top, right, bottom], outline=theme.foreground, width=stroke)
    for fraction, text in bar.ticks:
        row = bottom + fraction * (top - bottom)
        draw.line([(right, row), (right + 6 * scale, row)], fill=theme.foreground, width=stroke)
        _write(draw, (right + 10 * scale, row), text, letters, theme.foreground, "lm", theme.background, scale)
    label = bar.label.replace(" (", "\n(")
    draw.multiline_text((left - scale, top - 42 * scale), label, fill=theme.foreground, font=font(14 * scale))
