"""The primitives of a picture: lines, triangles, texts, a map on the floor with its colour bar.

Lengths are metres, colours RGB from 0 to 255. Everything is frozen, the arrays included, and independent of a renderer.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from matplotlib.ticker import LogLocator

from .glyphs import round_ticks
from .solids import Plate, Surface

COLOUR_MAP = "viridis"  # of matplotlib.colormaps, for costs
DIVERGING_COLOUR_MAP = "RdBu_r"  # likewise, for fields of both signs
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
BAR_LENGTH = 44  # characters that fit along a colour bar

Colour = tuple[int, int, int]
Anchor = Literal[
    "top-left",
    "top-center",
    "top-right",
    "center-left",
    "center-center",
    "center-right",
    "bottom-left",
    "bottom-center",
    "bottom-right",
]


@dataclass(frozen=True)
class Theme:
    """Colours that depend on the background.

    Attributes
    ----------
    background : Colour
    foreground : of texts, rulers and walls
    grid : of the grid on the floor
    text : size of the texts, 1 for the usual one
    marks : size of the marks, likewise
    """

    background: Colour
    foreground: Colour
    grid: Colour
    text: float = 1.0
    marks: float = 1.0


LIGHT = Theme(background=(255, 255, 255), foreground=(40, 44, 52), grid=(222, 225, 230))
DARK = Theme(background=(26, 27, 30), foreground=(222, 225, 230), grid=(58, 61, 68))
# For a projector: large, and with as much contrast as there is.
LECTURE_LIGHT = Theme(background=(255, 255, 255), foreground=(0, 0, 0), grid=(168, 172, 180), text=1.5, marks=1.4)
LECTURE_DARK = Theme(background=(26, 27, 30), foreground=(255, 255, 255), grid=(112, 116, 124), text=1.5, marks=1.4)


def theme_of(dark: bool, lecture: bool = False) -> Theme:
    """Return the theme of a dark or light background, for a projector or not."""
    if lecture:
        return LECTURE_DARK if dark else LECTURE_LIGHT
    return DARK if dark else LIGHT


@dataclass(frozen=True)
class Lines:
    """Line segments of one colour.

    Attributes
    ----------
    name : unique in a picture
    segments : (S, 2, 3) float32, metres
    colour : Colour
    width : pixels
    """

    name: str
    segments: np.ndarray
    colour: Colour
    width: float


@dataclass(frozen=True)
class Mesh:
    """Triangles of one colour, without shading.

    Attributes
    ----------
    name : unique in a picture
    vertices : (V, 3) float32, metres
    faces : (F, 3) int32, indices of vertices
    colour : Colour
    opacity : 0 to 1
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    colour: Colour
    opacity: float = 1.0


@dataclass(frozen=True)
class Label:
    """A text at a point.

    Attributes
    ----------
    name : unique in a picture
    text : str
    position : (3,), metres
    colour : Colour
    anchor : the part of the text that lies at the point, as in "center-left"
    """

    name: str
    text: str
    position: tuple[float, float, float]
    colour: Colour
    anchor: Anchor = "center-center"


@dataclass(frozen=True)
class ColourBar:
    """The scale of a map.

    Attributes
    ----------
    low, high : values of the first and of the last colour
    log : whether the scale is logarithmic
    label : name and unit
    clipped : whether lower values than `low` exist, which share its colour
    colour_map : of matplotlib.colormaps
    """

    low: float
    high: float
    log: bool
    label: str
    clipped: bool = False
    colour_map: str = COLOUR_MAP

    @property
    def ticks(self) -> tuple[tuple[float, str], ...]:
        """Fraction of the bar's length, 0 to 1, and text of about five round values."""
        if not self.log:
            values = round_ticks(self.low, self.high, 5)
            span = self.high - self.low
            return _without_overlaps((float((v - self.low) / span), format_number(v, 4)) for v in values)
        decades = np.log10(self.high / self.low)
        values = self._round_values((1.0, 2.0, 5.0) if decades <= 3 else (1.0,))
        if len(values) > 6 and 2 < decades <= 3:
            values = self._round_values((1.0, 3.0))
        if decades <= 2 and not 3 <= len(values) <= 6:  # within a decade the locator may return as many as ten
            even = round_ticks(self.low, self.high, 4)
            values = even[even >= self.low]
        digits = 3 if decades > 0.05 else 5
        return _without_overlaps((float(np.log10(v / self.low) / decades), format_number(v, digits)) for v in values)

    def _round_values(self, mantissas: tuple[float, ...]) -> np.ndarray:
        """Return the values of the scale that are one of the mantissas times a power of ten."""
        values = np.asarray(LogLocator(subs=mantissas).tick_values(self.low, self.high))
        return values[(values >= self.low * (1 - 1e-9)) & (values <= self.high * (1 + 1e-9))]


