"""The primitives of a picture: lines, triangles, texts, a map on the floor.

Lengths are metres, colours RGB from 0 to 255. Everything is frozen, the arrays included, and independent of a renderer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from .colour_bar import ColourBar
from .solids import Plate, Surface
from .theme import Colour, Theme

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
