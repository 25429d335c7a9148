"""What a thread of maps makes: a map on the floor or the cost in space, with the figures of its caption."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ...cost import landscapes
from ...graphics.heatmap import cost_floor
from ...graphics.primitives import ColourBar, Floor
from ...graphics.surroundings import z_range_of
from ...graphics.volume import Volume
from ...model.settings import Search
from .map_panels import ModePanels, map_label, modes_label
from .map_request import CostMapRequest
from .prepare import PreparedRun


@dataclass(frozen=True)
class CostMap:
    """A finished map: the floor or the volume, the costs it shows, and the figures of its caption.

    Attributes
    ----------
    request : CostMapRequest
    floor : Floor, or None of a volume
    panels : ModePanels of some of the single modes and of the sum, which the floor shows; or None
    minima : int, local minima in the map
    cost_here : cost at the estimated position of the microphone
    lowest : lowest cost of the map
    fine : whether its lattice is finer than the solver's
    volume : Volume, or None of a map on the floor
    """

    request: CostMapRequest
    floor: Floor | None
    panels: ModePanels | None
    minima: int
    cost_here: float
    lowest: float
    fine: bool = False
    volume: Volume | None = None

    @property
    def bar(self) -> ColourBar:
        """The scale of its colours."""
        if self.volume is not None:
            return self.volume.bar
        if self.floor is None:
            raise ValueError("a map has a floor or a volume")
        return self.floor.bar


def cost_map(
    run: PreparedRun, request: CostMapRequest, total, search: Search, minima, panels: ModePanels | None = None
) -> CostMap:
    """Return a finished map on the floor.

    Parameters
    ----------
    run : PreparedRun
    request : what the map is of, and how it is drawn
    total : (ny, nx) float64, the cost
    search : lattice of `total`
    minima : (K, 2) int64, rows and columns of the local minima
    panels : maps of single modes, or None
    """
    style, n = request.style, request.microphone
    label = f"{map_label(run, request)}, {modes_label(request.modes)}"
    if run.measurement.array_dimension == 3:
        label += f" at z = {request.state.positions[n, 2]:.2f} m"
    floor = cost_floor(
        total, search, style.log, label, minima=landscapes.map_positions(minima, search),
        relief=style.relief, relief_height=style.relief_height, height=z_range_of(run.known_scene, run.measurement)[0],
        decibels=request.order_offset is not None,
    )  # fmt: skip
    floor = replace(floor, show_minima=style.minima)
    here = landscapes.interpolate(total, search, request.state.positions[n])
    return CostMap(request, floor, panels, len(minima), here, float(total.min()))
