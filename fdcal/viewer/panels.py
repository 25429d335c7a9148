"""The panels of one session: the run bar and the tabs on the right, the tabs on the left, the legend on the canvas."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import viser

from ..graphics.legend import legend_of
from ..graphics.primitives import Picture
from ..session.calibration_run import Assessment
from ..session.history import SessionView
from .background.comparison import ComparisonWorker, RunSummary
from .background.cost_map import CostMap
from .background.verdict import PositionUncertainty
from .gui import html
from .gui.binding import Binding
from .gui.choices import MAX_RATE
from .gui.html import verdict_html
from .gui.layout import SessionFolders
from .gui.legend_html import canvas_legend
from .scene3d.cameras import Cameras
from .server.client_values import bounded
from .tabs.comparison import ComparisonTab
from .tabs.curves import CurvesTab
from .tabs.cut import CutPanel
from .tabs.export import ExportTab
from .tabs.map import MapTab
from .tabs.maps import MapsTab
from .tabs.microphones import MicrophonesTab
from .tabs.modes import ModesTab
from .tabs.plan import PlanTab
from .tabs.scene import SceneTab
from .tabs.solver import SolverTab
from .tabs.sweep import SweepTab
from .tabs.view import ViewTab

STEPS = ("Step", "Sweep", "Stage", "Reset")
MAX_INDEX = 10**9  # of a state that a browser can ask for; the session clips it to its history


class RunBar:
    """Owns the controls of the run bar.

    `restart`: function that starts the solver again, with the settings of the tab Solver; `name`: of the bar, where
    there is more than one.
    """

    def __init__(self, binding: Binding, restart: Callable[[], None], name: str = "bar"):
        self._binding, self._restart, self._name, gui = binding, restart, name, binding.gui
        self.status, self.verdict = gui.add_html(""), gui.add_html("", visible=False)
        self.run = gui.add_button("Run", icon=viser.Icon.PLAYER_PLAY, hint="Run continuously until paused")
        self.steps = gui.add_button_group(
            "Solver", STEPS,
            hint="Step: move one microphone (joint, robust: all). Sweep: move each microphone once. Stage: continue"
            " until a mode is added or the objective changes. Reset: return to the start",
        )  # fmt: skip
        self.time = gui.add_slider(
            "State", 0, 1, 1, 0, disabled=True, hint="Rewind to an earlier state; the solver continues from there"
        )
        rate = binding.choices.steps_per_second(binding.run.solver.TRAITS.moves_all)
        self.speed = gui.add_slider(
            "Steps per second", 1, MAX_RATE, 1, rate, hint=f"Of Run; {MAX_RATE}: as fast as the machine can"
        )
        self.note = gui.add_html("", visible=False)  # below, so that no button moves away from the pointer
        binding.on(self.speed, self.limit_rate)
        binding.on(self.time, lambda value: binding.session.seek(bounded(value, 0, MAX_INDEX, 0)))
        binding.on(self.run, lambda _: self.toggle())
        binding.on(self.steps, self.press)

    def limit_rate(self, value) -> None:
        """Limit the solver to so many steps per second; MAX_RATE removes the limit."""
        rate = bounded(value, 1, MAX_RATE, MAX_RATE)
        self._binding.sent[f"{self._name}: rate"] = rate  # set by the user, who may still be dragging the slider
        self._binding.choose(rate=rate)
        self.apply_rate()

    def use_rate(self, rate: int) -> None:
        """Set the speed, steps per second; MAX_RATE for no limit."""
        self.limit_rate(rate)
        self.speed.value = rate

    def apply_rate(self) -> None:
        """Give the solver the speed of the slider."""
        rate = self._binding.choices.steps_per_second(self._binding.run.solver.TRAITS.moves_all)
        self._binding.session.pace(0 if rate == MAX_RATE else rate)

    def wait(self, waiting: bool) -> None:
        """Hide status and verdict while another session is prepared, whose progress stands above."""
        self._waiting = waiting
        self._binding.send("status shown", not waiting, self.status, "visible")

    def announce(self, text: str) -> None:
        """Show a line of HTML above the status; none for ""."""
        self._binding.send("announcement", text, self.note, "content")
        self._binding.send("announces", bool(text), self.note, "visible")

    def toggle(self) -> None:
        """Run the solver, or pause it."""
        session = self._binding.session
        (session.pause if session.view.running else session.play)()

    def press(self, label) -> None:
        """Act on a button of STEPS; ignore any other label."""
        session = self._binding.session
        if label == "Reset":
            self._restart()
        elif label in STEPS:
            {"Step": session.step, "Sweep": session.sweep, "Stage": session.stage}[label]()

    def show(self, view: SessionView, fault: str, note: str = "", found: Assessment | None = None, sought=None) -> None:
        """Bring the bar up to date; called by the main loop. A finished solver offers nothing but Reset.

        `view`, `fault`, `note`, `sought`: as of `show_status`; `found`: the verdict on the state, or None.
        """
        done = view.state.finished and not view.running
        self.show_status(view, fault, note, sought, found is not None and found.verdict == "good")
        self._send("verdict", verdict_html(found), self.verdict, "content")
        self._send("has verdict", found is not None, self.verdict, "visible")
        self._send("last index", max(view.count - 1, 1), self.time, "max")
        rate = self._binding.choices.steps_per_second(self._binding.run.solver.TRAITS.moves_all)
        self._send("rate", rate, self.speed)
        self._send("no history", view.count < 2, self.time, "disabled")
        self._send("index", view.index, self.time)
        self._send("run label", "Pause" if view.running else "Run", self.run, "label")
        self._send("run disabled", bool(done), self.run, "disabled")
        self._send("steps", ("Reset",) if done else STEPS, self.steps, "options")
        icon = viser.Icon.PLAYER_PAUSE if view.running else viser.Icon.PLAYER_PLAY
        self._send("run icon", icon, self.run, "icon")

    def _send(self, key: str, value, handle, name: str = "value") -> None:
        """`Binding.send` under a key of this bar."""
        self._binding.send(f"{self._name}: {key}", value, handle, name)

    def show_status(
        self, view: SessionView, fault: str = "", note: str = "", sought=None, trusted: bool = False
    ) -> None:
        """Bring the status lines up to date.

        `fault`: of the page; `note`: on work in the background; `sought` (K,) int64, microphones whose errors count;
        those of the run unless given; `trusted`: whether the verdict on the state is good.
        """
        sought = self._binding.run.sought if sought is None else sought
        text = html.status(view, self._binding.measurement, fault, note, sought, trusted)
        self._send("status", text, self.status, "content")


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
