"""The main panel on the right: the run bar above, the tabs of one session below."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import viser

from ..session.calibrate import Assessment
from ..session.history import SessionView
from .background.cost_maps import CostMap
from .gui.binding import Binding
from .gui.layout import SessionFolders
from .run_bar import RunBar
from .tabs.export import ExportTab
from .tabs.map import MapTab
from .tabs.scene import SceneTab
from .tabs.solver import SolverTab
from .tabs.view import ViewTab


class MainPanel:
    """Owns the run bar and the tabs of one session.

    `place`: function that moves the camera of one browser to a view; `export`: function that sends a kind of file to
    one browser.
    """

    def __init__(
        self,
        folders: SessionFolders,
        binding: Binding,
        place: Callable[[viser.ClientHandle, str], None],
        export: Callable[[viser.ClientHandle, str], None],
    ):
        self.binding = binding
        with folders.tab("Solver"):
            self.solver = SolverTab(binding)
        with folders.run_bar():
            self.run_bar = RunBar(binding, self.solver.restart)
        with folders.tab("Scene"):
            self.scene = SceneTab(binding)
        with folders.tab("Map"):
            self.map = MapTab(binding)
        with folders.tab("View"):
            self.view = ViewTab(binding, place)
        with folders.tab("Export"):
            self.export = ExportTab(binding, export)

    def refresh(self) -> None:
        """Let everything follow the values of the controls, after a program has set them."""
        for tab in (self.solver, self.scene, self.map, self.view, self.export):
            tab.refresh()
        self.run_bar.apply_rate()

    def show(
        self,
        view: SessionView,
        microphone: int,
        drawn: CostMap | None,
        reason: str,
        fault: str = "",
        note: str = "",
        found: Assessment | None = None,
        sought: np.ndarray | None = None,
    ) -> None:
        """Bring the panel up to date; called by the main loop.

        `microphone`: whose map is shown, counted from 0; `drawn`: CostMap on the floor, or None; `reason`: why there is
        no map, "" where it is only not ready; `fault`: an exception of the page, as text; `note`: on work in the
        background; `found`: Assessment of the state, or None; `sought`: numbers of the microphones whose errors count;
        those of the run unless given.
        """
        self.run_bar.show(view, fault, note, found, sought)
        self.solver.show(view)
        self.map.show(microphone, drawn, reason)
