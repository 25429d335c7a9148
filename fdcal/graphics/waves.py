"""Why a place is ambiguous: a standing wave, and where else a microphone would measure in it what it has measured.

A microphone measures one number of a standing wave. All places with this number lie on a line; the lines of two waves
cross at a few places, and all lines have only the true position in common.
"""

from collections.abc import Sequence

import numpy as np
from contourpy import contour_generator

from ..cost.maps import minima_of, mode_shape, refined
from ..model.problem import ChannelCorrection, Problem
from ..model.settings import Search
from ..model.validation import InputError, frozen_array
from .heatmap import lattice_floor, to_rgb
from .primitives import DIVERGING_COLOUR_MAP, ColourBar, Curve, Floor

POINTS = 300  # of the map, along its longer edge
MAX_WAVES = 3  # whose lines are drawn
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
    """Return the map of the pressure of the last of some modes, white where it is zero, with the line of each mode.

    It is reconstructed from the other microphones at their `positions` (N, 2), metres. Diamonds mark where the lines of
    several modes cross.

    `n`: the microphone, counted from 0; `waves`: number, counted from 1, and name of each mode, MAX_WAVES at most;
    `height`: of the map, metres; `marked`: whether there are lines and diamonds.
    """
    if problem.search is None:
        raise InputError("the shape of a mode needs a search domain", "give <search> and <radius>", key="search")
    lattice = refined(problem.search, POINTS)
    fields, levels = zip(
        *(mode_shape(problem, positions, mode, order_offset, channels, n, lattice) for mode, _ in waves), strict=True
    )
    bar = ColourBar(-1.0, 1.0, f"pressure of {waves[-1][1]} (normalised to a peak of 1)", DIVERGING_COLOUR_MAP)
    rgb = to_rgb((1 + np.clip(fields[-1], -1, 1)) / 2, DIVERGING_COLOUR_MAP)
    curves, crossings = [], np.zeros((0, 2))
    if marked:
        for field, level, (_, name) in zip(fields, levels, waves, strict=True):
            curves.append(Curve(f"measures the same at {name.rpartition(', ')[2]}", contour(field, level, lattice)))
        if len(waves) > 1:
            misfit = (np.stack(fields) - np.reshape(levels, (-1, 1, 1))) ** 2
            crossings = minima_of(misfit.sum(axis=0), lattice).lowest
    lowest = tuple((float(x), float(y)) for x, y in crossings)
    captions = (("lowest", f"measures the same at {COUNTED[len(waves)]}"),) if len(waves) > 1 else ()
    more = {"show_minima": bool(lowest), "curves": tuple(curves), "captions": captions}
    return lattice_floor(rgb, lattice, fields[-1].shape, bar, lowest, height, **more)


def contour(field: np.ndarray, level: float, lattice: Search) -> np.ndarray:
    """Return where a field (ny, nx) over a lattice has a value : line segments (S, 2, 2) float32, metres."""
    x, y = (low + lattice.step * np.arange(n) for low, n in zip(lattice.origin, field.shape[::-1], strict=False))
    paths = [np.asarray(path) for path in contour_generator(x, y, field).lines(level)]
    pieces = [np.stack([path[:-1], path[1:]], axis=1) for path in paths]
    return frozen_array(np.concatenate([np.zeros((0, 2, 2)), *pieces]), np.float32)
