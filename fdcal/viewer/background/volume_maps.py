"""The cost of one microphone in space: coarse at once, fine later; a slice follows its slider without a new volume.

A volume takes most of its time for the terms of the cost at its nodes (`fdcal.cost.maps`). They are kept until
microphone, modes or positions change, so that another slice, scale or opacity is drawn from what there is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...cost.basins import Basins, basins_of
from ...cost.maps import VOLUME_NEGLIGIBLE, CostVolume, cost_volume
from ...cost.reference_cost import ORDER_OFFSET
from ...graphics.basin_map import basin_slice, descent_text
from ...graphics.volume import AXES, PIXELS, POINTS, SampledVolume, Volume, drawn_volume, sampled_volume, sliced
from ...model.problem import Problem
from .cost_map import CostMap, place_of_basin
from .map_request import CostMapRequest, MapStyle
from .prepare import PreparedRun

COARSE_POINTS = 26  # along the longest edge
COARSE_NEGLIGIBLE = 1e-3  # of the nodes of a coarse volume
COARSE_PIXELS = 80  # of a slice, along its longer edge


class VolumeMaps:
    """Computes volumes on the threads of the maps, and keeps the last of each."""

    def __init__(self, run: PreparedRun):
        self._run = run
        self._sampled: dict[bool, tuple[tuple, SampledVolume]] = {}  # by whether fine
        self._drawn: dict[bool, tuple[tuple, Volume]] = {}  # likewise, without a slice
        self._found: dict[bool, tuple[tuple, Basins]] = {}  # likewise

    def coarse(self, request: CostMapRequest) -> CostMap:
        """Return the volume on a coarse lattice, or the fine one where that is there already; with a coarse slice."""
        if self._sampled.get(True, (None,))[0] == _key(request):
            return self._map(request, self._sampled[True][1], True, COARSE_PIXELS)
        sampled = self._sample(request, False, lambda: False)
        if sampled is None:
            raise ValueError("a volume that nobody cancels is complete")
        return self._map(request, sampled, False, COARSE_PIXELS)

    def fine(self, request: CostMapRequest, cancelled: Callable[[], bool]) -> CostMap | None:
        """Return the volume on a fine lattice; None once cancelled."""
        sampled = self._sample(request, True, cancelled)
        return None if sampled is None else self._map(request, sampled, True, PIXELS)

    def _sample(self, request: CostMapRequest, fine: bool, cancelled: Callable[[], bool]) -> SampledVolume | None:
        """Return the values of the volume of a request, the last ones where they are of the same cost."""
        key = _key(request)
        if self._sampled.get(fine, (None,))[0] == key:
            return self._sampled[fine][1]
        negligible = VOLUME_NEGLIGIBLE if fine else COARSE_NEGLIGIBLE
        terms = terms_of(self._run.problem, request, cancelled, negligible)
        sampled = None if terms is None else sampled_volume(terms, POINTS if fine else COARSE_POINTS, cancelled)
        if sampled is not None:
            self._sampled[fine] = key, sampled
        return sampled

    def _map(self, request: CostMapRequest, sampled: SampledVolume, fine: bool, pixels: int) -> CostMap:
        if request.style.basins:
            return self._basins(request, sampled, fine)
        style = request.style
        key = (_key(request), style.log, style.minima)
        if self._drawn.get(fine, (None,))[0] != key:
            self._drawn[fine] = key, drawn_volume(sampled, style.log, style.minima)
        position = request.state.positions[request.microphone]
        volume = sliced(
            self._drawn[fine][1], sampled, style.slice_axis, place_of(style, position), style.log,
            pixels,
        )  # fmt: skip
        return CostMap(request, None, None, *_figures(sampled, position), fine and pixels == PIXELS, volume)

    def _basins(self, request: CostMapRequest, sampled: SampledVolume, fine: bool) -> CostMap:
        """Return a slice through the basins of attraction; another slice needs no new ones."""
        key, style = _key(request), request.style
        if self._found.get(fine, (None,))[0] != key:
            self._found[fine] = key, basins_of(sampled.cost)
        basins, (place, name) = self._found[fine][1], place_of_basin(self._run, request)
        position = request.state.positions[request.microphone]
        volume = basin_slice(
            basins, sampled.search, style.slice_axis, place_of(style, position), place, name, lowest=sampled.lowest
        )
        volume = volume if style.minima else replace(volume, minima=())
        note = descent_text(basins, sampled.search, place, name)
        return CostMap(request, None, None, *_figures(sampled, position), fine, volume, note)


def terms_of(
    problem: Problem,
    request: CostMapRequest,
    cancelled: Callable[[], bool] = lambda: False,
    negligible: float = VOLUME_NEGLIGIBLE,
) -> CostVolume | None:
    """Return the cost in space of a request, which is that of Eq. 7; None once cancelled."""
    state, offset = request.state, request.order_offset
    offset = ORDER_OFFSET if offset is None else offset
    n, modes = request.microphone, request.modes
    return cost_volume(problem, state.positions, n, modes, offset, state.channels, cancelled, negligible)


def place_of(style: MapStyle, position: np.ndarray) -> float:
    """Return where along its axis a slice lies, metres: through `position` (3,) unless it was moved."""
    if style.slice_axis not in AXES:
        return 0.0
    return float(position[AXES.index(style.slice_axis)]) if style.slice_position is None else style.slice_position


def _figures(sampled: SampledVolume, position: np.ndarray) -> tuple[int, float, float]:
    """Return the number of local minima, the cost at a position (3,), metres, and the lowest cost that is known."""
    found, lowest = sampled.terms.on(*position), float(sampled.cost.min())
    here = float("nan") if found is None else float(found[0, 0, 0])
    return len(sampled.minima), here, float(np.nanmin([lowest, here]))  # a minimum may lie between lattice points


def _key(request: CostMapRequest) -> tuple:
    return request.revision, request.microphone, request.modes, request.order_offset
