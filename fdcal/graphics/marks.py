"""The marks of a picture: one table of shape, colour, size and word, which every renderer reads.

True microphones are black circles, estimates red crosses, known microphones blue squares, the lowest cost of the map an
orange diamond, faulty channels violet circles with a bar. Marks differ in shape, and colour-blind readers can
distinguish their colours, too. A white halo around all but trails and ellipses keeps them legible on any background.

In a scene marks are flat meshes with a size in metres, not in pixels. In a legend they are symbols, either SVG or
images. Figures of matplotlib use a marker for some. The pages of replays and the film get the table as JSON. Lengths
are metres, colours RGB from 0 to 255.
"""

import enum
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from ..model.validation import frozen_array
from . import glyphs
from .primitives import Colour, Floor, Lines, Mesh, Theme, fractions

TRUE, ESTIMATE, KNOWN, HALO = (0, 0, 0), (214, 24, 40), (0, 90, 181), (255, 255, 255)
LOWEST = (255, 132, 0)
TRAIL, ELLIPSE, FAULTY = (240, 130, 200), (255, 110, 60), (128, 0, 255)
POINTED = (0, 130, 100)
SAME = (0, 0, 0), (0, 130, 60), (140, 0, 140)  # colours of lines of equal pressure
LOW_COST = (59, 82, 139)  # colour of COLOUR_MAP at a quarter of the scale
CIRCLE_SIDES = 24
Curve = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Mark:
    """One kind of mark."""

    name: str  # name of the part of a picture that the mark shows
    text: str  # its text in the legend; "" for a mark that the legend leaves out
    shape: str  # shape of its symbol, one of those in `paths`
    colour: Colour
    # reach, width, halo: in the scene, in radii of a marker: distance from its middle to its edge, width of its lines,
    # and by how much the halo is wider than the lines
    reach: float = 1.0
    width: float = 0.0
    halo: float = 0.34
    # size, line, line_halo: of the symbol: distance from its middle to its edge, width of its lines, and by how much
    # the halo is wider, in halves of the symbol's edge
    size: float = 0.9
    line: float = 0.24
    line_halo: float = 0.3  # 0 for no halo
    halo_colour: Colour = HALO
    filled: bool = False  # whether the first path of the symbol is filled
    below: "Mark | None" = None  # another mark that is drawn below it in the legend
    # marker, points, stroke: marker of matplotlib, its size and the width of its lines, points
    marker: str = ""
    points: float = 15.0
    stroke: float = 2.0

    @property
    def paths(self) -> tuple[Curve, ...]:
        """The lines of the symbol, each a sequence of corners from -1 to 1, y upwards."""
        angles = 2 * np.pi * np.arange(CIRCLE_SIDES + 1) / CIRCLE_SIDES
        circle, diagonal = np.column_stack([np.cos(angles), np.sin(angles)]), np.sqrt(0.5)
        corners = {
            "ring": [circle],
            "rings": [circle, 0.42 * circle],
            "ellipse": [circle * [1.0, 0.625]],
            "cross": diagonal * np.array([[[-1, -1], [1, 1]], [[1, -1], [-1, 1]]]),
            "square": [np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])],
            "diamond": [np.array([[1, 0], [0, 1], [-1, 0], [0, -1], [1, 0]])],
            "line": [np.array([[-1, 0], [1, 0]])],
            "barred ring": [circle, diagonal * np.array([[-1, 1], [1, -1]])],
        }[self.shape]
        return tuple(tuple((float(x), float(y)) for x, y in self.size * path) for path in corners)


MARKS = {
    mark.name: mark
    for mark in (
        Mark("microphones/ball", "this microphone", "ring", ESTIMATE, 1.7, size=0.5, line=0.1, filled=True),
        Mark("microphones/true", "true", "ring", TRUE, 1.0, 0.28, size=0.58, line=0.22, marker="o"),
        Mark("selected/true", "", "ring", TRUE, 1.9, 0.44),
        Mark(
            "microphones/estimate", "estimate", "cross", ESTIMATE, 1.0, 0.34,
            size=0.75, line=0.28, marker="x", points=11.0, stroke=2.5,
        ),
        Mark("selected/estimate", "", "cross", ESTIMATE, 1.9, 0.54),
        Mark(
            "microphones/known", "known", "square", KNOWN, 0.5, halo=0.3,
            size=0.5, line=0.1, filled=True, marker="s", points=13.5,
        ),
        Mark("microphones/error", "error", "line", TRUE, width=0.13, halo=0.2, line=0.14),
        Mark(
            "lowest", "lowest point", "diamond", LOWEST, 2.8, 0.45, 0.25,
            size=0.7, line=0.16, line_halo=0.16, marker="D", points=7.0,
        ),
        Mark(
            "minima", "other minimum", "diamond", LOWEST, 2.2, 0.45, 0.25,
            size=0.55, line=0.16, line_halo=0.16, marker="D", points=4.0, stroke=1.5,
        ),
        # its halo makes the symbol visible on a dark page
        Mark("isosurfaces", "isosurface", "rings", LOW_COST, size=0.66, line=0.2),
        Mark("trails", "trail", "line", TRAIL, line_halo=0.0),
        Mark("ellipses", "error ellipse (95 %)", "ellipse", ELLIPSE, size=0.8, line_halo=0.0),
        *(
            Mark(f"same/{i}", "measured pressure", "line", colour, width=0.34, halo=0.2, line=0.2, line_halo=0.0)
            for i, colour in enumerate(SAME)
        ),
        Mark("microphones/pointed", "named in the text", "ring", POINTED, 2.6, 0.3, size=0.66, line=0.14),
        Mark("microphones/faulty", "faulty channel", "barred ring", FAULTY, 2.4, 0.34, size=0.66, line=0.2),
    )
}  # fmt: skip


