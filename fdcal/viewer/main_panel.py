"""The main panel: the run bar above, the tabs below."""

from __future__ import annotations

from collections.abc import Callable

import viser

from ..session.history import SessionView
from .background.cost_maps import CostMap
from .gui import html
from .gui.binding import Binding, Choices
from .gui.layout import SessionFolders
from .server.client_values import one_of
from .tabs.export import SEEN, ExportTab
from .tabs.map import MapTab
from .tabs.run import RunBar
from .tabs.scene import SceneTab
from .tabs.solver import SolverTab


class MainPanel:
    """Owns the parts of the main panel."""

    def __init__(
        self,
        folders: SessionFolders,
        binding: Binding,
        place: Callable[[viser.ClientHandle, str], None],
        export: Callable[[viser.ClientHandle, str], None],
    ):
        self.binding = binding
        with folders.at("Solve"):
            self.solve = SolverTab(binding)
        with folders.bar():
            self.bar = RunBar(binding, self.solve.start_anew)
        with folders.at("Scene"):
            self.scene = SceneTab(binding)
        with folders.at("Map"):
            self.map = MapTab(binding)
        with folders.at("View"):
            self._add_view(place)
        with folders.at("Export"):
            self.export = ExportTab(binding, export)

    @property
    def choices(self) -> Choices:
        return self.binding.choices

    def _add_view(self, place) -> None:
        gui, binding = self.binding.gui, self.binding
        self.camera = gui.add_button_group(
            "Camera", tuple(SEEN), hint="Of this page alone: from above, the whole room, or the array"
        )
        self.dark = gui.add_checkbox("Dark page", binding.choices.look.dark)
        self.trails = gui.add_checkbox(
            "Trails", binding.choices.trails, hint="The way that each microphone has come, last 200 states"
        )
        self.ellipses = gui.add_checkbox(
            "Error ellipses (95 %)", binding.choices.ellipses, hint="Of a solver that has finished"
        )
        self.waits = gui.add_html(html.remark("They come once the solver has finished."), visible=False)
        binding.on(self.trails, lambda value: self.draw(trails=bool(value)))
        binding.on(self.ellipses, lambda value: self.draw(ellipses=bool(value)))
        binding.on_page(self.camera, lambda client, value: place(client, SEEN[one_of(value, SEEN, "Top")]))
        binding.on(self.dark, self.darken)
        self._theme()

    def draw(self, **wanted: bool) -> None:
        """Trails, ellipses: drawn or not."""
        self.binding.choose(**wanted)
        for name, value in wanted.items():
            handle = getattr(self, name)
            if handle.value != value:
                handle.value = value

    def darken(self, value) -> None:
        """Dark page and map, or light ones."""
        dark = bool(value)
        self.binding.look(dark=dark)
        self._theme()
        if self.dark.value != dark:
            self.dark.value = dark

    def _theme(self) -> None:
        dark = self.binding.choices.look.dark
        self.binding.gui.configure_theme(dark_mode=dark, show_share_button=False, show_logo=False)

    def show(
        self, view: SessionView, microphone: int, drawn: CostMap | None, trouble: str, fault: str = "", note: str = ""
    ) -> None:
        """Bring the panel up to date; called by the main loop."""
        self.bar.show(view, fault, note)
        waits = self.binding.choices.ellipses and not view.state.finished
        self.binding.send("ellipses wait", waits, self.waits, "visible")
        self.solve.show(view)
        self.map.show(microphone, drawn, trouble)
