"""The panels and their tabs. They stay for as long as the server does; what is in them comes and goes.

A tab that stays keeps its place on every page: one who looks at it while another scene is opened goes on doing so.
"""

from __future__ import annotations

import itertools
from contextlib import contextmanager

import viser

RIGHT_WIDTH, LEFT_WIDTH = 330.0, 300.0  # pixels
RIGHT = ("Solve", "Scene", "Map", "View", "Export", "Lessons", "Help")  # no icons: they leave too little place
LEFT = ("Curves", "Maps", "Modes", "Mics", "Race")


class Panels:
    """Owns the panels' tabs.

    `tab(name)` is a place for what stays, as lessons do; `SessionFolders` are places for what belongs to one session.
    """

    def __init__(self, gui: viser.GuiApi):
        self.gui, self.numbers = gui, itertools.count()
        gui.main_panel.dock_right()
        gui.main_panel.set_width(RIGHT_WIDTH)
        self.top = gui.add_folder(None)  # for what tells of the page as a whole
        self.bar = gui.add_folder(None)
        gui.add_divider()
        group, panel = gui.add_tab_group(), gui.add_panel()
        self._tabs = {name: group.add_tab(name) for name in RIGHT}
        self._tabs |= {name: panel.add_tab(name) for name in LEFT}
        panel.dock_left()
        panel.set_width(LEFT_WIDTH)

    def tab(self, name: str):
        """The tab, as a context in which to add."""
        return self._tabs[name]


class SessionFolders:
    """One session's parts of the tabs, taken away together."""

    def __init__(self, panels: Panels):
        self._panels, self._made, self.gui, self.number = panels, [], panels.gui, next(panels.numbers)

    @contextmanager
    def at(self, place):
        """Add to a tab, by its name, or to another container of the frame."""
        with self._panels.tab(place) if isinstance(place, str) else place:
            room = self._panels.gui.add_folder(None)  # without a label it is not seen
            self._made.append(room)
            with room:
                yield room

    def bar(self):
        """Add above the tabs of the main panel."""
        return self.at(self._panels.bar)

    def remove(self) -> None:
        """Take everything away."""
        for room in self._made:
            room.remove()
        self._made = []
