"""The panel on the left: the tabs of one session that show results beside the scene."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..session.history import SessionView
from .background.comparison import ComparisonWorker, RunSummary
from .background.cost_maps import CostMap
from .background.uncertainty import PositionUncertainty
from .gui.binding import Binding
from .gui.layout import SessionFolders
from .tabs.comparison import ComparisonTab
from .tabs.curves import CurvesTab
from .tabs.cut import CutPanel
from .tabs.map import MapTab
from .tabs.maps import MapsTab
from .tabs.microphones import MicrophonesTab
from .tabs.modes import ModesTab
from .tabs.plan import PlanTab
from .tabs.sweep import SweepTab


class SidePanel:
    """Owns the tabs of the panel."""

    def __init__(
        self,
        folders: SessionFolders,
        binding: Binding,
        map_tab: MapTab,
        comparison: ComparisonWorker,
        call: Callable[[Callable[[], object]], object],
    ):
        with folders.tab("Curves"):
            self.curves = CurvesTab(binding.gui, binding.measurement, binding.run.sought)
        with folders.tab("Maps"):
            self.maps = MapsTab(binding)
        with folders.tab("Sweep"):
            self.sweep = SweepTab(binding, map_tab, call)
            self.cut = CutPanel(binding)
        with folders.tab("Modes"):
            self.modes = ModesTab(binding, map_tab)
        with folders.tab("Mics"):
            self.microphones = MicrophonesTab(binding)
        with folders.tab("Race"):
            self.comparison = ComparisonTab(binding, comparison)
        with folders.tab("Plan"):
            self.plan = PlanTab(binding)

    def show(
        self,
        view: SessionView,
        revision: int,
        drawn: CostMap | None,
        microphone: int,
        uncertainty: PositionUncertainty | None,
        runs: tuple[RunSummary, ...],
        now: float,
        sought: np.ndarray | None = None,
    ) -> None:
        """Bring the panel up to date; called by the main loop.

        `revision`: counts the states that were shown; `drawn`: CostMap on the floor, or None; `microphone`: whose map
        is shown, counted from 0; `uncertainty`: PositionUncertainty of the state, or None; `runs`: RunSummary of each
        run of the comparison; `now`: time, s; `sought`: numbers of the microphones whose errors count; those of the run
        unless given.
        """
        self.curves.show(view, now, sought)
        self.maps.show(drawn, now)
        self.sweep.show(view, revision, microphone, now)
        self.cut.show(view, revision, microphone, drawn, now)
        self.modes.show(view, now)
        self.microphones.show(view, microphone, uncertainty, now, slice(None) if sought is None else sought)
        self.comparison.show(runs, now)
        self.plan.show()