def format_number(value: float, digits: int) -> str:
    """Return a number with so many significant digits.

    Whole numbers up to a million are written in full, very large and very small numbers as in "2·10⁷".
    """
    if 10.0**digits <= abs(value) < 1e6:
        return f"{value:.0f}"
    mantissa, _, power = f"{value:.{digits}g}".partition("e")
    if not power:
        return mantissa
    return ("" if mantissa == "1" else f"{mantissa}·") + f"10{str(int(power)).translate(SUPERSCRIPTS)}"


def _without_overlaps(ticks: Iterable[tuple[float, str]]) -> tuple[tuple[float, str], ...]:
    """The ticks without those whose text would touch the text before."""
    kept: list[tuple[float, str]] = []
    for fraction, text in ticks:
        if not kept or (fraction - kept[-1][0]) * BAR_LENGTH >= (len(text) + len(kept[-1][1])) / 2 + 2:
            kept.append((fraction, text))
    return tuple(kept)


@dataclass(frozen=True)
class Area:
    """What one colour of a map without a scale stands for.

    Attributes
    ----------
    name : unique in a picture
    text : in the legend
    colour : Colour
    """

    name: str
    text: str
    colour: Colour


@dataclass(frozen=True)
class Floor:
    """A map on the floor.

    Attributes
    ----------
    rgb : (ny, nx, 3) uint8, row 0 at low y
    origin, size : lowest corner and extent in x and y, metres
    bar : ColourBar; None where the colours stand for areas
    minimum : where the cost is lowest, metres
    height : of the map, metres
    minima : where the other local minima are, metres
    opacity : 0 to 1
    show_minima : whether diamonds mark the minima
    heights : (ny, nx) float32, metres above `height`, of a map in relief; None of a flat one
    areas : what the colours of a map without a bar stand for
    """

    rgb: np.ndarray
    origin: tuple[float, float]
    size: tuple[float, float]
    bar: ColourBar | None
    minimum: tuple[float, float]
    height: float = 0.0
    minima: tuple[tuple[float, float], ...] = ()
    opacity: float = 1.0
    show_minima: bool = True
    heights: np.ndarray | None = None
    areas: tuple[Area, ...] = ()


@dataclass(frozen=True)
class Picture:
    """Everything to draw, independent of a renderer.

    Attributes
    ----------
    theme : Theme
    focus : box (x0, y0, x1, y1), metres, that fills the image from the top
    bounds : box (x0, y0, x1, y1) of the room, metres
    marker_radius : radius of a microphone's circle, metres
    lines, meshes, labels : of which each name is unique
    floor : the map, or None
    title : str
    z_range : lowest and highest z, metres, which differ where the microphones are in space; the map lies at the lowest
    surfaces, plates : isosurfaces and slices in space
    space_bar : ColourBar, of surfaces and plates, or None
    captions : pairs of the name of a part and the words for it in the legend, where they differ from the usual ones
    space_areas : what the colours of a slice without a bar stand for
    """

    theme: Theme
    focus: tuple[float, float, float, float]
    bounds: tuple[float, float, float, float]
    marker_radius: float
    lines: tuple[Lines, ...] = ()
    meshes: tuple[Mesh, ...] = ()
    labels: tuple[Label, ...] = ()
    floor: Floor | None = None
    title: str = ""
    z_range: tuple[float, float] = (0.0, 0.0)
    surfaces: tuple[Surface, ...] = ()
    plates: tuple[Plate, ...] = ()
    space_bar: ColourBar | None = None
    captions: tuple[tuple[str, str], ...] = ()
    space_areas: tuple[Area, ...] = ()

    @property
    def bar(self) -> ColourBar | None:
        """The scale of the colours of the map, or of what is in space; None where there is neither."""
        return self.space_bar if self.floor is None else self.floor.bar

    @property
    def areas(self) -> tuple[Area, ...]:
        """What the colours of a map or slice without a scale stand for."""
        return self.space_areas if self.floor is None else self.floor.areas
