"""The panel on the left: what there is to be seen beside the scene."""

from __future__ import annotations

import numpy as np

from ..model.problem import Problem
from ..session.history import SessionView
from .background.comparison import ComparisonWorker
from .background.cost_maps import CostMap
from .background.map_grid import MapGridWorker
from .background.uncertainty import PositionUncertainty
from .gui import html
from .gui.binding import Binding
from .gui.layout import SessionFolders
from .gui.plots import Curves
from .tabs.comparison import ComparisonTab
from .tabs.error_by_distance import ErrorByDistance
from .tabs.map import MapTab
from .tabs.modes import ModesTab

INTERVAL = 0.2  # s between two tables


class SidePanel:
    """Owns the panel's tabs."""

    def __init__(
        self, folders: SessionFolders, binding: Binding, problem: Problem, map_tab: MapTab, races: ComparisonWorker
    ):
        self._binding, self._tabled, self._panels = binding, -1e9, None
        gui = binding.gui
        with folders.at("Curves"):
            gui.add_html(html.legend())
            self.curves = Curves(gui, binding.measurement)
        with folders.at("Maps"):
            self.caption = gui.add_html(html.panels_caption(None))
            self.shared = gui.add_checkbox(
                "One scale for all", binding.choices.look.shared, hint="Otherwise each map has its own"
            )
            self.image = gui.add_image(np.full((8, 8, 3), 128, np.uint8), format="jpeg", jpeg_quality=92)
            self.image.visible = False
        with folders.at("Modes"):
            self.modes = ModesTab(binding, problem, map_tab)
        with folders.at("Mics"):
            self.reach = ErrorByDistance(gui, binding.measurement)
            self.table = gui.add_html("")
        with folders.at("Race"):
            self.race = ComparisonTab(binding, races)
        self.map_grid = MapGridWorker(binding.work)
        self._table_key: tuple = ()
        binding.on(self.shared, lambda value: binding.look(shared=bool(value)))

    def show(
        self, view: SessionView, drawn: CostMap | None, microphone: int, errors: PositionUncertainty | None, now: float
    ) -> None:
        """Called by the main loop."""
        self.curves.show(view, now)
        self.reach.show(view, now)
        self.modes.show(view, now)
        self._show_table(view.state, microphone, errors, now)
        self._show_panels(drawn, now)

    def _show_table(self, state, microphone: int, errors: PositionUncertainty | None, now: float) -> None:
        key = (id(state), microphone, id(errors))
        if key != self._table_key and now - self._tabled > INTERVAL:
            self._table_key, self._tabled = key, now
            sigma = None if errors is None else errors.sigma
            text = html.table(self._binding.measurement, np.asarray(state.positions), sigma, microphone)
            self._binding.send("table", text, self.table, "content")

    def _show_panels(self, drawn: CostMap | None, now: float) -> None:
        panels = self.map_grid.of(drawn, now)
        if panels is self._panels:
            return
        self._panels = panels
        self.image.visible = panels is not None
        if panels is not None:
            self.image.image = panels
        self._binding.send("caption", html.panels_caption(drawn), self.caption, "content")
