"""The panels: their tabs, which stay as long as the server, and what one session has in them.

A tab that stays keeps its place in every browser: a user who looks at a tab while another scene is opened sees the
same tab afterwards. `Tabs` lists the tabs of a session: a new one is a line there, its name in LEFT or RIGHT, and a
module of `tabs`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import numpy as np
import viser

from ..graphics.legend import legend_of
from ..graphics.primitives import Picture
from .gui import html
from .gui.binding import Binding, Tab, Tick
from .gui.choices import MAX_RATE
from .gui.legend_html import canvas_legend
from .gui.overlay import Overlay
from .scene3d.cameras import Cameras
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
LEFT = ("Curves", "Maps", "Sweep", "Modes", "Mics", "Race", "Plan")  # those of a session are made by `Tabs`


class Panels:
    """Owns the main panel on the right, the panel on the left, their tabs, and the panel on the canvas.

    `top`: folder above everything else, for messages about the page as a whole; `run_bar`: folder between `top` and the
    tabs; `canvas`: tab of the panel on the canvas, which has the colour bar and the legend; `overlay`: regions on the
    canvas; `numbers`: counts the sessions; `folded`: whether they are folded away at first.
    """

    def __init__(self, gui: viser.GuiApi, folded: bool = False):
        self.gui, self.numbers, self.overlay = gui, itertools.count(), Overlay(gui)
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
        self.fold(folded)
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


STEPS = ("Step", "Sweep", "Stage", "Reset")


class RunBar:
    """Owns the controls above the tabs: status, verdict, Run or Pause, single steps, the history and the speed.

    `restart`: function that starts the solver again, with the settings of the tab Solver.
    """

    def __init__(self, binding: Binding, restart: Callable[[], None]):
        self._binding, self._restart, gui, on = binding, restart, binding.gui, binding.on
        self.status, self.verdict = gui.add_html(""), gui.add_html("", visible=False)
        self.run = on(
            gui.add_button("Run", icon=viser.Icon.PLAYER_PLAY, hint="Run continuously until paused"),
            lambda _: self.toggle(),
        )
        self.steps = on(
            gui.add_button_group(
                "Solver", STEPS,
                hint="Step: move one microphone (joint, robust: all). Sweep: move each microphone once. Stage: continue"
                " until a mode is added or the objective changes. Reset: return to the start",
            ),
            self.press,
        )  # fmt: skip
        self.time = on(
            gui.add_slider(
                "State", 0, 1, 1, 0, disabled=True, hint="Rewind to an earlier state; the solver continues from there"
            ),
            binding.session.seek,
        )
        self.speed = on(
            gui.add_slider(
                "Steps per second", 1, MAX_RATE, 1, self._rate,
                hint=f"Of Run; {MAX_RATE}: as fast as the machine can",
            ),
            self.limit_rate,
        )  # fmt: skip

    @property
    def _rate(self) -> int:
        """Steps per second of Run."""
        return self._binding.choices.steps_per_second(self._binding.run.solver.TRAITS.moves_all)

    def limit_rate(self, rate: int) -> None:
        """Limit the solver to so many steps per second; MAX_RATE removes the limit."""
        self._binding.keep(self.speed, rate)
        self._binding.choose(rate=rate)
        self.apply_rate()

    def use_rate(self, rate: int) -> None:
        """Set the speed, steps per second; MAX_RATE for no limit."""
        self.limit_rate(rate)
        self.speed.value = rate

    def apply_rate(self) -> None:
        """Give the solver the speed of the slider."""
        self._binding.session.pace(0 if self._rate == MAX_RATE else self._rate)

    def wait(self, waiting: bool) -> None:
        """Hide the status while another session is prepared, whose progress stands above."""
        self.status.visible = not waiting

    def toggle(self) -> None:
        """Run the solver, or pause it."""
        session = self._binding.session
        (session.pause if session.view.running else session.play)()

    def press(self, label: str) -> None:
        """Act on a button of STEPS."""
        session = self._binding.session
        {"Step": session.step, "Sweep": session.sweep, "Stage": session.stage, "Reset": self._restart}[label]()

    def show(self, tick: Tick) -> None:
        """Bring the bar up to date; called by the main loop. A finished solver offers nothing but Reset."""
        view, send = tick.view, self._binding.send
        done = view.state.finished and not view.running
        self.show_status(tick)
        self.verdict.content = html.verdict_html(tick.found, tick.assessing)
        self.verdict.visible = tick.found is not None or tick.assessing
        self.time.max, self.time.disabled = max(view.count - 1, 1), view.count < 2
        send(self.time, view.index)
        send(self.speed, self._rate)
        label = "Pause" if view.running else "Run"
        if self.run.label != label:
            self.run.label = label
            self.run.icon = viser.Icon.PLAYER_PAUSE if view.running else viser.Icon.PLAYER_PLAY
        self.run.disabled, self.steps.options = bool(done), ("Reset",) if done else STEPS

    def show_status(self, tick: Tick) -> None:
        """Bring the status lines up to date."""
        run, good = self._binding.run, tick.found is not None and tick.found.verdict == "good"
        sought = run.sought if tick.sought is None else tick.sought
        left_out = [run.measurement.names[n] for n in np.setdiff1d(run.sought, sought)]
        self.status.content = html.status(tick.view, run.measurement, tick.fault, tick.note, sought, good, left_out)


class Tabs:
    """The run bar and the tabs of one session, in the order in which they are made: a later one may use an earlier one.

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
        with folders.tab("Curves"):
            self.curves = CurvesTab(binding.gui, binding.measurement, binding.run.sought)
        with folders.tab("Maps"):
            self.maps = MapsTab(binding)
        with folders.tab("Sweep"):
            self.sweep = SweepTab(binding, self.map)
            self.cut = CutPanel(binding)
        with folders.tab("Modes"):
            self.modes = ModesTab(binding, self.map)
        with folders.tab("Mics"):
            self.microphones = MicrophonesTab(binding)
        with folders.tab("Race"):
            self.comparison = ComparisonTab(binding)
        with folders.tab("Plan"):
            self.plan = PlanTab(binding)

    def __iter__(self) -> Iterator[Tab]:
        return (tab for tab in vars(self).values() if isinstance(tab, Tab))

    def refresh(self) -> None:
        """Let everything follow the values of the controls, after a program has set them."""
        for tab in self:
            tab.refresh()
        self.run_bar.apply_rate()

    def show(self, tick: Tick) -> None:
        """Bring everything up to date; called by the main loop."""
        self.run_bar.show(tick)
        for tab in self:
            tab.show(tick)


