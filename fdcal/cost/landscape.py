"""The landscape of Eq. 7 of one microphone, mode by mode and summed: the paper's Fig. 1 as numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..model.problem import Problem
from ..model.settings import Search
from ..model.validation import frozen_array
from .expansion import require_modes, require_plane_field, search_domain
from .maps import descent_maps, map_positions, minima_of, refined
from .scale import Minima


@dataclass(frozen=True)
class LandscapePanels:
    """Landscapes of one microphone.

    Attributes
    ----------
    microphone : int
        Counted from 0.
    modes : (P,) int64
        Counted from 1.
    frequencies : (P,) float64
        Hz.
    maps : (P + 1, ny, nx) float64
        Dimensionless; one for each mode, the last their sum; row 0 at low y.
    minima : (P + 1, 2) float64
        Metres, the minimum of each map.
    search : Search
    mode_count : int
        Modes in the sum, not all of which need a map here.
    marks : tuple of Minima
        Of each map, the lowest costs and the other local minima.
    """

    microphone: int
    modes: np.ndarray
    frequencies: np.ndarray
    maps: np.ndarray
    minima: np.ndarray
    search: Search
    mode_count: int
    marks: tuple[Minima, ...]

    plot: ClassVar[Callable[..., Any]]  # a figure; `fdcal.METHODS` binds it


def landscape_panels(problem: Problem, positions, n: int, modes: Sequence[int], order_offset: int) -> LandscapePanels:
    """Return the cost of Eq. 7 over the search lattice with microphone `n` moved and the others at `positions`.

    `modes` count from 1; `order_offset` is added to the order of Eq. 3.
    """
    require_plane_field(problem)
    if problem.search is not None:
        require_modes(problem, order_offset, max(modes))
    maps, search = descent_maps(problem, positions, n, modes, order_offset), search_domain(problem)
    fine, marks, total = refined(search), [], np.zeros(1)
    for mode in modes:  # a mode alone has its minima on a fine lattice: `fdcal.cost.scale`
        cost = descent_maps(problem, positions, n, (mode,), order_offset, search=fine)[0]
        marks.append(minima_of(cost, fine))
        total = total + cost
    marks.append(minima_of(total, fine))
    return panels_of(maps, maps.sum(axis=0), modes, problem.frequencies, n, search, len(modes), marks)


def panels_of(
    maps, total, modes: Sequence[int], frequencies, n: int, search: Search, count: int,
    marks: Sequence[Minima] | None = None,
) -> LandscapePanels:  # fmt: skip
    """Return panels of maps that exist, the last of the sum.

    `maps` (P, ny, nx), of `modes`, counted from 1; `total` (ny, nx), the sum over `count` modes; `marks`: of the maps
    and the sum, found on their lattice unless given.
    """
    drawn = np.concatenate([np.asarray(maps, float), np.asarray(total, float)[None]])
    lowest = np.column_stack(np.divmod(drawn.reshape(len(drawn), -1).argmin(axis=1), drawn.shape[2]))
    return LandscapePanels(
        microphone=n,
        modes=frozen_array(modes, np.int64),
        frequencies=frozen_array(np.asarray(frequencies)[np.asarray(modes) - 1], float),
        maps=frozen_array(drawn, float),
        minima=frozen_array(map_positions(lowest, search), float),
        search=search,
        mode_count=count,
        marks=tuple(minima_of(cost, search) for cost in drawn) if marks is None else tuple(marks),
    )
