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
    """A text at a point."""

    name: str  # unique in a picture
    text: str
    position: tuple[float, float, float]  # (3,), metres
    colour: Colour
    anchor: Anchor = "center-center"  # the part of the text that lies at the point, as in "center-left"


@dataclass(frozen=True)
class Area:
    """What one colour of a map without a scale stands for."""

    name: str  # unique in a picture
    text: str  # in the legend
    colour: Colour


@dataclass(frozen=True)
class Floor:
    """A map on the floor."""

    rgb: np.ndarray  # (ny, nx, 3) uint8, row 0 at low y
    # origin, size: lowest corner and extent in x and y, metres
    origin: tuple[float, float]
    size: tuple[float, float]
    bar: ColourBar | None  # ColourBar; None where the colours stand for areas
    minimum: tuple[float, float]  # where the cost is lowest, metres
    height: float = 0.0  # of the map, metres
    minima: tuple[tuple[float, float], ...] = ()  # where the other local minima are, metres
    opacity: float = 1.0  # 0 to 1
    show_minima: bool = True  # whether diamonds mark the minima
    heights: np.ndarray | None = None  # (ny, nx) float32, metres above `height`, of a map in relief; None of a flat one
    areas: tuple[Area, ...] = ()  # what the colours of a map without a bar stand for


@dataclass(frozen=True)
class Picture:
    """Everything to draw, independent of a renderer."""

    theme: Theme
    focus: tuple[float, float, float, float]  # box (x0, y0, x1, y1), metres, that fills the image from the top
    bounds: tuple[float, float, float, float]  # box (x0, y0, x1, y1) of the room, metres
    marker_radius: float  # radius of a microphone's circle, metres
    # lines, meshes, labels: of which each name is unique
    lines: tuple[Lines, ...] = ()
    meshes: tuple[Mesh, ...] = ()
    labels: tuple[Label, ...] = ()
    floor: Floor | None = None  # the map, or None
    title: str = ""
    # lowest and highest z, metres, which differ where the microphones are in space; the map lies at the lowest
    z_range: tuple[float, float] = (0.0, 0.0)
    # surfaces, plates: isosurfaces and slices in space
    surfaces: tuple[Surface, ...] = ()
    plates: tuple[Plate, ...] = ()
    space_bar: ColourBar | None = None  # of surfaces and plates, or None
    # pairs of the name of a part and the words for it in the legend, where they differ from the usual ones
    captions: tuple[tuple[str, str], ...] = ()
    space_areas: tuple[Area, ...] = ()  # what the colours of a slice without a bar stand for

    @property
    def bar(self) -> ColourBar | None:
        """The scale of the colours of the map, or of what is in space; None where there is neither."""
        return self.space_bar if self.floor is None else self.floor.bar

    @property
    def areas(self) -> tuple[Area, ...]:
        """What the colours of a map or slice without a scale stand for."""
        return self.space_areas if self.floor is None else self.floor.areas
