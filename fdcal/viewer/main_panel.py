"""The main panel: the run bar above, the tabs below."""

from __future__ import annotations

from collections.abc import Callable

import viser

from ..session.history import SessionView
from .background.cost_maps import Map
from .gui import html
from .gui.binding import Choices, Desk
from .gui.layout import Rooms
from .server.hardening import one_of
from .tabs.export import SEEN, ExportTab
from .tabs.map import MapTab
from .tabs.run import RunBar
from .tabs.scene import SceneTab
from .tabs.solver import SolveTab


class Controls:
    """Owns the parts of the main panel."""

    def __init__(
        self,
        rooms: Rooms,
        desk: Desk,
        place: Callable[[viser.ClientHandle, str], None],
        export: Callable[[viser.ClientHandle, str], None],
    ):
        self.desk = desk
        with rooms.at("Solve"):
            self.solve = SolveTab(desk)
        with rooms.bar():
            self.bar = RunBar(desk, self.solve.start_anew)
        with rooms.at("Scene"):
            self.scene = SceneTab(desk)
        with rooms.at("Map"):
            self.map = MapTab(desk)
        with rooms.at("View"):
            self._add_view(place)
        with rooms.at("Export"):
            self.export = ExportTab(desk, export)

    @property
    def choices(self) -> Choices:
        return self.desk.choices

    def _add_view(self, place) -> None:
        gui, desk = self.desk.gui, self.desk
        self.camera = gui.add_button_group(
            "Camera", tuple(SEEN), hint="Of this page alone: from above, the whole room, or the array"
        )
        self.dark = gui.add_checkbox("Dark page", desk.choices.look.dark)
        self.trails = gui.add_checkbox(
            "Trails", desk.choices.trails, hint="The way that each microphone has come, last 200 states"
        )
        self.ellipses = gui.add_checkbox(
            "Error ellipses (95 %)", desk.choices.ellipses, hint="Of a solver that has finished"
        )
        self.waits = gui.add_html(html.remark("They come once the solver has finished."), visible=False)
        desk.on(self.trails, lambda value: self.draw(trails=bool(value)))
        desk.on(self.ellipses, lambda value: self.draw(ellipses=bool(value)))
        desk.on_page(self.camera, lambda client, value: place(client, SEEN[one_of(value, SEEN, "Top")]))
        desk.on(self.dark, self.darken)
        self._theme()

    def draw(self, **wanted: bool) -> None:
        """Trails, ellipses: drawn or not."""
        self.desk.choose(**wanted)
        for name, value in wanted.items():
            handle = getattr(self, name)
            if handle.value != value:
                handle.value = value

    def darken(self, value) -> None:
        """Dark page and map, or light ones."""
        dark = bool(value)
        self.desk.look(dark=dark)
        self._theme()
        if self.dark.value != dark:
            self.dark.value = dark

    def _theme(self) -> None:
        dark = self.desk.choices.look.dark
        self.desk.gui.configure_theme(dark_mode=dark, show_share_button=False, show_logo=False)

    def show(
        self, view: SessionView, microphone: int, drawn: Map | None, trouble: str, fault: str = "", note: str = ""
    ) -> None:
        """Bring the panel up to date; called by the main loop."""
        self.bar.show(view, fault, note)
        waits = self.desk.choices.ellipses and not view.state.finished
        self.desk.tell("ellipses wait", waits, self.waits, "visible")
        self.solve.show(view)
        self.map.show(microphone, drawn, trouble)
