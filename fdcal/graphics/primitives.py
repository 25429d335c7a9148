"""The primitives of a picture: lines, triangles, texts, a map on the floor with its colour bar.

Lengths are metres, colours RGB from 0 to 255. Frozen, arrays included; no renderer in sight.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from matplotlib.ticker import LogLocator

from .glyphs import round_ticks

COLOUR_MAP, DIVERGING_COLOUR_MAP = (
    "viridis",
    "RdBu_r",
)  # any name of matplotlib.colormaps; of costs, and of signed fields
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
LETTERS = 44  # that find room along a colour bar

Colour = tuple[int, int, int]


@dataclass(frozen=True)
class Theme:
    """Colours that depend on the background."""

    background: Colour
    foreground: Colour  # texts, rulers, walls
    grid: Colour  # the grid on the floor


LIGHT = Theme(background=(255, 255, 255), foreground=(40, 44, 52), grid=(222, 225, 230))
DARK = Theme(background=(26, 27, 30), foreground=(222, 225, 230), grid=(58, 61, 68))


@dataclass(frozen=True)
class Lines:
    """Segments (S, 2, 3) float32, metres, of one colour, `width` pixels wide."""

    name: str
    segments: np.ndarray
    colour: Colour
    width: float


@dataclass(frozen=True)
class Mesh:
    """Triangles of one colour, without shading: vertices (V, 3) float32, metres, faces (F, 3) int32."""

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    colour: Colour
    opacity: float = 1.0


@dataclass(frozen=True)
class Label:
    """A text at a point (3,), metres; `anchor` is the part of the text that lies there, as in "center-left"."""

    name: str
    text: str
    position: tuple[float, float, float]
    colour: Colour
    anchor: str = "center-center"


@dataclass(frozen=True)
class ColourBar:
    """Scale of a map: `low` at the first colour, `high` at the last, logarithmic or linear."""

    low: float
    high: float
    log: bool
    label: str
    clipped: bool = False  # lower values than `low` exist and share its colour
    colour_map: str = COLOUR_MAP

    @property
    def ticks(self) -> tuple[tuple[float, str], ...]:
        """Share of the bar from 0 to 1, and text, of about five round values."""
        if not self.log:
            values = round_ticks(self.low, self.high, 5)
            return _few((float((v - self.low) / (self.high - self.low)), format_number(v, 4)) for v in values)
        decades = np.log10(self.high / self.low)
        values = LogLocator(subs=(1.0,) if decades > 3 else (1.0, 2.0, 5.0)).tick_values(self.low, self.high)
        values = values[(values >= self.low * (1 - 1e-9)) & (values <= self.high * (1 + 1e-9))]
        if not 3 <= len(values) <= 6:  # within a decade the locator may give as many as ten
            even = round_ticks(self.low, self.high, 4)
            values = even[even >= self.low] if decades < 3 else values
        return _few(
            (float(np.log10(v / self.low) / decades), format_number(v, 3 if decades > 0.05 else 5)) for v in values
        )


def format_number(value: float, digits: int) -> str:
    """A number with so many digits that count: whole ones up to a million are written out, others as in 2·10⁷."""
    if 10.0**digits <= abs(value) < 1e6:
        return f"{value:.0f}"
    mantissa, _, power = f"{value:.{digits}g}".partition("e")
    if not power:
        return mantissa
    return ("" if mantissa == "1" else f"{mantissa}·") + f"10{str(int(power)).translate(SUPERSCRIPTS)}"


def _few(ticks: Iterable[tuple[float, str]]) -> tuple[tuple[float, str], ...]:
    """Those that find room: each is left out whose text would touch that of the one before it."""
    kept: list[tuple[float, str]] = []
    for share, text in ticks:
        if not kept or (share - kept[-1][0]) * LETTERS >= (len(text) + len(kept[-1][1])) / 2 + 2:
            kept.append((share, text))
    return tuple(kept)


@dataclass(frozen=True)
class Floor:
    """A map on the floor: `rgb` (ny, nx, 3) uint8 with row 0 at low y, its lowest corner and size, metres.

    `minimum` is where its lowest cost stands, `minima` where its local minima do, metres; `height` is that of the map,
    metres. `heights` (ny, nx) float32, metres above that, makes it a relief.
    """

    rgb: np.ndarray
    origin: tuple[float, float]
    size: tuple[float, float]
    bar: ColourBar
    minimum: tuple[float, float]
    height: float = 0.0
    minima: tuple[tuple[float, float], ...] = ()
    opacity: float = 1.0
    show_minima: bool = True  # with diamonds
    heights: np.ndarray | None = None


@dataclass(frozen=True)
class Picture:
    """Everything to draw, in no renderer's terms.

    `focus` is the box (x0, y0, x1, y1), metres, to be filled, `heights` its lowest and highest z, which differ where
    the microphones stand in space. What is flat, as the map, lies at the lowest.
    """

    theme: Theme
    focus: tuple[float, float, float, float]
    bounds: tuple[float, float, float, float]
    marker_radius: float  # radius of a microphone's circle, metres
    lines: tuple[Lines, ...] = ()
    meshes: tuple[Mesh, ...] = ()
    labels: tuple[Label, ...] = ()
    floor: Floor | None = None
    title: str = ""
    z_range: tuple[float, float] = (0.0, 0.0)