class CanvasPanel:
    """Owns the controls on the canvas: colour bar and legend, and in lecture mode the run bar in large type.

    In lecture mode the other panels are folded away.

    `tabs`: which restart the solver and end lecture mode; `picture`: on the screen.
    """

    def __init__(self, folders: SessionFolders, binding: Binding, tabs: Tabs, picture: Picture):
        self._binding, self._folders, gui = binding, folders, binding.gui
        with folders.canvas():
            self._folder = gui.add_folder(None, visible=binding.choices.lecture)
            with self._folder:
                self.run_bar = RunBar(binding, tabs.solver.restart)
                icon = viser.Icon.LAYOUT_SIDEBAR_RIGHT_EXPAND
                self.leave = binding.on(
                    gui.add_button("Show panels", icon=icon, hint="End lecture mode; key H"),
                    lambda _: tabs.view.lecture_mode(False),
                )
            self.text = gui.add_html("")
        self._shown: tuple = ()
        self.show_picture(picture)

    def fold(self, cameras: Cameras) -> None:
        """Fold the other panels away where lecture mode has begun, and unfold them where it has ended."""
        cameras.legend_beside = self._binding.choices.lecture
        self._folders.fold(cameras.legend_beside)

    def show_picture(self, picture: Picture) -> None:
        """Bring the legend up to date: it names the marks that are drawn now."""
        content = picture.bar, legend_of(picture), self._binding.choices.lecture
        if content != self._shown:
            self._shown, self.text.content = content, canvas_legend(*content)

    def show(self, tick: Tick) -> None:
        """Bring the run bar up to date; called by the main loop."""
        self._folder.visible = self._binding.choices.lecture
        if self._folder.visible:
            self.run_bar.show(tick)
