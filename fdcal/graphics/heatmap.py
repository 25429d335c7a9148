"""Maps on the floor: costs over the search lattice, drawn as colours and heights with a scale, and standing waves.

The colours of a map in relief contain its shading, and renderers add no light. The light comes from the upper left, as
on a geographic map. Lengths are metres.
"""

from collections.abc import Sequence

import matplotlib
import numpy as np

from ..cost.scale import DECADES, LEAST_RANGE, Minima
from ..model.problem import ChannelCorrection, Problem
from ..model.settings import Search
from ..model.validation import frozen_array
from .glyphs import grid_faces
from .marks import mesh
from .primitives import COLOUR_MAP, DIVERGING_COLOUR_MAP, ColourBar, Curve, Floor, Mesh, Theme, mixed

TOWARDS_LIGHT = np.array([-0.55, 0.55, 0.63])
DARKEST = 0.55  # brightness of a slope that the light does not reach
BRIGHTEST = 0.3  # fraction of white on a slope that faces the light


def relief_grid(floor: Floor, heights: np.ndarray) -> np.ndarray:
    """Return the surface of a map with `heights` (ny, nx) : points (ny + 2, nx + 2, 3) float64, metres.

    It goes through the centres of the cells and extends to the edges of the map.
    """
    x, y = np.meshgrid(*(
        low + length * np.concatenate([[0.0], (np.arange(count) + 0.5) / count, [1.0]])
        for low, length, count in zip(floor.origin, floor.size, heights.shape[::-1], strict=True)
    ))  # fmt: skip
    return np.stack([x, y, floor.height + np.pad(np.asarray(heights, float), 1, mode="edge")], axis=-1)


SIDES = (0.28, 0.4)  # shades of the sides perpendicular to x and to y: 0 is the background, 1 the colour of texts


def relief_sides(floor: Floor, theme: Theme) -> tuple[Mesh, ...]:
    """Return the sides of a map in relief, down to its level, in two shades, so that it looks like a block."""
    assert floor.heights is not None
    rim, meshes = relief_grid(floor, floor.heights), []
    for name, fraction, edges in (("x", SIDES[0], (rim[:, 0], rim[:, -1])), ("y", SIDES[1], (rim[0], rim[-1]))):
        top = np.stack(edges)
        foot = top * [1, 1, 0] + [0, 0, floor.height]
        faces = grid_faces(2, count := top.shape[1]) + np.array([[[0]], [[2 * count]]])
        shape = np.stack([top, foot], axis=1).reshape(-1, 3), faces.reshape(-1, 3)
        meshes.append(mesh(f"relief_sides/{name}", shape, mixed(theme.background, theme.foreground, fraction)))
    return tuple(meshes)


