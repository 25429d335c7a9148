"""Cost maps, computed on threads of their own; only one that belongs to what is on the screen is returned.

A fast thread computes the map over the solver's own lattice, many times a second while the user drags a microphone; a
slow one then computes the same map on a finer lattice once nothing changes, and stops as soon as another is requested.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ...cost.basins import local_minima
from ...cost.maps import cost_maps, mode_shape
from ...graphics.heatmap import field_floor
from ...graphics.surroundings import z_range_of
from ...model.settings import Search
from ...session.worker import LatestWorker
from ..gui.html import error_message
from .cost_map import CostMap, cost_map
from .map_panels import ModePanels, fine_panels, row_label, shown_modes
from .map_request import CostMapRequest
from .prepare import PreparedRun
from .volume_maps import VolumeMaps

PAUSE = 0.15  # s at least between two maps while the solver runs, which needs the processor, too
FOLLOW_TIME = 0.6  # s at least that the map of a microphone stays while the page follows a running solver
DRAG_TIME = 1.0  # s at most that a map stays while a microphone or a slice is dragged and the next map is in progress
IDLE_TIME = 0.35  # s without a change before a finer map is requested


class CostMapWorker:
    """Requests maps and returns the newest that fits; all on the caller's thread except `_compute`, `_compute_fine`.

    `notify`: called when there is a new map.
    """

    def __init__(self, run: PreparedRun, notify: Callable[[], None] = lambda: None):
        self._run, self._requested, self._since = run, None, 0.0
        self._fine_requested: CostMapRequest | None = None
        self._volumes = VolumeMaps(run)
        self._costs: dict[str, tuple] = {}  # of each thread: the key of its last costs, and the costs
        self.worker = LatestWorker(self._compute, "fdcal-map", notify=notify)
        self._fine_worker = LatestWorker(self._compute_fine, "fdcal-fine-map")

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
        dragged = not running and now - latest.ended < DRAG_TIME and moved
        if dragged or last.differs_in_theme(wanted) or last.stands_for(wanted, running):
            return latest.result, error_message(latest.cause)
        return None, ""

    def _request(self, wanted: CostMapRequest, running: bool, now: float) -> CostMapRequest:
        """Request the map unless it is in progress or the last one has only just been finished; return the request."""
        latest = self.worker.latest
        due = True
        if latest is not None and running:
            last = latest.request[0]
            pause = max(PAUSE, 0.5 * (latest.ended - latest.began))
            if wanted.follow and last.microphone != wanted.microphone:
                pause = max(pause, FOLLOW_TIME)
            due = now - latest.ended > pause or not last.stands_for(wanted, running)  # the user wants another one
            if last.differs_in_style(wanted):
                wanted = replace(last, style=wanted.style)  # drawn again from the same costs
        if wanted != self._requested and due and not (running and self.worker.busy):
            self._requested, self._since = wanted, now
            self.worker.request(wanted)
        drawn = latest is not None and latest.request[0] == wanted
        if drawn and not running and wanted == self._requested and now - self._since > IDLE_TIME:
            self._request_fine(wanted)
        return wanted

    def _request_fine(self, wanted: CostMapRequest) -> None:
        flat_cost = not (wanted.style.relief or wanted.style.shape)
        if flat_cost and wanted != self._fine_requested:
            self._fine_requested = wanted
            self._fine_worker.request(wanted)

    @property
    def busy(self) -> bool:
        """Whether a map is in progress."""
        return self.worker.busy or self._fine_worker.busy

    def close(self, timeout: float) -> bool:
        """End the threads after the maps in progress; False if that takes longer than `timeout`, s."""
        self._requested = None
        return all([self._fine_worker.close(timeout), self.worker.close(timeout)])

    def _compute(self, request: CostMapRequest) -> CostMap:
        """On the fast thread: a map over the solver's lattice, or a coarse volume."""
        if request.style.volume:
            return self._volumes.coarse(request)
        if request.style.shape:
            return self._compute_shape(request)
        run, search = self._run, self._search()
        key = (request.revision, request.microphone, request.modes, request.order_offset)
        if self._costs.get("fast", (None,))[0] != key:
            n, modes = request.microphone, request.modes
            maps = cost_maps(run.problem, run.solver, request.state, n, modes, request.order_offset)
            shown = shown_modes(len(modes))
            panels = ModePanels(tuple(modes[i] for i in shown), maps[shown], maps.sum(axis=0), search)
            self._costs["fast"] = key, panels, local_minima(panels.total)
        _, panels, minima = self._costs["fast"]
        return cost_map(self._run, request, panels.total, panels.search, minima, panels)

    def _compute_shape(self, request: CostMapRequest) -> CostMap:
        """On the fast thread: the sound field of a mode."""
        run, mode = self._run, request.modes[-1]
        state = request.state
        shape = mode_shape(run.problem, state.positions, mode, state.order_offset, state.channels)
        label = f"pressure of {row_label(run.measurement, mode)} (normalised to a peak of 1)"
        height = z_range_of(run.known_scene, run.measurement)[0]
        return CostMap(request, field_floor(shape, self._search(), label, height), None, 0, 0.0, 0.0)

    def _compute_fine(self, request: CostMapRequest) -> CostMap | None:
        """On the slow thread: the finer map, mode by mode; None as soon as another one is requested."""
        run, n = self._run, request.microphone
        if request.style.volume:
            return self._volumes.fine(request, lambda: self._requested != request)
        key = (request.revision, n, request.modes, request.order_offset)
        if self._costs.get("fine", (None,))[0] != key:
            panels = fine_panels(run, request, lambda: self._requested != request)
            if panels is None:
                return None
            self._costs["fine"] = key, panels, local_minima(panels.total)
        _, panels, minima = self._costs["fine"]
        return replace(cost_map(self._run, request, panels.total, panels.search, minima, panels), fine=True)

    def _search(self) -> Search:
        search = self._run.problem.search
        if search is None:
            raise ValueError("a map needs a search domain")  # the page requests none without
        return search
