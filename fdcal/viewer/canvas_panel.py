"""The panel on the canvas: colour bar and legend, and in lecture mode the run bar in large type."""

from __future__ import annotations

import viser

from ..graphics.legend import legend_of
from ..graphics.primitives import Picture
from ..session.calibrate import Assessment
from ..session.history import SessionView
from .gui.binding import Binding
from .gui.layout import SessionFolders
from .gui.legend_html import canvas_legend
from .main_panel import MainPanel
from .run_bar import RunBar
from .scene3d.cameras import Cameras


class CanvasPanel:
    """Owns the controls of the panel.

    In lecture mode the other panels are folded away, and the panel has the run bar, too.

    `main_panel`: which restarts the solver and ends lecture mode; `picture`: on the screen.
    """

    def __init__(self, folders: SessionFolders, binding: Binding, main_panel: MainPanel, picture: Picture):
        self._binding, self._folders, gui = binding, folders, binding.gui
        with folders.canvas():
            self._folder = gui.add_folder(None, visible=binding.choices.lecture)
            with self._folder:
                self.run_bar = RunBar(binding, main_panel.solver.restart, "canvas")
                self.leave = gui.add_button(
                    "Show panels", icon=viser.Icon.LAYOUT_SIDEBAR_RIGHT_EXPAND, hint="End lecture mode; key H"
                )
            self.text = gui.add_html("")
        self._shown: tuple = ()
        self.show_picture(picture)
        binding.on(self.leave, lambda _: main_panel.view.lecture_mode(False))

    def fold(self, cameras: Cameras) -> None:
        """Fold the other panels away where lecture mode has begun, and unfold them where it has ended."""
        cameras.legend_beside = self._binding.choices.lecture
        self._folders.fold(cameras.legend_beside)

    def show_picture(self, picture: Picture) -> None:
        """Bring the legend up to date: it names the marks that are drawn now."""
        content = picture.bar, legend_of(picture), self._binding.choices.lecture
        if content != self._shown:
            self._shown, self.text.content = content, canvas_legend(*content)

    def show(self, view: SessionView, fault: str, note: str, found: Assessment | None, sought) -> None:
        """Bring the run bar up to date; called by the main loop. Parameters as of `RunBar.show`."""
        lecture = self._binding.choices.lecture
        self._binding.send("lecture", lecture, self._folder, "visible")
        if lecture:
            self.run_bar.show(view, fault, note, found, sought)