class Layer(enum.IntEnum):
    """Height of each mark over the floor, in layers: higher marks cover lower ones."""

    GRID = -4
    WALLS = 1
    FRAME = 2
    ERROR = 2
    TRAIL = 3
    TRUE = 4
    SOURCE = 4
    KNOWN = 6
    ELLIPSE = 7
    ESTIMATE = 8
    MINIMUM = 9
    FAULTY = 9
    SELECTED_TRUE = 10
    SELECTED = 12


LAYERS_PER_RADIUS = 24  # layers in the height of one radius of a marker


def layer_height(layer: int, marker_radius: float) -> float:
    """Return the height of a layer over the floor, metres."""
    return layer * marker_radius / LAYERS_PER_RADIUS


def on_layer(points, base: float, marker_radius: float, layer: int) -> np.ndarray:
    """Return points (P, 2) on the floor at height `base`, or (P, 3) in space, raised to a layer : (P, 3), metres."""
    return glyphs.lift(points, layer_height(layer, marker_radius) + (base if np.shape(points)[1] == 2 else 0.0))


def drape(points, floor: Floor | None, radius: float = 0.0) -> np.ndarray:
    """Return points (P, 2) with the height that a map in relief has there : (P, 3), metres.

    `radius`: radius of a flat mark at each point; the mark gets the largest of nine heights, at the point and on the
    square around the mark. Points stay unchanged if the map is flat or missing, or if they have a height already.
    """
    points = np.atleast_2d(np.asarray(points, float))
    if floor is None or floor.heights is None or points.shape[1] == 3:
        return points
    counts = np.array(floor.heights.shape[::-1])
    cell = np.divide(floor.size, counts)
    reach = (radius + float(cell.max()) / 2) * np.arange(-1, 2) if radius else np.zeros(1)
    around = np.stack(np.meshgrid(reach, reach), axis=-1).reshape(-1, 1, 2)
    place = (points + around - floor.origin) / cell - 0.5
    column, row = np.moveaxis(np.clip(np.rint(place), 0, counts - 1).astype(int), 2, 0)
    return np.column_stack([points, floor.height + floor.heights[row, column].max(axis=0)])


def lines(name: str, segments, colour: Colour, width: float) -> Lines:
    """Return frozen line segments (S, 2, 3), metres, `width` pixels wide."""
    return Lines(name, frozen_array(segments, np.float32), colour, width)


def mesh(name: str, triangles: glyphs.Triangles, colour: Colour, opacity: float = 1.0) -> Mesh:
    """Return a frozen mesh of vertices (V, 3), metres, and faces (F, 3)."""
    vertices, faces = triangles
    return Mesh(name, frozen_array(vertices, np.float32), frozen_array(faces, np.int32), colour, opacity)


def marked(name: str, places: np.ndarray, marker_radius: float) -> tuple[Mesh, Mesh]:
    """Return the halo and the mark of MARKS of that name at each of the places (P, 3), metres."""
    mark = MARKS[name]
    reach = mark.reach * marker_radius
    if mark.shape == "ring":
        width, halo = mark.width * marker_radius, mark.halo * marker_radius
        ring, wider = glyphs.annuli(places, reach, width), glyphs.annuli(places, reach, width + halo)
        return _with_halo(mark, ring, wider, marker_radius)
    if mark.shape == "square":
        wider = glyphs.squares(places, 2 * reach + mark.halo * marker_radius)
        return _with_halo(mark, glyphs.squares(places, 2 * reach), wider, marker_radius)
    pieces = np.concatenate([np.stack([path[:-1], path[1:]], axis=1) for path in map(np.array, mark.paths)])
    segments = places[:, None, None] + np.pad(reach / mark.size * pieces, ((0, 0), (0, 0), (0, 1)))
    return strokes(name, segments.reshape(-1, 2, 3), marker_radius)


