"""Costs over the search lattice as colours, heights and a scale, and basins of attraction as areas: maps on a floor.

A map in relief has its shading in its colours, no renderer adds light: it comes from the upper left, as on a geographic
map. Lengths are metres.
"""

from __future__ import annotations

import functools
import re
from typing import TYPE_CHECKING

import matplotlib
import numpy as np

from ..cost.scale import DECADES, LEAST_RANGE, OUTSIDE, Minima
from ..model.settings import Search
from ..model.validation import frozen_array, length_text
from .primitives import COLOUR_MAP, Area, Colour, ColourBar, Floor, Mesh, Theme, mixed

if TYPE_CHECKING:
    from ..cost.basins import Basins  # with compiled code, which a map of costs does not need

TOWARDS_LIGHT = np.array([-0.55, 0.55, 0.63])
DARKEST = 0.55  # brightness of a slope that the light does not reach
BRIGHTEST = 0.3  # fraction of white on a slope that faces the light


def shaded(rgb: np.ndarray, heights: np.ndarray, step: float) -> np.ndarray:
    """Return the colours of a map (ny, nx, 3) as the light makes them; level ground keeps its colour; metres."""
    rise_y, rise_x = np.gradient(np.asarray(heights, float), step)
    light = TOWARDS_LIGHT / TOWARDS_LIGHT[2]  # level ground has the brightness 1
    brightness = (1.0 - rise_x * light[0] - rise_y * light[1]) / np.sqrt(1.0 + rise_x**2 + rise_y**2)
    dark = (DARKEST + (1 - DARKEST) * np.clip(brightness, 0.0, 1.0))[..., None]
    white = (BRIGHTEST * np.clip(brightness - 1.0, 0.0, 1.0))[..., None]
    return np.rint((1 - white) * dark * rgb + white * 255).astype(np.uint8)


def relief_grid(floor: Floor, heights: np.ndarray) -> np.ndarray:
    """Return the surface of a map of heights (ny, nx) above its own : points (ny + 2, nx + 2, 3) float64, metres.

    It goes through the middles of the cells and up to the edges of the map.
    """
    x, y = np.meshgrid(*(
        low + length * np.concatenate([[0.0], (np.arange(count) + 0.5) / count, [1.0]])
        for low, length, count in zip(floor.origin, floor.size, heights.shape[::-1], strict=True)
    ))  # fmt: skip
    return np.stack([x, y, floor.height + np.pad(np.asarray(heights, float), 1, mode="edge")], axis=-1)


SIDES = (0.28, 0.4)  # of the way from the background to the texts: shades of the sides across x and across y


def relief_sides(floor: Floor, theme: Theme) -> tuple[Mesh, ...]:
    """Return the sides of a map in relief, down to its level, which make it a block: two shades, by the same light."""
    if floor.heights is None:
        raise ValueError("a flat map has no sides")
    rim, meshes = relief_grid(floor, floor.heights), []
    for name, fraction, edges in (("x", SIDES[0], (rim[:, 0], rim[:, -1])), ("y", SIDES[1], (rim[0], rim[-1]))):
        top = np.stack(edges)
        foot = top * [1, 1, 0] + [0, 0, floor.height]
        count = top.shape[1]
        corner = (np.arange(count - 1) + np.array([[0], [2 * count]])).ravel()[:, None]
        faces = np.concatenate([corner + [0, 1, count + 1], corner + [0, count + 1, count]])
        vertices = np.stack([top, foot], axis=1).reshape(-1, 3)
        shape = frozen_array(vertices, np.float32), frozen_array(faces, np.int32)
        meshes.append(Mesh(f"relief_sides/{name}", *shape, mixed(theme.background, theme.foreground, fraction)))
    return tuple(meshes)


RELIEF_HEIGHT = 0.22  # height of the highest cost over the longer side of the map; low, so that no hill hides a hole


