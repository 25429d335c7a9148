"""Cost maps, computed on threads of their own; only one that belongs to what is on the screen is returned.

A fast thread computes the map over the solver's own lattice, many times a second while the user drags a microphone; a
slow one then computes the same map on a finer lattice once nothing changes, and stops as soon as another is requested.

A volume, the cost of one microphone in space, takes most of its time for the terms of the cost at its nodes
(`fdcal.cost.maps`). They are kept until microphone, modes or positions change, so that another slice, scale or opacity
is drawn from what there is.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...cost.basins import Basins, basins_of
from ...cost.maps import (
    VOLUME_NEGLIGIBLE,
    CostVolume,
    cost_maps,
    cost_volume,
    lattice_of,
    map_minima,
    minima_of,
    mode_shape,
)
from ...cost.reference_cost import ORDER_OFFSET
from ...cost.scale import Minima
from ...graphics.basin_map import basin_slice, descent_text
from ...graphics.heatmap import field_floor
from ...graphics.picture import z_range_of
from ...graphics.volume import AXES, PIXELS, POINTS, SampledVolume, Volume, drawn_volume, sampled_volume, sliced
from ...model.problem import Problem
from ...model.settings import Search
from ..gui.html import error_message
from .cost_map import (
    CostMap,
    CostMapRequest,
    MapStyle,
    ModePanels,
    cost_map,
    fine_panels,
    place_of_basin,
    row_label,
    shown_modes,
)
from .prepare import PreparedRun
from .threads import Threads

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
        found = self._sampled.get(True)  # in one look: the other thread may store the next one meanwhile
        if found is not None and found[0] == _key(request):
            return self._map(request, found[1], True, COARSE_PIXELS)
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
        found = self._sampled.get(fine)
        if found is not None and found[0] == key:
            return found[1]
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
        drawn = self._drawn.get(fine)
        if drawn is None or drawn[0] != key:
            drawn = self._drawn[fine] = key, drawn_volume(sampled, style.log, style.minima)
        position = request.state.positions[request.microphone]
        volume = sliced(
            drawn[1], sampled, style.slice_axis, place_of(style, position), style.log,
            pixels,
        )  # fmt: skip
        figures, fine = _figures(sampled, position), fine and pixels == PIXELS
        return CostMap(request, None, None, *figures, fine, volume, sampled=sampled)

    def _basins(self, request: CostMapRequest, sampled: SampledVolume, fine: bool) -> CostMap:
        """Return a slice through the basins of attraction; another slice needs no new ones."""
        key, style = _key(request), request.style
        if self._found.get(fine, (None,))[0] != key:
            self._found[fine] = key, basins_of(sampled.cost)
        basins, (place, name) = self._found[fine][1], place_of_basin(self._run, request)
        position = request.state.positions[request.microphone]
        volume = basin_slice(
            basins, sampled.search, style.slice_axis, place_of(style, position), sampled.minima, place, name
        )
        volume = volume if style.minima else replace(volume, minima=None)
        note = descent_text(basins, sampled.search, place, name)
        return CostMap(request, None, None, *_figures(sampled, position), fine, volume, note, sampled)


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


def _figures(sampled: SampledVolume, position: np.ndarray) -> tuple[Minima, float, float]:
    """Return the local minima, the cost at a position (3,), metres, and the lowest cost that is known."""
    found, lowest = sampled.terms.on(*position), float(sampled.cost.min())
    here = float("nan") if found is None else float(found[0, 0, 0])
    return sampled.minima, here, float(np.nanmin([lowest, here]))  # a minimum may lie between lattice points


def _key(request: CostMapRequest) -> tuple:
    return request.revision, request.microphone, request.modes, request.order_offset


PAUSE = 0.15  # s at least between two maps while the solver runs, which needs the processor, too
LOAD = 4  # times as long as a map takes: a running solver needs the processor, too
FOLLOW_TIME = 0.6  # s at least that the map of a microphone stays while the page follows a running solver
DRAG_TIME = 1.0  # s at most that a map stays while a microphone or a slice is dragged and the next map is in progress
IDLE_TIME = 0.35  # s without a change before a finer map is requested


class CostMapWorker:
    """Requests maps and returns the newest that fits; all on the caller's thread except `_compute`, `_compute_fine`."""

    def __init__(self, run: PreparedRun, threads: Threads):
        self._run, self._since = run, 0.0
        self._volumes = VolumeMaps(run)
        self._costs: dict[str, tuple] = {}  # of each thread: the key of its last costs, and the costs
        self.worker = threads.start(self._compute, "fdcal-map", wakes=True)
        self._fine_worker = threads.start(self._compute_fine, "fdcal-fine-map")

    def newest(self, wanted: CostMapRequest, running: bool, now: float) -> tuple[CostMap | None, str]:
        """Return the map to show; request `wanted` where it is not there yet.

        `wanted`: what belongs to the state on the screen; `running`: whether the solver runs; `now`: time, s. Returns
        and the error that keeps it from being computed, "" without one.
        """
        wanted = self._request(wanted, running, now)
        fine, latest = self._fine_worker.latest, self.worker.latest
        if fine is not None and fine.result is not None:
            finer = fine.request[0]
            if finer == wanted or finer.differs_in_theme(wanted):
                return fine.result, ""
        if latest is None:
            return None, ""
        last = latest.request[0]
        moved = last.differs_in_one_position(wanted) or last.differs_in_slider(wanted)
        dragged = not running and now - max(latest.ended, self._since) < DRAG_TIME and moved
        if dragged or last.differs_in_theme(wanted) or last.stands_for(wanted, running):
            return latest.result, error_message(latest.cause)
        return None, ""

    def _request(self, wanted: CostMapRequest, running: bool, now: float) -> CostMapRequest:
        """Request the map unless it is in progress or the last one has only just been finished; return the request."""
        latest = self.worker.latest
        due = True
        if latest is not None and running:
            last = latest.request[0]
            pause = max(PAUSE, LOAD * (latest.ended - latest.began))
            if wanted.follow and last.microphone != wanted.microphone:
                pause = max(pause, FOLLOW_TIME)
            due = now - latest.ended > pause or not last.stands_for(wanted, running)  # the user wants another one
            if last.differs_in_style(wanted):
                wanted = replace(last, style=wanted.style)  # drawn again from the same costs
        if not self.worker.wants(wanted) and due and not (running and self.worker.busy):
            self._since = now
            self.worker.newest(wanted)
        drawn = latest is not None and latest.request[0] == wanted
        if (
            not wanted.style.shape
            and drawn
            and not running
            and self.worker.wants(wanted)
            and now - self._since > IDLE_TIME
        ):
            self._fine_worker.newest(wanted)
        return wanted

    @property
    def busy(self) -> bool:
        """Whether a map is in progress."""
        return self.worker.busy or self._fine_worker.busy

    def _compute(self, request: CostMapRequest) -> CostMap:
        """On the fast thread: a map over the solver's lattice, or a coarse volume."""
        if request.style.volume:
            return self._volumes.coarse(request)
        if request.style.shape:
            return self._compute_shape(request)
        run = self._run  # of basins on a lattice without false minima
        search = lattice_of(run.problem, request.modes) if request.style.basins else self._search()
        key = (request.revision, request.microphone, request.modes, request.order_offset, search)
        if self._costs.get("fast", (None,))[0] != key:
            n, modes = request.microphone, request.modes
            maps = cost_maps(run.problem, run.solver, request.state, n, modes, request.order_offset, search)
            shown = shown_modes(len(modes))
            panels = ModePanels(tuple(modes[i] for i in shown), maps[shown], maps.sum(axis=0), search)
            found = map_minima(
                run.problem, run.solver, request.state, n, modes, request.order_offset, panels.total, search
            )
            self._costs["fast"] = key, panels, found
        _, panels, minima = self._costs["fast"]
        return cost_map(self._run, request, panels.total, panels.search, minima, panels)

    def _compute_shape(self, request: CostMapRequest) -> CostMap:
        """On the fast thread: the sound field of a mode."""
        run, mode = self._run, request.modes[-1]
        state = request.state
        shape = mode_shape(run.problem, state.positions, mode, state.order_offset, state.channels)
        label = f"pressure of {row_label(run.measurement, mode)} (normalised to a peak of 1)"
        height = z_range_of(run.known_scene, run.measurement)[0]
        return CostMap(request, field_floor(shape, self._search(), label, height), None, None, 0.0, 0.0)

    def _compute_fine(self, request: CostMapRequest) -> CostMap | None:
        """On the slow thread: the finer map, mode by mode; None as soon as another one is requested."""
        run, n = self._run, request.microphone
        if request.style.volume:
            return self._volumes.fine(request, lambda: not self.worker.wants(request))
        key = (request.revision, n, request.modes, request.order_offset)
        if self._costs.get("fine", (None,))[0] != key:
            panels = fine_panels(run, request, lambda: not self.worker.wants(request))
            if panels is None:
                return None
            self._costs["fine"] = key, panels, minima_of(panels.total, panels.search)
        _, panels, minima = self._costs["fine"]
        if request.style.relief:  # a finer surface would take seconds to send: only the maps side by side are finer
            latest = self.worker.latest
            drawn = None if latest is None or latest.request[0] != request else latest.result
            return None if drawn is None else replace(drawn, panels=panels, fine=True)
        return replace(cost_map(self._run, request, panels.total, panels.search, minima, panels), fine=True)

    def _search(self) -> Search:
        search = self._run.problem.search
        if search is None:
            raise ValueError("a map needs a search domain")  # the page requests none without
        return search
