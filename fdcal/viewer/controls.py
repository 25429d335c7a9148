"""The main panel: the run bar above, the tabs below."""

from __future__ import annotations

from collections.abc import Callable

import viser

from ..history import SessionView
from .desk import Choices, Desk
from .frame import Rooms
from .maps import Map
from .maptab import MapTab
from .runtab import RunBar
from .safety import one_of
from .scenetab import SceneTab
from .solvetab import SolveTab

VIEWS = {"Top": "top", "3-D": "3d", "Close": "close"}
SIZES = {"1280 x 800": (1280, 800), "1920 x 1080": (1920, 1080), "3840 x 2160": (3840, 2160)}


class Controls:
    """Owns the parts of the main panel."""

    def __init__(
        self,
        rooms: Rooms,
        desk: Desk,
        place: Callable[[viser.ClientHandle, str], None],
        export: Callable[[viser.ClientHandle, Choices], None],
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
        with rooms.at("Save"):
            self._add_export(export)

    @property
    def choices(self) -> Choices:
        return self.desk.choices

    def _add_view(self, place) -> None:
        gui, desk = self.desk.gui, self.desk
        self.camera = gui.add_button_group(
            "Camera", tuple(VIEWS), hint="Of this page alone: from above, the whole room, or the array"
        )
        self.dark = gui.add_checkbox("Dark page", desk.choices.look.dark)
        self.trails = gui.add_checkbox(
            "Trails", desk.choices.trails, hint="The way that each microphone has come, last 200 states"
        )
        self.ellipses = gui.add_checkbox(
            "Error ellipses (95 %)", desk.choices.ellipses, hint="Of a solver that has finished"
        )
        desk.on(self.trails, lambda value: self.draw(trails=bool(value)))
        desk.on(self.ellipses, lambda value: self.draw(ellipses=bool(value)))
        desk.on_page(self.camera, lambda client, value: place(client, VIEWS[one_of(value, VIEWS, "Top")]))
        desk.on(self.dark, self.darken)

    def draw(self, **wanted: bool) -> None:
        """Trails, ellipses: drawn or not."""
        self.desk.choose(**wanted)
        for name, value in wanted.items():
            handle = getattr(self, name)
            if handle.value != value:
                handle.value = value

    def _add_export(self, export) -> None:
        gui, desk = self.desk.gui, self.desk
        view = gui.add_dropdown("Seen from", tuple(VIEWS), initial_value="Top")
        size = gui.add_dropdown("Size (pixels)", tuple(SIZES), initial_value="1280 x 800")
        button = gui.add_button("Save PNG", icon=viser.Icon.PHOTO, hint="Drawn anew off-screen, in about 5 s")
        desk.on(view, lambda value: desk.choose(export_view=VIEWS[one_of(value, VIEWS, "Top")]))
        desk.on(size, lambda value: desk.choose(export_size=SIZES[one_of(value, SIZES, "1280 x 800")]))
        desk.on_page(button, lambda client, _: export(client, desk.choices))

    def darken(self, value) -> None:
        """Dark page and map, or light ones."""
        dark = bool(value)
        self.desk.look(dark=dark)
        self.desk.gui.configure_theme(dark_mode=dark, show_share_button=False, show_logo=False)
        if self.dark.value != dark:
            self.dark.value = dark

    def show(self, view: SessionView, microphone: int, drawn: Map | None, trouble: str, fault: str = "") -> None:
        """Bring the panel up to date; called by the main loop."""
        self.bar.show(view, fault)
        self.solve.show(view)
        self.map.show(microphone, drawn, trouble)
