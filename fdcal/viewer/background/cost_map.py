"""One cost map: what a page wants, its modes and their names, and the finished floor or volume with its figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ...cost.basins import basins_of
from ...cost.expansion import expansion_of
from ...cost.maps import cost_maps, interpolate, power_shares, refined
from ...cost.scale import Minima
from ...graphics.basin_map import basin_floor, descent_text
from ...graphics.heatmap import cost_floor, cost_label
from ...graphics.picture import row_word, z_range_of
from ...graphics.primitives import Area, ColourBar, Floor
from ...graphics.volume import SampledVolume, Volume
from ...model.measurement import Measurement
from ...model.settings import Search
from ...model.validation import InputError
from ...solvers.interface import RunState
from ..display_frame import drawn_truth
from .prepare import PreparedRun


@dataclass(frozen=True)
class MapStyle:
    """How a map is drawn."""

    log: bool = True  # whether its scale is logarithmic
    opacity: float = 1.0  # 0 to 1
    relief: bool = False  # whether its heights rise with its colours
    relief_height: float = 0.3  # of the highest cost, of the longer side of the search domain
    shared: bool = False  # one scale for all the maps side by side
    dark: bool = False  # whether the page is
    shape: bool = False  # the sound field of the last of the modes instead of a cost
    minima: bool = True  # whether its local minima are marked and counted
    volume: bool = False  # the cost in space instead of on the floor
    basins: bool = False  # the basins of attraction instead of the cost
    slice_axis: str = "z"  # "x", "y" or "z", across the slice through the volume; "none" for no slice
    slice_position: float | None = None  # of the slice along that axis, metres; None for the estimate of the microphone


@dataclass(frozen=True)
class CostMapRequest:
    """A map to be computed."""

    revision: int  # counts the states on the screen, which have no cheap equality of their own
    microphone: int  # counted from 0
    modes: tuple[int, ...]  # counted from 1
    order_offset: int | None  # of the map of Eq. 7; None for what the solver minimises
    custom_modes: bool  # whether the user has chosen the modes; otherwise they are those in use
    style: MapStyle
    follow: bool = field(compare=False)  # whether any microphone will do, as long as the solver has moved it lately
    state: RunState = field(compare=False)  # of the solver
    lineage: object = field(compare=False)  # of the history that the state belongs to
    take: int | None = None  # whose rows the map is of; None for those of all takes

    def stands_for(self, wanted: CostMapRequest, running: bool) -> bool:
        """Whether this map may be shown in place of `wanted`: while running, the map of an older state may."""
        if self == wanted or not running:
            return self == wanted
        mine, theirs = (
            (
                None if wanted.follow else one.microphone,
                one.modes if one.custom_modes else None,
                one.order_offset,
                one.style,
                one.take,
            )
            for one in (self, wanted)
        )
        return mine == theirs and self.lineage is wanted.lineage

    def differs_in_style(self, wanted: CostMapRequest) -> bool:
        """Whether `wanted` is this map of costs or field in another style; its state may be newer."""
        alike = self.style.shape == wanted.style.shape and replace(self, style=wanted.style).stands_for(wanted, True)
        return alike and self.style != wanted.style

    def differs_in_slider(self, wanted: CostMapRequest) -> bool:
        """Whether `wanted` is this volume with another slice, or this relief of another height."""
        moved = {name: getattr(wanted.style, name) for name in ("slice_axis", "slice_position", "relief_height")}
        return replace(self, style=replace(self.style, **moved)) == wanted

    def differs_in_theme(self, wanted: CostMapRequest) -> bool:
        """Whether `wanted` is this map on a page of the other theme, whose colours of costs are the same."""
        return self != wanted and replace(self, style=replace(self.style, dark=wanted.style.dark)) == wanted

    def differs_in_one_position(self, wanted: CostMapRequest) -> bool:
        """Whether `wanted` is this map except for the position of one microphone, as during a drag."""
        if replace(self, revision=wanted.revision) != wanted:
            return False
        mine, theirs = (np.asarray(one.state.positions) for one in (self, wanted))
        return mine.shape == theirs.shape and int(np.count_nonzero((mine != theirs).any(axis=1))) <= 1


MAX_PANELS = 9  # maps of single modes that are drawn one by one


@dataclass(frozen=True)
class ModePanels:
    """Maps of single modes, on the lattice of the map on the floor."""

    modes: tuple[int, ...]  # (K,) int, counted from 1
    maps: np.ndarray  # (K, ny, nx) float64
    total: np.ndarray  # (ny, nx) float64, the sum over all modes of the request
    search: Search  # the lattice


def map_label(run: PreparedRun, request: CostMapRequest) -> str:
    """Return name and unit of what a map shows."""
    if request.order_offset is not None:
        return "cost, Eq. 7 (dB)" if request.style.log else "cost, Eq. 7 (relative to the power)"
    if run.solver.TRAITS.uses_likelihood:
        return "negative log-likelihood of the solver"
    return cost_label(run.scene.solver.weights).replace("cost", "cost of the solver")


def row_label(measurement: Measurement, mode: int) -> str:
    """Return which row a map is of: "mode 38, 211.5 Hz", or, of several takes, "row 38, take 1, 211.5 Hz"."""
    take = f", take {measurement.takes[mode - 1]}" if measurement.take_count > 1 else ""
    return f"{row_word(measurement)} {mode}{take}, {measurement.frequencies[mode - 1]:.1f} Hz"


def count_label(measurement: Measurement, modes: tuple[int, ...]) -> str:
    """Return how many rows are summed: "20 modes", or, of several takes, "20 rows of take 1", "40 rows of 2 takes"."""
    count, takes = len(modes), np.unique(measurement.takes[np.asarray(modes) - 1])
    text = f"{count} {row_word(measurement)}{'s' if count > 1 else ''}"
    if measurement.take_count == 1:
        return text
    return f"{text} of {f'take {takes[0]}' if len(takes) == 1 else f'{len(takes)} takes'}"


def modes_label(measurement: Measurement, modes: tuple[int, ...]) -> str:
    """Return which modes a map is of, ascending: "mode 38", "modes 1 to 20", "4 modes from 2 to 9"."""
    first, last, count = modes[0], modes[-1], len(modes)
    if measurement.take_count > 1:
        return count_label(measurement, modes) if count > 1 else f"row {first}, take {measurement.takes[first - 1]}"
    if count == 1:
        return f"mode {first}"
    return f"modes {first} to {last}" if last - first + 1 == count else f"{count} modes from {first} to {last}"


def map_modes(
    run: PreparedRun,
    state: RunState,
    chosen: tuple[int, ...] | None,
    order_offset: int | None,
    take: int | None = None,
) -> tuple[int, ...]:
    """Return the modes of a map, counted from 1.

    `state`: of the solver; `chosen`: by the user; None for the modes in use, of Eq. 7 those that the microphones can
    carry, if there are any; `order_offset`: of the map of Eq. 7; None for what the solver minimises; `take`: whose rows
    alone are shown, the lowest where none of its rows is chosen; None for those of all takes.
    """
    if chosen is not None:
        return of_take(run, chosen, take)
    used = of_take(run, tuple(range(state.first, state.last + 1)), take)
    carried = set(carried_modes(run, order_offset, max(state.last, used[-1])))
    return tuple(mode for mode in used if mode in carried) or used


def of_take(run: PreparedRun, modes: tuple[int, ...], take: int | None) -> tuple[int, ...]:
    """Return those of some modes that belong to a take, its lowest where none does; all for None."""
    if take is None:
        return modes
    takes = run.problem.takes
    return tuple(mode for mode in modes if takes[mode - 1] == take) or (int(np.argmax(takes == take)) + 1,)


def carried_modes(run: PreparedRun, order_offset: int | None, last: int) -> tuple[int, ...]:
    """Return the modes up to `last`, counted from 1, of which the microphones can carry a map of Eq. 7.

    Without a search domain, and for a map of what the solver minimises (`order_offset` None), these are all.
    """
    if order_offset is None or run.problem.search is None:
        return tuple(range(1, last + 1))
    carried = expansion_of(run.problem, order_offset).carried.modes + 1
    return tuple(int(mode) for mode in carried if mode <= last)


def shown_modes(count: int, max_count: int = MAX_PANELS) -> np.ndarray:
    """Return which of `count` maps are drawn one by one, evenly spaced : indices."""
    return np.unique(np.linspace(0, count - 1, min(count, max_count)).round().astype(int))


def fine_panels(
    run: PreparedRun,
    request: CostMapRequest,
    cancelled: Callable[[], bool] = lambda: False,
    max_count: int = MAX_PANELS,
) -> ModePanels | None:
    """Return the maps of a request on a lattice as fine as the screen, computed mode by mode; None once cancelled.

    `cancelled`: tells whether the maps are no longer wanted; `max_count`: maps of single modes that are kept. Raises
    InputError: there is no search domain, or a mode cannot be shown at the order of the request.
    """
    problem, modes, offset = run.problem, request.modes, request.order_offset
    if problem.search is None:
        raise InputError("there is no map without a search domain", "give <search> and <radius>", key="search")
    search, shown = refined(problem.search), set(shown_modes(len(modes), max_count).tolist())
    fraction = np.ones(len(modes)) if offset is None else power_shares(problem, request.state, modes)
    total, kept = np.zeros(1), []
    for i, mode in enumerate(modes):
        if cancelled():
            return None
        cost = cost_maps(problem, run.solver, request.state, request.microphone, (mode,), offset, search)[0]
        total = total + fraction[i] * cost
        if i in shown:
            kept.append(fraction[i] * cost)
    return ModePanels(tuple(modes[i] for i in sorted(shown)), np.stack(kept), total, search)


@dataclass(frozen=True)
class CostMap:
    """A finished map: the floor or the volume, the costs it shows, and the figures of its caption."""

    request: CostMapRequest
    floor: Floor | None  # or None of a volume
    panels: ModePanels | None  # ModePanels of some of the single modes and of the sum, which the floor shows; or None
    minima: Minima | None  # of the map; None of the shape of a mode
    cost_here: float  # cost at the estimated position of the microphone
    lowest: float  # lowest cost of the map
    fine: bool = False  # whether its lattice is finer than the solver's
    volume: Volume | None = None  # or None of a map on the floor
    note: str = ""  # on the basins of attraction, in words; "" of other maps
    sampled: SampledVolume | None = None  # values of a volume; None of a map on the floor

    @property
    def areas(self) -> tuple[Area, ...]:
        """What its colours stand for, where they have no scale."""
        part = self.volume if self.floor is None else self.floor
        return () if part is None else part.areas

    @property
    def bar(self) -> ColourBar | None:
        """The scale of its colours; None where they stand for areas."""
        if self.volume is not None:
            return self.volume.bar
        if self.floor is None:
            raise ValueError("a map has a floor or a volume")
        return self.floor.bar


def cost_map(
    run: PreparedRun,
    request: CostMapRequest,
    total,
    search: Search,
    minima: Minima,
    panels: ModePanels | None = None,
) -> CostMap:
    """Return a finished map on the floor.

    `request`: what the map is of, and how it is drawn; `total` (ny, nx) float64, the cost; `search`: lattice of
    `total`; `minima`: to be marked; `panels`: maps of single modes, or None.
    """
    style, n = request.style, request.microphone
    here = interpolate(total, search, request.state.positions[n])
    figures = minima, here, min(here, float(total.min()))  # the lowest cost may lie between lattice points
    height = z_range_of(run.known_scene, run.measurement)[0]
    if style.basins:
        floor, note = basins_floor(run, request, total, search, minima, height)
        return CostMap(request, floor, panels, *figures, note=note)
    label = f"{map_label(run, request)}, {modes_label(run.measurement, request.modes)}"
    if run.measurement.array_dimension == 3:
        label += f" at z = {request.state.positions[n, 2]:.2f} m"
    floor = cost_floor(
        total, search, style.log, label, minima=minima,
        relief=style.relief, relief_height=style.relief_height, height=height,
        decibels=request.order_offset is not None,
    )  # fmt: skip
    return CostMap(request, replace(floor, show_minima=style.minima), panels, *figures)


def basins_floor(
    run: PreparedRun, request: CostMapRequest, total: np.ndarray, search: Search, minima: Minima, height: float
) -> tuple[Floor, str]:
    """Return the basins of attraction of a cost (ny, nx), and a sentence on them.

    `run`, `request`, `search`, `minima`: as of `cost_map`; `height`: of the map, metres.
    """
    basins, (place, name) = basins_of(total), place_of_basin(run, request)
    floor = basin_floor(basins, search, minima, place, name, height)
    return replace(floor, show_minima=request.style.minima), descent_text(basins, search, place, name)


def place_of_basin(run: PreparedRun, request: CostMapRequest) -> tuple[np.ndarray, str]:
    """Return the place whose basin matters most, and its name: the true position if known, or the estimate."""
    positions = np.asarray(request.state.positions)
    truth = drawn_truth(run, positions)
    places, name = (positions, "estimate") if truth is None else (truth, f"{run.measurement.reference} position")
    return places[request.microphone], name
