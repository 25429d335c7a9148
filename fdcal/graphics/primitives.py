"""The parts of a picture: colours and their scale, lines, triangles, texts, a map on the floor, surfaces in space.

Lengths are metres, colours RGB from 0 to 255. Everything is frozen, also the arrays, and independent of a renderer; the
colours contain the shading, and renderers add no light.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from .glyphs import round_ticks

Colour = tuple[int, int, int]


def mixed(one: Colour, other: Colour, fraction: float) -> Colour:
    """Return the colour at `fraction` of the way from one colour to the other."""
    red, green, blue = (round((1 - fraction) * a + fraction * b) for a, b in zip(one, other, strict=True))
    return red, green, blue


@dataclass(frozen=True)
class Theme:
    """Colours that depend on the background."""

    background: Colour
    foreground: Colour  # colour of texts, rulers and walls
    grid: Colour  # colour of the grid on the floor
    text: float = 1.0  # size of the texts, 1 for the usual one
    marks: float = 1.0  # size of the marks, 1 for the usual one


LIGHT = Theme(background=(255, 255, 255), foreground=(40, 44, 52), grid=(222, 225, 230))
DARK = Theme(background=(26, 27, 30), foreground=(222, 225, 230), grid=(58, 61, 68))
# For a projector: large, and with the greatest contrast.
LECTURE_LIGHT = Theme(background=(255, 255, 255), foreground=(0, 0, 0), grid=(168, 172, 180), text=1.5, marks=1.4)
LECTURE_DARK = Theme(background=(26, 27, 30), foreground=(255, 255, 255), grid=(112, 116, 124), text=1.5, marks=1.4)
# By whether the page is dark: the usual theme, and that for a projector.
THEMES = {False: (LIGHT, LECTURE_LIGHT), True: (DARK, LECTURE_DARK)}


def fractions(colour: Colour) -> tuple[float, float, float]:
    """Return a colour for matplotlib and VTK: red, green and blue from 0 to 1."""
    red, green, blue = colour
    return red / 255, green / 255, blue / 255


COLOUR_MAP = "viridis"  # name of the map for costs, in matplotlib.colormaps
DIVERGING_COLOUR_MAP = "RdBu_r"  # name of the map for fields of both signs
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
BAR_LENGTH = 44  # characters that fit along a colour bar


@dataclass(frozen=True)
class ColourBar:
    """The scale of a map."""

    # low, high: values of the first and of the last colour; lower and higher values have the same colours
    low: float
    high: float
    label: str  # name and unit
    colour_map: str = COLOUR_MAP  # name of a map in matplotlib.colormaps

    @property
    def ticks(self) -> tuple[tuple[float, str], ...]:
        """Fraction of the bar's length, 0 to 1, and text of each of about five round values; no texts touch.

        Whole numbers up to a million are written in full; larger numbers and small fractions have the form "2·10⁷".
        """
        kept: list[tuple[float, str]] = []
        for value in round_ticks(self.low, self.high, 5).tolist():
            fraction, text = (value - self.low) / (self.high - self.low), f"{value:z.4g}"
            mantissa, _, power = text.partition("e")
            if 1e4 <= abs(value) < 1e6:
                text = f"{value:.0f}"
            elif power:
                text = ("" if mantissa == "1" else f"{mantissa}·") + f"10{str(int(power)).translate(SUPERSCRIPTS)}"
            if not kept or (fraction - kept[-1][0]) * BAR_LENGTH >= (len(text) + len(kept[-1][1])) / 2 + 2:
                kept.append((fraction, text))
        return tuple(kept)


@dataclass(frozen=True)
class Surface:
    """Triangles coloured by a texture."""

    name: str  # unique in a picture
    vertices: np.ndarray  # (V, 3) float32, metres
    faces: np.ndarray  # (F, 3) int32, indices of vertices, in the order in which they are to be drawn
    places: np.ndarray  # (V, 2) float32, column and row in the texture, 0 to 1
    texture: np.ndarray  # (h, w, 4) uint8, RGB and opacity


Anchor = Literal[
    "top-left", "top-center", "top-right", "center-left", "center-center", "center-right",
    "bottom-left", "bottom-center", "bottom-right",
]  # fmt: skip


@dataclass(frozen=True)
class Lines:
    """Line segments of one colour."""

    name: str  # unique in a picture
    segments: np.ndarray  # (S, 2, 3) float32, metres
    colour: Colour
    width: float  # pixels


@dataclass(frozen=True)
class Mesh:
    """Triangles of one colour, without shading."""

    name: str  # unique in a picture
    vertices: np.ndarray  # (V, 3) float32, metres
    faces: np.ndarray  # (F, 3) int32, indices of vertices
    colour: Colour
    opacity: float = 1.0  # 0 to 1


@dataclass(frozen=True)
class Label:
    """A text at a point, in the foreground colour of the picture's theme and outlined in its background colour."""

    name: str  # unique in a picture
    text: str
    position: tuple[float, float, float]  # (3,), metres
    anchor: Anchor = "center-center"  # the part of the text that lies at the point, such as "center-left"
    lift: float = 0.0  # metres by which the text is moved up in the image, in any view