def cost_floor(
    cost,
    search: Search,
    log: bool = False,
    label: str = "cost (dimensionless)",
    *,
    minima: Minima | None = None,
    relief: bool = False,
    height: float = 0.0,
) -> Floor:
    """Return a map of costs over the search lattice, or over one layer of it; a pixel is one lattice cell.

    `cost` (ny, nx) float64, row 0 at low y; `log`: whether the scale is in decibels re 1, over DECADES decades at most;
    linear if no cost is positive; `label`: name and unit of the cost; `minima`: to be marked, only the lowest cost
    unless given; `relief`: whether the map has heights, which rise with the cost, and is shaded; `height`: of the map,
    metres.
    """
    cost = np.asarray(cost, float)
    iy, ix = np.unravel_index(cost.argmin(), cost.shape)
    minimum = (float(search.origin[0] + ix * search.step), float(search.origin[1] + iy * search.step))
    lowest, others = ((minimum,), ()) if minima is None else marks_of(minima)
    low, high = colour_limits(cost, log)
    rgb = to_rgb(normalise(cost, low, high, log))
    if log and low > 0:
        low, high = 10 * float(np.log10(low)), 10 * float(np.log10(high))
        label = re.sub(r"\((dimensionless|pressure squared)\)", "(dB)", label)
    heights = None
    if relief:
        fractions = normalise(cost, *colour_limits(cost, log, WHOLE), log)
        heights = frozen_array(RELIEF_HEIGHT * (max(cost.shape) * search.step) * fractions, np.float32)
        rgb = shaded(rgb, heights, search.step)
    bar = ColourBar(low, high, label)
    return lattice_floor(rgb, search, cost.shape, bar, lowest, height, minima=others, heights=heights)


def lattice_floor(
    rgb: np.ndarray, search: Search, shape: tuple[int, ...], bar: ColourBar | None, lowest, height: float, **more
) -> Floor:
    """Return a map over the cells of a lattice of (ny, nx) nodes, each in the middle of its cell."""
    (ny, nx), step = shape, search.step
    origin = (search.origin[0] - step / 2, search.origin[1] - step / 2)
    return Floor(frozen_array(rgb, np.uint8), origin, (nx * step, ny * step), bar, lowest, height, **more)


def marks_of(minima: Minima) -> tuple[tuple[tuple[float, float], ...], tuple[tuple[float, float], ...]]:
    """Return where the lowest costs and the other minima are marked on a floor, (x, y) in metres."""
    lowest, others = (tuple((float(p[0]), float(p[1])) for p in places) for places in (minima.lowest, minima.others))
    return lowest, others


SHOWN, WHOLE = (2.0, 98.0), (0.0, 100.0)  # percentiles of the costs between which colours differ; and heights


def colour_limits(cost: np.ndarray, log: bool, percentiles: tuple[float, float] = SHOWN) -> tuple[float, float]:
    """Return the costs of the first and the last colour, `percentiles` of all; lower and higher costs share these."""
    low, high = map(float, np.percentile(cost, percentiles))
    if log and high > 0 <= low:
        low = max(low, high * 10.0**-DECADES)
    high = max(high, low * 10.0 ** (LEAST_RANGE / 10))
    if high <= low:
        high = low + 1e-6 * abs(low) + 1e-12  # a constant map needs a scale, too
    return low, high


def normalise(cost: np.ndarray, low: float, high: float, log: bool) -> np.ndarray:
    """Return where on a scale from `low` to `high` each cost lies, 0 to 1."""
    cost = np.clip(cost, low, high)
    if log and low > 0:
        return np.log10(cost / low) / np.log10(high / low)
    return (cost - low) / (high - low)


def to_rgb(fractions: np.ndarray, name: str = COLOUR_MAP) -> np.ndarray:
    """Return the colours (..., 3) uint8 of fractions of the scale, 0 to 1, in a map of matplotlib.colormaps."""
    return _colour_table(name)[np.rint(255 * fractions).astype(np.uint8)]


@functools.cache
def _colour_table(name: str) -> np.ndarray:
    """Return the colours (256, 3) uint8 of a map of matplotlib.colormaps."""
    return matplotlib.colormaps[name](np.arange(256), bytes=True)[:, :3].copy()


