"""The panels and their tabs, which stay as long as the server; the contents of one session come and go.

A tab that stays keeps its place in every browser: a user who looks at a tab while another scene is opened sees the
same tab afterwards.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager

import viser

RIGHT_WIDTH, LEFT_WIDTH = 340.0, 314.0  # pixels
# All tabs of a panel stay in one row of its width; on a phone, whose sheet is as wide as its screen, in as few rows as
# they need. 100 % in place of 100vw would be of what the sheet holds, and grow with every plot that fills it.
TABS_STYLE = (
    "<style>[role=tab] {padding: 0 4px !important}"
    "@media (max-width: 36em) {[style*='width: 20em'] {width: 100vw !important}"
    " [role=tablist] {height: auto !important; flex-wrap: wrap !important}"
    " [role=tab] {height: 2.2em !important; padding: 0 5px !important}}</style>"
)
LEGEND_EDGE, LEGEND_WIDTH = 8.0, 600.0  # pixels: from the edges of the canvas, and of the legend where there is room
LECTURE_WIDTH = 400.0  # pixels, of the legend in lecture mode
RIGHT = ("Solver", "Scene", "Map", "View", "Export", "Lessons", "Help")  # without icons, which would take too much room
LEFT = ("Curves", "Maps", "Sweep", "Modes", "Mics", "Race", "Plan")


class Panels:
    """Owns the main panel on the right, the panel on the left, their tabs, and the panel on the canvas.

    `top`: folder above everything else, for messages about the page as a whole; `run_bar`: folder between `top` and the
    tabs; `canvas`: tab of the panel on the canvas, which has the colour bar and the legend; `numbers`: counts the
    sessions.
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
        self._left, self._legend = panel, gui.add_panel()
        self.canvas = self._legend.add_tab("Legend")
        self._folded: bool | None = None
        self.fold(False)
        self._legend.expand()  # on a phone, where sections are folded at first

    def fold(self, folded: bool) -> None:
        """Fold both panels away and put the legend beside the scene, or unfold them and put it below the scene.

        Nothing moves where that is so already; a user may have moved panels since.
        """
        if folded == self._folded:
            return
        self._folded = folded
        if folded:
            self.gui.main_panel.minimize()
            self._left.minimize()
            self._legend.float(x=-LEGEND_EDGE, y=LEGEND_EDGE, width=LECTURE_WIDTH)
            return
        self.gui.main_panel.expand()
        self._left.expand()
        self._legend.float(x=LEGEND_EDGE, y=-LEGEND_EDGE, width=LEGEND_WIDTH)

    def tab(self, name: str) -> viser.GuiTabHandle:
        """Return a tab; used as a context, controls are added to it."""
        return self.tabs[name]


class SessionFolders:
    """Folders in the tabs that hold the controls of one session, and are removed together.

    `number`: of the session, counted from 0.
    """

    def __init__(self, panels: Panels):
        self._panels, self.gui, self.number = panels, panels.gui, next(panels.numbers)
        self._folders: list[viser.GuiFolderHandle] = []

    def tab(self, name: str) -> AbstractContextManager[viser.GuiFolderHandle]:
        """Return a context in which controls are added to a tab."""
        return self._added(self._panels.tab(name))

    def fold(self, folded: bool) -> None:
        """Fold the panels away, or unfold them."""
        self._panels.fold(folded)

    def canvas(self) -> AbstractContextManager[viser.GuiFolderHandle]:
        """Return a context in which controls are added to the panel on the canvas."""
        return self._added(self._panels.canvas)

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