RELIEF_HEIGHT = 0.22  # ratio of the greatest height to the longer side of the map; low, so that no hill hides a minimum


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

    `cost` (ny, nx) float64, row 0 at low y; `log`: whether the scale is in decibels re 1, over DECADES decades at most
    (linear if the 2nd percentile of the costs is negative or the 98th is not positive); `label`: name and unit of the
    cost; `minima`: the minima to be marked, by default only the lowest cost; `relief`: whether the map is shaded and
    has heights, which rise with the cost; `height`: height at which the map lies, metres.
    """
    cost = np.asarray(cost, float)
    iy, ix = np.unravel_index(cost.argmin(), cost.shape)
    minimum = (float(search.origin[0] + ix * search.step), float(search.origin[1] + iy * search.step))
    lowest, others = ((minimum,), ())
    if minima is not None:
        lowest, others = (tuple((float(p[0]), float(p[1])) for p in one) for one in (minima.lowest, minima.others))
    low, high = colour_limits(cost, log)
    rgb = to_rgb(normalise(cost, low, high, log))
    if log and low > 0:
        low, high = 10 * float(np.log10(low)), 10 * float(np.log10(high))
        label = label.replace("(dimensionless)", "(dB)")
    heights = None
    if relief:
        fractions = normalise(cost, *colour_limits(cost, log, WHOLE), log)
        heights = frozen_array(RELIEF_HEIGHT * (max(cost.shape) * search.step) * fractions, np.float32)
        rise_y, rise_x = np.gradient(np.asarray(heights, float), search.step)
        light = TOWARDS_LIGHT / TOWARDS_LIGHT[2]  # level ground has the brightness 1 and keeps its colour
        brightness = (1.0 - rise_x * light[0] - rise_y * light[1]) / np.sqrt(1.0 + rise_x**2 + rise_y**2)
        dark = (DARKEST + (1 - DARKEST) * np.clip(brightness, 0.0, 1.0))[..., None]
        white = (BRIGHTEST * np.clip(brightness - 1.0, 0.0, 1.0))[..., None]
        rgb = np.rint((1 - white) * dark * rgb + white * 255).astype(np.uint8)
    return lattice_floor(rgb, search, ColourBar(low, high, label), lowest, height, minima=others, heights=heights)


def lattice_floor(rgb: np.ndarray, search: Search, bar: ColourBar, lowest, height: float, **more) -> Floor:
    """Return a map over the cells of a lattice of (ny, nx) nodes; each node is the centre of its cell."""
    (ny, nx), step = rgb.shape[:2], search.step
    origin = (search.origin[0] - step / 2, search.origin[1] - step / 2)
    return Floor(frozen_array(rgb, np.uint8), origin, (nx * step, ny * step), bar, lowest, height, **more)


SHOWN, WHOLE = (2.0, 98.0), (0.0, 100.0)  # percentiles of the costs at the ends of the colour scale, and of the heights


def colour_limits(cost: np.ndarray, log: bool, percentiles: tuple[float, float] = SHOWN) -> tuple[float, float]:
    """Return the costs of the first and the last colour; lower and higher costs have the same colours.

    `cost`: array of any shape; `log`: whether the colours follow its logarithm, in which case they span at most
    DECADES; `percentiles`: those of `cost` at the first and the last colour, per cent.
    """
    low, high = map(float, np.percentile(cost, percentiles))
    if log and high > 0 <= low:
        low = max(low, high * 10.0**-DECADES)
    high = max(high, low * 10.0 ** (LEAST_RANGE / 10))
    if high <= low:
        high = low + 1e-6 * abs(low) + 1e-12  # a constant map needs a scale, too
    return low, high


def normalise(cost: np.ndarray, low: float, high: float, log: bool) -> np.ndarray:
    """Return the position of each cost on a scale: 0 for costs up to `low`, 1 for costs from `high` on."""
    cost = np.clip(cost, low, high)
    return np.log10(cost / low) / np.log10(high / low) if log and low > 0 else (cost - low) / (high - low)


def to_rgb(fractions: np.ndarray, name: str = COLOUR_MAP) -> np.ndarray:
    """Return the colours (..., 3) uint8 of fractions of the scale, 0 to 1, in a map of matplotlib.colormaps."""
    return np.asarray(matplotlib.colormaps[name](np.rint(255 * fractions).astype(np.uint8), bytes=True))[..., :3]


# Why one wave does not determine a position: a microphone measures one value of a standing wave, and all positions with
# this value lie on a line. The lines of two waves cross at a few points, and all lines have only the true position in
# common.
WAVE_POINTS = 300  # number of points of the map of a wave along its longer edge
MAX_WAVES = 3  # largest number of waves whose lines are drawn
COUNTED = {2: "both frequencies", 3: "all three frequencies"}


def wave_floor(
    problem: Problem,
    positions,
    n: int,
    waves: Sequence[tuple[int, str]],
    order_offset: int,
    channels: ChannelCorrection | None = None,
    height: float = 0.0,
    marked: bool = True,
) -> Floor:
    """Return the map of the pressure of the last of some modes, white where it is zero, with a line for each mode.

    The pressure is reconstructed from the other microphones at their `positions` (N, 2), metres. On the line of a mode
    it is the pressure that microphone `n` measured. Diamonds mark where the lines of several modes cross.

    `n`: the microphone, counted from 0; `waves`: number, counted from 1, and name of each mode, MAX_WAVES at most;
    `height`: height of the map, metres; `marked`: whether lines and diamonds are drawn.
    """
    from contourpy import contour_generator

    from ..cost.maps import minima_of, mode_shape, refined  # loads SciPy, which a map of costs does not need

    assert problem.search is not None  # otherwise the page requests no map
    lattice = refined(problem.search, WAVE_POINTS)
    fields, levels = zip(
        *(mode_shape(problem, positions, mode, order_offset, channels, n, lattice) for mode, _ in waves), strict=True
    )
    bar = ColourBar(-1.0, 1.0, f"pressure of {waves[-1][1]} (normalised to a peak of 1)", DIVERGING_COLOUR_MAP)
    rgb = to_rgb((1 + np.clip(fields[-1], -1, 1)) / 2, DIVERGING_COLOUR_MAP)
    crossings, curves, shape = np.zeros((0, 2)), list[Curve](), fields[-1].shape
    x, y = (low + lattice.step * np.arange(count) for low, count in zip(lattice.origin, shape[::-1], strict=False))
    for (_, name), field, level in zip(waves, fields, levels, strict=True):
        paths = [np.asarray(path) for path in contour_generator(x, y, field).lines(level)] if marked else []
        pieces = [np.stack([path[:-1], path[1:]], axis=1) for path in paths]
        segments = frozen_array(np.concatenate([np.zeros((0, 2, 2)), *pieces]), np.float32)
        curves += [Curve(f"measured pressure at {name.rpartition(', ')[2]}", segments)] if marked else []
    if marked and len(waves) > 1:
        misfit = (np.stack(fields) - np.reshape(levels, (-1, 1, 1))) ** 2
        crossings = minima_of(misfit.sum(axis=0), lattice).lowest
    lowest = tuple((float(x), float(y)) for x, y in crossings)
    captions = (("lowest", f"measured pressure at {COUNTED[len(waves)]}"),) if len(waves) > 1 else ()
    more = {"show_minima": bool(lowest), "curves": tuple(curves), "captions": captions}
    return lattice_floor(rgb, lattice, bar, lowest, height, **more)