# Colours of basins of attraction, with a legend of areas in place of a colour bar: the basin of one place, such as the
# true position, has the first colour; the largest of the others have one each, and those that remain share a grey. Dark
# lines separate basins, also where two of them are grey.
PLACE: Colour = (68, 170, 153)  # of the basin of one place
LARGEST: tuple[Colour, ...] = ((136, 204, 238), (221, 204, 119), (153, 68, 85), (108, 140, 213), (160, 120, 74))
OTHERS: Colour = (200, 200, 200)
EDGE: Colour = (246, 246, 246)  # of places from which descent ends at the edge of the map
BORDER: Colour = (30, 32, 38)  # between basins
BASIN_PIXELS = 500  # at least, along the longer edge of the image
_OTHERS, _EDGE, _BORDER = 1 + len(LARGEST), 2 + len(LARGEST), 3 + len(LARGEST)
TABLE = np.array((PLACE, *LARGEST, OTHERS, EDGE, BORDER), np.uint8)


def basin_image(
    basins: Basins, here: int, name: str, labels: np.ndarray | None = None
) -> tuple[np.ndarray, tuple[Area, ...]]:
    """Return numbers (h, w) uint8 of colours of TABLE, row 0 at low y, and what they stand for, in the legend's order.

    `labels` (h, w): of a slice through a volume; `here`: the basin that has the first colour, of the place `name`;
    OUTSIDE for no such basin.
    """
    labels = basins.labels if labels is None else labels
    finer = -(-BASIN_PIXELS // max(labels.shape))
    labels = labels.repeat(finer, axis=0).repeat(finer, axis=1)
    shares = basins.shares
    by_size = [int(k) for k in np.argsort(-shares, kind="stable") if k != here and shares[k] > 0]
    table = np.full(len(basins.minima) + 1, _OTHERS, np.uint8)  # its last entry is that of OUTSIDE
    table[by_size[: len(LARGEST)]] = np.arange(1, 1 + len(by_size[: len(LARGEST)]))
    table[OUTSIDE] = _EDGE
    if here != OUTSIDE:
        table[here] = 0
    border = np.zeros(labels.shape, bool)
    border[:, 1:] |= labels[:, 1:] != labels[:, :-1]
    border[1:] |= labels[1:] != labels[:-1]
    numbers = np.where(border, np.uint8(_BORDER), table[labels])
    areas = [] if here == OUTSIDE else [Area("basins/place", f"basin of the {name} {_percent(shares[here])}", PLACE)]
    for i, (k, colour) in enumerate(zip(by_size, LARGEST, strict=False)):
        areas.append(Area(f"basins/{i}", f"basin {_percent(shares[k])}", colour))
    if rest := by_size[len(LARGEST) :]:
        text = f"{len(rest)} other{'s' if len(rest) > 1 else ''} {_percent(shares[rest].sum())}"
        areas.append(Area("basins/others", text, OTHERS))
    if basins.outside:
        areas.append(Area("basins/edge", f"leaves the map {_percent(basins.outside)}", EDGE))
    return numbers, tuple(areas)


def basin_floor(
    basins: Basins, search: Search, minima: Minima, place=None, name: str = "true position", height: float = 0.0
) -> Floor:
    """Return the map of basins of attraction, the first colour for that of `place` (2,), metres, if it is given."""
    numbers, areas = basin_image(basins, OUTSIDE if place is None else basins.at(search, place), name)
    lowest, others = marks_of(minima)
    return lattice_floor(TABLE[numbers], search, basins.labels.shape, None, lowest, height, minima=others, areas=areas)


def descent_text(basins: Basins, search: Search, place, name: str = "true position") -> str:
    """Return where descent from a place (2,), metres, ends, and how much of the map its basin holds, in words."""
    here = basins.at(search, place)
    if here == OUTSIDE:
        return f"descent from the {name} leaves the map"
    from ..cost.maps import map_positions  # loads SciPy, which a map of costs does not need

    end = map_positions(basins.minima[[here]], search)[0]
    away = float(np.linalg.norm(end - np.asarray(place, float)[: len(end)]))
    distance = f"{length_text(away)} away" if away > search.step else f"within {length_text(search.step)}"
    return f"descent from the {name} ends {distance}; its basin holds {_percent(basins.shares[here])} of the map"


def _percent(fraction: float) -> str:
    """As "12 %", and "0.3 %" below one."""
    percent = 100 * float(fraction)
    return f"{percent:.0f} %" if percent >= 1 else f"{percent:.1g} %" if percent >= 0.1 else "below 0.1 %"