def strokes(
    name: str, segments: np.ndarray, marker_radius: float, width: float | None = None, kind: str = ""
) -> tuple[Mesh, Mesh]:
    """Return the halo of bars along (S, 2, 3), metres, one layer below, and the bars as lines of a mark.

    `width`: width of the bars in radii of a marker, by default that of the mark; `kind`: name of the mark, by default
    `name`.
    """
    mark = MARKS[kind or name]
    width = mark.width if width is None else width
    wider = glyphs.strokes(segments, (width + mark.halo) * marker_radius, mark.halo / 2 * marker_radius)
    return _with_halo(mark, glyphs.strokes(segments, width * marker_radius), wider, marker_radius, name)


def _with_halo(
    mark: Mark, shape: glyphs.Triangles, wider: glyphs.Triangles, marker_radius: float, name: str = ""
) -> tuple[Mesh, Mesh]:
    """Return the halo of a mark, which is wider and lies one layer below, and the mark."""
    name, (vertices, faces) = name or mark.name, wider
    below = vertices - [0, 0, layer_height(1, marker_radius)], faces
    return mesh(f"{name}_halo", below, mark.halo_colour), mesh(name, shape, mark.colour)


def true_microphones(
    positions, z_range: tuple[float, float], marker_radius: float, theme: Theme
) -> tuple[Mesh | Lines, ...]:
    """Return circles at the true positions (N, 2 or 3), metres; in space with stems down to the floor."""
    base, top = z_range
    centres = on_layer(positions, base, marker_radius, Layer.TRUE)
    stems = (lines("microphones/stems", glyphs.stems(centres, base), theme.grid, 1.0),)
    return *marked("microphones/true", centres, marker_radius), *(stems if top > base else ())


FINER = 4  # factor by which a symbol is drawn larger and then reduced, for smooth edges
EDGE = 18  # width and height of the drawing of a symbol as SVG


def symbol(mark: Mark, edge: int) -> Image.Image:
    """Return the symbol of a mark on a transparent square of `edge` pixels."""
    size = FINER * edge
    image = Image.new("RGBA", (size, size))
    draw = ImageDraw.Draw(image)
    for path, colour, width, filled in _layers(mark):
        pixels = [(float(x), float(y)) for x, y in size / 2 * (1 + path)]
        if filled:
            draw.polygon(pixels, fill=colour)
        draw.line(pixels, fill=colour, width=max(round(width * size / 2), 1), joint="curve")
    return image.resize((edge, edge), Image.Resampling.LANCZOS)


def symbol_svg(mark: Mark) -> str:
    """Return the symbol of a mark as elements of SVG, in a square of EDGE by EDGE."""
    drawn = ""
    for path, colour, width, filled in _layers(mark):
        corners = "L".join(f"{x:.3g} {y:.3g}" for x, y in (path + 1) * EDGE / 2)
        fill = css(colour) if filled else "none"
        style = f"fill='{fill}' stroke='{css(colour)}' stroke-width='{width * EDGE / 2:.3g}'"
        drawn += f"<path d='M{corners}' {style} stroke-linejoin='round'/>"
    return drawn


def _layers(mark: Mark) -> Iterator[tuple[np.ndarray, Colour, float, bool]]:
    """Yield the lines of a symbol, its halo first: corners (P, 2), y downwards, colour, width, and whether filled."""
    for one in filter(None, (mark.below, mark)):
        halo = [(one.halo_colour, one.line + one.line_halo)] if one.line_halo else []
        for colour, width in (*halo, (one.colour, one.line)):
            for i, path in enumerate(one.paths):
                yield np.array(path) * [1.0, -1.0], colour, width, one.filled and i == 0


def css(colour) -> str:
    """Return a colour in the notation of CSS."""
    return f"rgb({int(colour[0])},{int(colour[1])},{int(colour[2])})"


def marks_json(names: dict[str, str]) -> dict[str, dict[str, Any]]:
    """Return marks as a script of a page reads them; `names`: names of the marks by their keys in the script."""
    marks = {key: MARKS[name] for key, name in names.items()}
    return {
        key: {name: getattr(mark, name) for name in ("text", "reach", "width", "halo")}
        | {"colour": css(mark.colour), "symbol": symbol_svg(mark)}
        for key, mark in marks.items()
    }


def plot_marks(panel: Any, name: str, places, scale: float = 1.0, label: str = "") -> None:
    """Draw a mark at places (P, 2), metres, into a panel of matplotlib; `label`: in the legend, by default its own."""
    if places is None or not len(places):
        return
    from matplotlib import patheffects

    mark, (x, y) = MARKS[name], np.reshape(places, (-1, 2)).T
    width = scale * mark.stroke
    halo = [patheffects.withStroke(linewidth=width + 2 * scale, foreground=fractions(mark.halo_colour))]
    panel.plot(
        x, y, mark.marker, color=fractions(mark.colour), label=label or mark.text, markersize=scale * mark.points,
        markeredgewidth=width, fillstyle="none", linestyle="none", path_effects=halo, clip_on=False,
        zorder=2.5 if mark.shape == "diamond" else 3.0,  # below a true position
    )  # fmt: skip
