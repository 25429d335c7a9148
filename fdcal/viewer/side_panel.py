"""The panel on the left: what there is to be seen beside the scene."""

from __future__ import annotations

import numpy as np

from ..model.measurement import Problem
from ..session.history import SessionView
from .background.comparison import Races
from .background.cost_maps import Map
from .background.map_grid import SideBySide
from .background.uncertainty import Errors
from .gui import html
from .gui.binding import Desk
from .gui.layout import Rooms
from .gui.plots import Curves
from .tabs.comparison import RaceTab
from .tabs.error_by_distance import Reach
from .tabs.map import MapTab
from .tabs.modes import ModesTab

INTERVAL = 0.2  # s between two tables


class SidePanel:
    """Owns the panel's tabs."""

    def __init__(self, rooms: Rooms, desk: Desk, problem: Problem, map_tab: MapTab, races: Races):
        self._desk, self._tabled, self._panels = desk, -1e9, None
        gui = desk.gui
        with rooms.at("Curves"):
            gui.add_html(html.legend())
            self.curves = Curves(gui, desk.measurement)
        with rooms.at("Maps"):
            self.caption = gui.add_html(html.panels_caption(None))
            self.shared = gui.add_checkbox(
                "One scale for all", desk.choices.look.shared, hint="Otherwise each map has its own"
            )
            self.image = gui.add_image(np.full((8, 8, 3), 128, np.uint8), format="jpeg", jpeg_quality=92)
            self.image.visible = False
        with rooms.at("Modes"):
            self.modes = ModesTab(desk, problem, map_tab)
        with rooms.at("Mics"):
            self.reach = Reach(gui, desk.measurement)
            self.table = gui.add_html("")
        with rooms.at("Race"):
            self.race = RaceTab(desk, races)
        self.side_by_side = SideBySide(desk.work)
        self._table_key: tuple = ()
        desk.on(self.shared, lambda value: desk.look(shared=bool(value)))

    def show(self, view: SessionView, drawn: Map | None, microphone: int, errors: Errors | None, now: float) -> None:
        """Called by the main loop."""
        self.curves.show(view, now)
        self.reach.show(view, now)
        self.modes.show(view, now)
        self._show_table(view.state, microphone, errors, now)
        self._show_panels(drawn, now)

    def _show_table(self, state, microphone: int, errors: Errors | None, now: float) -> None:
        key = (id(state), microphone, id(errors))
        if key != self._table_key and now - self._tabled > INTERVAL:
            self._table_key, self._tabled = key, now
            sigma = None if errors is None else errors.sigma
            text = html.table(self._desk.measurement, np.asarray(state.positions), sigma, microphone)
            self._desk.tell("table", text, self.table, "content")

    def _show_panels(self, drawn: Map | None, now: float) -> None:
        panels = self.side_by_side.of(drawn, now)
        if panels is self._panels:
            return
        self._panels = panels
        self.image.visible = panels is not None
        if panels is not None:
            self.image.image = panels
        self._desk.tell("caption", html.panels_caption(drawn), self.caption, "content")