def by_rank(labels: Iterable[Label]) -> list[Label]:
    """Return texts by priority: names, axes, numbers, texts of z; a text hides later ones that overlap it."""
    names, numbers = [], []
    for label in labels:
        (numbers if label.name.startswith("frame/") else names).append(label)
    names.sort(key=lambda label: label.name != "selected/name")
    return names + sorted(numbers, key=lambda label: (label.name.startswith("frame/z"), len(label.name)))


@dataclass(frozen=True)
class Curve:
    """A line on a map."""

    text: str  # text in the legend
    segments: np.ndarray  # (S, 2, 2) float32, metres


@dataclass(frozen=True)
class Floor:
    """A map on the floor."""

    rgb: np.ndarray  # (ny, nx, 3) uint8, row 0 at low y
    # origin, size: lowest corner and extent in x and y, metres
    origin: tuple[float, float]
    size: tuple[float, float]
    bar: ColourBar
    lowest: tuple[tuple[float, float], ...]  # positions of the lowest cost and of minima that fit as well, metres
    height: float = 0.0  # metres, height of the map
    minima: tuple[tuple[float, float], ...] = ()  # positions of the other local minima, metres
    show_minima: bool = True  # whether diamonds mark the minima
    heights: np.ndarray | None = None  # (ny, nx) float32, metres above `height`, of a relief; None for a flat map
    curves: tuple[Curve, ...] = ()  # lines on a flat map, three at most
    captions: tuple[tuple[str, str], ...] = ()  # see `Picture.captions`


@dataclass(frozen=True)
class Picture:
    """Everything to draw, independent of a renderer."""

    theme: Theme
    focus: tuple[float, float, float, float]  # box (x0, y0, x1, y1), metres, that fills the image from the top
    bounds: tuple[float, float, float, float]  # box (x0, y0, x1, y1) of the room, metres
    marker_radius: float  # radius of a microphone's circle, metres
    # lines, meshes, labels: each name is unique
    lines: tuple[Lines, ...] = ()
    meshes: tuple[Mesh, ...] = ()
    labels: tuple[Label, ...] = ()
    floor: Floor | None = None  # the map, or None
    title: str = ""
    # lowest and highest z, metres, which differ for an array in space; the map lies at the lowest
    z_range: tuple[float, float] = (0.0, 0.0)
    surfaces: tuple[Surface, ...] = ()  # isosurfaces in space
    # pairs of the name of a part and its text in the legend, if it is not that of `fdcal.graphics.marks`
    captions: tuple[tuple[str, str], ...] = ()

    def plus(self, *parts: Lines | Mesh | Label) -> "Picture":
        """Return the picture with more parts, each after those of its kind."""
        return replace(
            self,
            lines=self.lines + tuple(part for part in parts if isinstance(part, Lines)),
            meshes=self.meshes + tuple(part for part in parts if isinstance(part, Mesh)),
            labels=self.labels + tuple(part for part in parts if isinstance(part, Label)),
        )

    @property
    def bar(self) -> ColourBar | None:
        """The scale of the colours of the map; None without one."""
        return None if self.floor is None else self.floor.bar
