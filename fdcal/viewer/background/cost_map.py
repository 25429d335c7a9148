"""What a thread of maps makes: a map on the floor or the cost in space, with the figures of its caption."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...cost.basins import basins_of
from ...cost.maps import interpolate, map_positions
from ...graphics.basin_map import basin_floor, descent_text
from ...graphics.heatmap import cost_floor
from ...graphics.primitives import Area, ColourBar, Floor
from ...graphics.surroundings import z_range_of
from ...graphics.volume import Volume
from ...model.settings import Search
from .map_panels import ModePanels, map_label, modes_label
from .map_request import CostMapRequest
from .prepare import PreparedRun


@dataclass(frozen=True)
class CostMap:
    """A finished map: the floor or the volume, the costs it shows, and the figures of its caption."""

    request: CostMapRequest
    floor: Floor | None  # or None of a volume
    panels: ModePanels | None  # ModePanels of some of the single modes and of the sum, which the floor shows; or None
    minima: int  # local minima in the map
    cost_here: float  # cost at the estimated position of the microphone
    lowest: float  # lowest cost of the map
    fine: bool = False  # whether its lattice is finer than the solver's
    volume: Volume | None = None  # or None of a map on the floor
    note: str = ""  # on the basins of attraction, in words; "" of other maps

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
    run: PreparedRun, request: CostMapRequest, total, search: Search, minima, panels: ModePanels | None = None
) -> CostMap:
    """Return a finished map on the floor.

    `request`: what the map is of, and how it is drawn; `total` (ny, nx) float64, the cost; `search`: lattice of
    `total`; `minima` (K, 2) int64, rows and columns of the local minima; `panels`: maps of single modes, or None.
    """
    style, n = request.style, request.microphone
    here = interpolate(total, search, request.state.positions[n])
    figures = len(minima), here, float(total.min())
    height = z_range_of(run.known_scene, run.measurement)[0]
    if style.basins:
        floor, note = basins_floor(run, request, total, search, height)
        return CostMap(request, floor, panels, *figures, note=note)
    label = f"{map_label(run, request)}, {modes_label(run.measurement, request.modes)}"
    if run.measurement.array_dimension == 3:
        label += f" at z = {request.state.positions[n, 2]:.2f} m"
    floor = cost_floor(
        total, search, style.log, label, minima=map_positions(minima, search),
        relief=style.relief, relief_height=style.relief_height, height=height,
        decibels=request.order_offset is not None,
    )  # fmt: skip
    return CostMap(request, replace(floor, show_minima=style.minima), panels, *figures)


def basins_floor(
    run: PreparedRun, request: CostMapRequest, total: np.ndarray, search: Search, height: float
) -> tuple[Floor, str]:
    """Return the basins of attraction of a cost (ny, nx), and a sentence on them.

    `run`, `request`, `search`: as of `cost_map`; `height`: of the map, metres.
    """
    basins, (place, name) = basins_of(total), place_of_basin(run, request)
    lowest = map_positions(np.array([np.unravel_index(total.argmin(), total.shape)]), search)[0]
    floor = basin_floor(basins, search, place, name, lowest=lowest, height=height)
    return replace(floor, show_minima=request.style.minima), descent_text(basins, search, place, name)


def place_of_basin(run: PreparedRun, request: CostMapRequest) -> tuple[np.ndarray, str]:
    """Return the place whose basin matters most, and its name: the true position if known, or the estimate."""
    positions = np.asarray(request.state.positions)
    truth = run.measurement.aligned_truth(positions)
    places, name = (positions, "estimate") if truth is None else (truth, f"{run.measurement.reference} position")
    return places[request.microphone], name
