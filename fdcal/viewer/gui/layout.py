"""The two panels and their tabs, which stay as long as the server; the contents of one session come and go.

A tab that stays keeps its place in every browser: a user who looks at a tab while another scene is opened sees the
same tab afterwards.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager

import viser

RIGHT_WIDTH, LEFT_WIDTH = 340.0, 300.0  # pixels
# All tabs of a panel stay in one row of its width; on a phone, whose panel is narrower, in two that do not overlap.
TABS_STYLE = (
    "<style>[role=tab] {padding: 0 5px !important}"
    "@media (max-width: 600px) {[role=tablist] {height: auto !important; flex-wrap: wrap !important}"
    " [role=tab] {height: 2.2em !important; padding: 0 5px !important}}</style>"
)
RIGHT = ("Solver", "Scene", "Map", "View", "Export", "Lessons", "Help")  # without icons, which would take too much room
LEFT = ("Curves", "Maps", "Modes", "Mics", "Race")


class Panels:
    """Owns the main panel on the right, the panel on the left, and their tabs.

    Attributes
    ----------
    gui : viser.GuiApi
    top : folder above everything else, for messages about the page as a whole
    run_bar : folder between `top` and the tabs
    numbers : counts the sessions
    """

    def __init__(self, gui: viser.GuiApi):
        self.gui, self.numbers = gui, itertools.count()
        gui.main_panel.dock_right()
        gui.main_panel.set_width(RIGHT_WIDTH)
        self.top = gui.add_folder(None)
        gui.add_html(TABS_STYLE)
        self.run_bar = gui.add_folder(None)
        gui.add_divider()
        group, panel = gui.add_tab_group(), gui.add_panel()
        self.tabs = {name: group.add_tab(name) for name in RIGHT} | {name: panel.add_tab(name) for name in LEFT}
        panel.dock_left()
        panel.set_width(LEFT_WIDTH)

    def tab(self, name: str) -> viser.GuiTabHandle:
        """Return a tab; used as a context, controls are added to it."""
        return self.tabs[name]


class SessionFolders:
    """Folders in the tabs that hold the controls of one session, and are removed together.

    Attributes
    ----------
    number : int, of the session, counted from 0
    """

    def __init__(self, panels: Panels):
        self._panels, self.gui, self.number = panels, panels.gui, next(panels.numbers)
        self._folders: list[viser.GuiFolderHandle] = []

    def tab(self, name: str) -> AbstractContextManager[viser.GuiFolderHandle]:
        """Return a context in which controls are added to a tab."""
        return self._added(self._panels.tab(name))

    def run_bar(self) -> AbstractContextManager[viser.GuiFolderHandle]:
        """Return a context in which controls are added above the tabs of the main panel."""
        return self._added(self._panels.run_bar)

    @contextmanager
    def _added(self, place) -> Iterator[viser.GuiFolderHandle]:
        with place:
            folder = self.gui.add_folder(None)  # without a label it is not visible
            self._folders.append(folder)
            with folder:
                yield folder

    def remove(self) -> None:
        """Remove all folders and what they hold."""
        for folder in self._folders:
            folder.remove()
        self._folders = []
