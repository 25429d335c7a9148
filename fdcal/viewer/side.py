"""The panel on the left: what there is to be seen beside the scene."""

from __future__ import annotations

import numpy as np
import viser

from ..history import SessionView
from . import words
from .desk import Desk
from .maps import Map
from .plots import Curves

WIDTH = 300.0  # pixels
INTERVAL = 0.2  # s between two images of the maps side by side


class SidePanel:
    """Owns the panel's tabs."""

    def __init__(self, gui: viser.GuiApi, desk: Desk):
        self._desk, self._sent, self._panels = desk, -1e9, None
        panel = gui.add_panel()
        with panel.add_tab("Curves", viser.Icon.CHART_LINE):
            gui.add_html(words.legend())
            self.curves = Curves(gui, desk.measurement)
        with panel.add_tab("Maps", viser.Icon.LAYOUT_GRID):
            self.caption = gui.add_html(words.panels_caption(None))
            self.shared = gui.add_checkbox("One scale for all", False, hint="Otherwise each map has its own")
            self.image = gui.add_image(np.full((8, 8, 3), 128, np.uint8), format="jpeg", jpeg_quality=92)
            self.image.visible = False
        desk.on(self.shared, lambda value: desk.look(shared=bool(value)))
        panel.dock_left()
        panel.set_width(WIDTH)

    def show(self, view: SessionView, drawn: Map | None, now: float) -> None:
        """Called by the main loop."""
        self.curves.show(view, now)
        panels = None if drawn is None else drawn.panels
        if panels is self._panels or now - self._sent < INTERVAL:
            return
        self._sent, self._panels = now, panels
        self.image.visible = panels is not None
        if panels is not None:
            self.image.image = panels
        self._desk.tell("caption", words.panels_caption(drawn), self.caption, "content")
