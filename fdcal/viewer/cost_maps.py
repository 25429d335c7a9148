"""Cost maps, computed on threads; only a map that belongs to the state on the screen is returned.

A fast thread computes a map over the solver's own lattice, many times a second while the user drags a microphone. When
nothing changes, a slow thread computes the same map on a finer lattice, and stops as soon as another map is requested.

A volume is the cost of one microphone in space. Its computation mainly consists of the terms of the cost at the nodes
(`fdcal.cost.maps`). These terms are kept until microphone, modes, order or state change, so that a change of the scale
does not compute them again.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from typing import get_args

import numpy as np

from ..assessment.words import band_label, modes_label, row_label
from ..cost import maps
from ..cost.eq7 import ORDER_OFFSET, decibels, expansion_of
from ..cost.scale import Minima
from ..graphics.heatmap import MAX_WAVES, cost_floor, wave_floor
from ..graphics.picture import z_range_of
from ..graphics.primitives import Floor
from ..graphics.volume import PIXELS, POINTS, SampledVolume, Volume, layer_floor, sampled_volume, volume_of
from ..model.address import Map
from ..model.settings import Search
from ..model.validation import InputError, Reals
from ..session.worker import Memo, Scheduler
from ..solvers.interface import RunState
from .html import error_message
from .prepare import PreparedRun

# Kinds of map: colours; colours and heights; the sound field of the last mode; isosurfaces; none.
MAP_KINDS = get_args(Map)


@dataclass(frozen=True)
class MapStyle:
    """How a map is drawn."""

    kind: Map = "flat"
    log: bool = True  # whether its scale is logarithmic
    minima: bool = True  # whether its local minima are marked and counted
    in_space: bool = False  # whether the cost of one microphone can be computed in space

    @property
    def volume(self) -> bool:
        """Whether the cost in space is computed."""
        return self.in_space and self.kind == "volume"


@dataclass(frozen=True)
class CostMapRequest:
    """A map to be computed."""

    revision: int  # number of the state on the screen; it is compared, because states compare slowly
    microphone: int  # counted from 0
    modes: tuple[int, ...]  # counted from 1
    order_offset: int | None  # added to ceil(k R) in a map of Eq. 7; None for a map of what the solver minimises
    custom_modes: bool  # whether the user has chosen the modes; otherwise the solver's modes are shown
    style: MapStyle
    follow: bool = field(compare=False)  # whether a map of another microphone may be shown instead
    state: RunState = field(compare=False)  # state of the solver
    lineage: object = field(compare=False)  # lineage of the history to which the state belongs

    def replaces(self, wanted: "CostMapRequest", running: bool) -> bool:
        """Return whether this map may be shown instead of `wanted`; while the solver runs, an older map may, too."""
        if self == wanted or not running:
            return self == wanted
        mine, theirs = (
            (wanted.follow or one.microphone, one.custom_modes and one.modes, one.order_offset, one.style)
            for one in (self, wanted)
        )
        return mine == theirs and self.lineage is wanted.lineage

    @property
    def key(self) -> tuple:
        """The values that determine the costs, but not how they are drawn."""
        return self.revision, self.microphone, self.modes, self.order_offset


def map_label(run: PreparedRun, request: CostMapRequest) -> str:
    """Return name and unit of the quantity that a map shows: the cost that the method minimises, or Eq. 7."""
    together = run.solver.TRAITS.moves_all
    if together and request.order_offset is None:
        unit = "dB re the highest" if request.style.log else "nats"
        return f"negative log-likelihood above its lowest ({unit})"
    name = "Eq. 7, for comparison" if together else "cost, Eq. 7"
    return f"{name} (dB)" if request.style.log else f"{name} (relative to the power)"


NAT = 1.0  # difference of log-likelihoods up to which two positions count as fitting equally well


def above_lowest(run: PreparedRun, request: CostMapRequest, cost: Reals, lowest: float | None = None) -> Reals:
    """Return the costs that a map shows; a log-likelihood, whose zero is arbitrary, is shown above its lowest value.

    `lowest` is by default that of `cost`. A difference is at least NAT, so that its logarithm is finite.
    """
    if request.order_offset is not None or not run.solver.TRAITS.moves_all:
        return cost
    return np.maximum(cost - (cost.min() if lowest is None else lowest), NAT)


def map_modes(
    run: PreparedRun, state: RunState, chosen: tuple[int, ...] | None, order_offset: int | None
) -> tuple[int, ...]:
    """Return the modes of a map, counted from 1.

    `state`: state of the solver; `chosen`: modes that the user has chosen. Without them a map shows the modes that
    the solver uses. Of these a map of Eq. 7 shows only the carried modes, if there are any: modes whose expansion has
    fewer functions than there are microphones (`fdcal.cost.eq7`). `order_offset`: that of a map of Eq. 7; None for a
    map of what the solver minimises.
    """
    if chosen is not None:
        return chosen
    used = tuple(range(state.first, state.last + 1))
    carried = set(carried_modes(run, order_offset, state.last))
    return tuple(mode for mode in used if mode in carried) or used


def carried_modes(run: PreparedRun, order_offset: int | None, last: int) -> tuple[int, ...]:
    """Return the carried modes up to `last`, counted from 1, for a map of Eq. 7.

    These are all modes if there is no search domain, or for a map of what the solver minimises (`order_offset` None).
    """
    if order_offset is None or run.problem.search is None:
        return tuple(range(1, last + 1))
    return tuple(int(mode) for mode in expansion_of(run.problem, order_offset).carried.modes + 1 if mode <= last)


def fine_maps(
    run: PreparedRun, request: CostMapRequest, cancelled: Callable[[], bool] = lambda: False, kept: Collection[int] = ()
) -> tuple[list[Reals], Reals, Search] | None:
    """Return maps of single modes, the sum of all modes, and their lattice, which suits a screen; None if cancelled.

    `cancelled`: returns whether the maps are no longer wanted; `kept`: indices of those modes of the request whose
    single maps are returned. InputError if there is no search domain, or if a mode cannot be shown at the order of the
    request.
    """
    problem, modes, offset = run.problem, request.modes, request.order_offset
    if problem.search is None:
        raise InputError("there is no map without a search domain", "give <search> and <radius>", key="search")
    search = maps.refined(problem.search)
    powers = maps.mode_powers(problem, run.solver, request.state, modes, offset)
    fraction = np.ones(len(modes)) if powers is None else powers / powers.sum()
    total, single = np.zeros(1), []
    for i, mode in enumerate(modes):
        if cancelled():
            return None
        cost = maps.cost_maps(problem, run.solver, request.state, request.microphone, (mode,), offset, search)[0]
        total = total + fraction[i] * cost
        if i in kept:
            single.append(fraction[i] * cost)
    return single, total, search


@dataclass(frozen=True)
class CostMap:
    """A finished map: the floor or the volume, the costs it shows, and the figures of its caption."""

    request: CostMapRequest
    floor: Floor | None
    minima: Minima | None  # minima of the map; None for the shape of a mode
    cost_here: float  # cost at the estimated position of the microphone
    lowest: float  # lowest cost of the map
    fine: bool = False  # whether its lattice is finer than the solver's
    volume: Volume | None = None  # isosurfaces over the floor; None for a map on the floor alone
    sampled: SampledVolume | None = None  # values of a volume; None for a map on the floor alone
    # base, highest: for a likelihood, the lowest cost, from which costs are counted, and the difference that is shown
    # as 0 dB
    base: float | None = None
    highest: float = 1.0

    def text_of(self, cost: float) -> str:
        """Return a cost of this map as a text."""
        return f"{decibels((cost if self.base is None else max(cost - self.base, NAT)) / self.highest):.1f} dB"


def cost_map(run: PreparedRun, request: CostMapRequest, total: Reals, search: Search, minima: Minima) -> CostMap:
    """Return a finished map on the floor.

    `request`: what the map shows, and how it is drawn; `total` (ny, nx) float64, the cost; `search`: lattice of
    `total`; `minima`: the minima to be marked.
    """
    style, n = request.style, request.microphone
    here = maps.interpolate(total, search, request.state.positions[n])
    lowest = min(here, float(total.min()))  # the estimate may lie between lattice points
    shown = above_lowest(run, request, total, lowest)
    base, highest = (None, 1.0) if shown is total else (lowest, float(shown.max()))
    place = maps.map_positions([np.unravel_index(total.argmin(), total.shape)], search)[0]
    if base is not None and np.all(np.abs(place - request.state.positions[n][:2]) <= search.step):
        # The minimum of a likelihood is far narrower than the lattice, so that an interpolated cost is meaningless.
        here = lowest
    figures = minima, here, lowest
    height = z_range_of(run.known_scene, run.measurement)[0]
    what, hertz = (label(run.measurement, request.modes) for label in (modes_label, band_label))
    if run.measurement.array_dimension == 3:
        what += f" at z = {request.state.positions[n, 2]:z.2f} m"
    label = f"{map_label(run, request)}, {what}, {hertz}"
    floor = cost_floor(
        shown / highest if style.log else shown, search, style.log, label,
        minima=minima, relief=style.kind == "relief", height=height,
    )  # fmt: skip
    return CostMap(request, replace(floor, show_minima=style.minima), *figures, base=base, highest=highest)


COARSE_POINTS = 26  # points of a coarse volume along its longest edge
COARSE_NEGLIGIBLE = 1e-3  # coefficients below this are omitted in a coarse volume
COARSE_PIXELS = 80  # pixels of a layer along its longer edge


# Limits that leave processor time to a running solver:
PAUSE = 0.15  # s, least time between two maps
LOAD = 4  # least ratio of the time between two maps to the time that a map takes
FOLLOW_TIME = 0.6  # s, least time for which the map of a microphone is shown while the page follows the solver
DRAG_TIME = 1.0  # s, longest time for which an old map is shown while a microphone is dragged
IDLE_TIME = 0.35  # s without a change before a finer map is requested


class CostMapWorker:
    """Requests maps, and returns the newest one that may be shown; threads call only `_compute` and `_compute_fine`."""

    def __init__(self, run: PreparedRun, threads: Scheduler):
        self._run, self._since = run, 0.0
        # values and isosurfaces of the last coarse volume, key False, and of the last fine one, key True
        self._sampled, self._drawn = ({False: Memo(), True: Memo()} for _ in range(2))
        self._costs, self._fine_costs = Memo(), Memo()  # costs and minima of the last map on each thread
        self.worker = threads.worker(self._compute, quick=True)
        self._fine_worker = threads.worker(self._compute_fine)

    def newest(self, wanted: CostMapRequest, running: bool, now: float) -> tuple[CostMap | None, str]:
        """Return the map to show, or None, and the error that prevents its computation, or "".

        `wanted`: the map of the state on the screen; it is requested, unless it is in progress or the last request was
        too recent; `running`: whether the solver runs; `now`: time, s.
        """
        latest, due = self.worker.latest, True
        if latest is not None and running:
            last = latest.request[0]
            pause = max(PAUSE, LOAD * (latest.ended - latest.began))
            if wanted.follow and last.microphone != wanted.microphone:
                pause = max(pause, FOLLOW_TIME)
            due = now - latest.ended > pause or not last.replaces(wanted, running)  # or the user wants another map
            alike = (last.style.kind == "shape") == (wanted.style.kind == "shape") and last.style != wanted.style
            if alike and replace(last, style=wanted.style).replaces(wanted, True):
                wanted = replace(last, style=wanted.style)  # the costs of the last map, drawn in another style
        if not self.worker.wants(wanted) and due and not (running and self.worker.busy):
            self._since = now
            self.worker.newest(wanted)
        drawn = latest is not None and latest.request[0] == wanted
        idle = not running and now - self._since > IDLE_TIME
        # the finer surface of a relief would take seconds to send
        if drawn and idle and wanted.style.kind not in ("shape", "relief") and self.worker.wants(wanted):
            self._fine_worker.newest(wanted)
        fine, latest = self._fine_worker.latest, self.worker.latest
        if fine is not None and fine.result is not None and fine.request[0] == wanted:
            return fine.result, ""
        if latest is None:
            return None, ""
        last = latest.request[0]
        recent = now - max(latest.ended, self._since) < DRAG_TIME
        dragged = False
        if not running and recent and replace(last, revision=wanted.revision) == wanted:
            mine, theirs = (np.asarray(one.state.positions) for one in (last, wanted))
            dragged = mine.shape == theirs.shape and int(np.count_nonzero((mine != theirs).any(axis=1))) <= 1
        if dragged or last.replaces(wanted, running):
            return latest.result, error_message(latest.error)
        return None, ""

    def _volume(
        self, request: CostMapRequest, fine: bool, cancelled: Callable[[], bool] = lambda: False
    ) -> CostMap | None:
        """Return the volume on a fine or a coarse lattice, with the layer of the estimate; None once cancelled.

        If the fine volume is already known, it is returned even if the coarse one is asked for.
        """
        key, style, position = request.key, request.style, request.state.positions[request.microphone]
        pixels, negligible, points = PIXELS, maps.VOLUME_NEGLIGIBLE, POINTS
        if not fine:
            pixels, negligible, points = COARSE_PIXELS, COARSE_NEGLIGIBLE, COARSE_POINTS
        kept = self._sampled[True].get(key)
        fine = fine or kept is not None
        sampled: SampledVolume | None = kept or self._sampled[fine].get(key)
        if sampled is None:
            state, n, modes = request.state, request.microphone, request.modes
            offset = ORDER_OFFSET if request.order_offset is None else request.order_offset
            problem, x = self._run.problem, state.positions
            terms = maps.cost_volume(problem, x, n, modes, offset, state.channels, cancelled, negligible)
            sampled = None if terms is None else sampled_volume(terms, points, cancelled)
            if sampled is None:
                return None
            self._sampled[fine].keep(sampled, key)
        height = z_range_of(self._run.known_scene, self._run.measurement)[0]
        minima = sampled.minima if style.minima else None
        shown = sampled.cost, sampled.search, style.log, minima, map_label(self._run, request).partition(" (")[0]
        volume = self._drawn[fine](lambda: volume_of(*shown), key, style.log, style.minima)
        floor = layer_floor(volume, sampled, float(position[2]), height, style.log, pixels)
        fine = fine and pixels == PIXELS
        found, lowest = sampled.terms.on(*position), float(sampled.cost.min())
        here = float("nan") if found is None else float(found[0, 0, 0])
        lowest = float(np.nanmin([lowest, here]))  # a minimum may lie between lattice points
        return CostMap(request, floor, sampled.minima, here, lowest, fine, volume, sampled)

    def _compute(self, request: CostMapRequest) -> CostMap | None:
        """Return a map over the solver's lattice, or a coarse volume; on the fast thread."""
        if request.style.volume:
            return self._volume(request, False)
        run, n, modes, offset = self._run, request.microphone, request.modes, request.order_offset
        search = run.problem.search
        assert search is not None  # otherwise the page requests no map
        if request.style.kind == "shape":
            state, shown = request.state, modes if len(modes) <= MAX_WAVES else modes[-1:]
            names = [(mode, row_label(run.measurement, mode)) for mode in shown]
            height = z_range_of(run.known_scene, run.measurement)[0]
            of_state = state.order_offset, state.channels
            floor = wave_floor(run.problem, state.positions, n, names, *of_state, height, request.style.minima)
            return CostMap(request, floor, None, 0.0, 0.0)
        if (found := self._costs.get(request.key)) is None:
            total = maps.cost_maps(run.problem, run.solver, request.state, n, modes, offset, search).sum(axis=0)
            minima = maps.map_minima(run.problem, run.solver, request.state, n, modes, offset, total, search)
            found = self._costs.keep((total, search, minima), request.key)
        return cost_map(run, request, *found)

    def _compute_fine(self, request: CostMapRequest) -> CostMap | None:
        """Return the finer map, mode by mode; None as soon as another one is requested; on the slow thread."""
        cancelled = lambda: not self.worker.wants(request)  # noqa: E731
        if request.style.volume:
            return self._volume(request, True, cancelled)
        if (found := self._fine_costs.get(request.key)) is None:
            made = fine_maps(self._run, request, cancelled)
            if made is None:
                return None
            found = self._fine_costs.keep((*made[1:], maps.minima_of(*made[1:])), request.key)
        return replace(cost_map(self._run, request, *found), fine=True)
