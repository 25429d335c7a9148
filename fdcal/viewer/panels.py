"""The panels of the layout Expert: their tabs, which last as long as the server, and the controls of a session.

Since the tabs stay, a user who looks at a tab while another scene is opened sees the same tab afterwards. `Tabs` makes
the controls of a session: an instance of every class derived from `Tab` in the modules of `tabs`. From top to bottom,
the main panel has the progress of a session that is being prepared, `RunBar` and `SolverTab`, which run and configure
the solver, and its tabs.
"""

import pkgutil
from collections.abc import Callable
from dataclasses import replace
from html import escape
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import viser

from .. import solvers
from ..graphics.marks import MARKS, symbol_svg
from ..graphics.replay import filled
from ..model.address import Unit
from ..model.gauge import fixes_gauge
from ..model.scene import MEASURED_AND_MODELLED
from ..session.sources import OpenRequest
from . import html, tabs
from .html import Overlay
from .prepare import Preparation
from .state import RUN_BAR, Binding, PageState, Tab

RIGHT_WIDTH, LEFT_WIDTH = 340.0, 314.0  # pixels
# The tabs have no icons, for lack of space.
RIGHT, LEFT = ("Curves", "Scene", "View", "Help"), ("Map", "Mics")


class Panels:
    """Owns the main panel on the right, the panel on the left, and their tabs, which the layout Explore hides.

    `line`, `bar`, `button`: progress of the session that is being prepared, or why it was refused, and Cancel; `tabs`:
    the tabs of both panels by name, and under RUN_BAR the folder above the tabs; `overlay`: regions on the canvas;
    `wake`: makes the main loop update the page at once; `cancel`: cancels the session that is being prepared.
    """

    def __init__(
        self, gui: viser.GuiApi, wake: Callable[[], None] = lambda: None, cancel: Callable[[], None] = lambda: None
    ):
        self.gui, self.overlay = gui, Overlay(gui, wake)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(RIGHT_WIDTH)
        self.line, self.bar = gui.add_html("", visible=False), gui.add_progress_bar(0.0, visible=False)
        self.button = gui.add_button("Cancel", icon=viser.Icon.X, visible=False)
        self.tabs: dict[str, Any] = {RUN_BAR: gui.add_folder(None)}
        gui.add_divider()
        group, panel = gui.add_tab_group(), gui.add_panel()
        self.tabs |= {name: group.add_tab(name) for name in RIGHT}
        self.tabs |= {name: panel.add_tab(name) for name in LEFT}
        panel.dock_left()
        panel.set_width(LEFT_WIDTH)
        panel.expand()  # on a phone, where sections are folded at first
        with self.tabs["Help"]:
            gui.add_html(help_html())
        add_keys(gui, self.overlay)
        self.button.on_click(html.of_browsers(lambda event: cancel()))

    def show_progress(self, current: Preparation | None, error: Exception | None, first: bool) -> None:
        """Show the progress of a session being prepared, or the error of the last request; called by the main loop.

        `first`: whether no session has been shown yet, so that Cancel is impossible.
        """
        busy = self.bar.visible = current is not None
        if current is not None:
            title = escape(current.request.scene.title)
            self.line.content = f"<div style='{html.CARD}'><b>{title}</b><br>{escape(current.text)}</div>"
            self.bar.value = float(round(100 * current.progress))
        else:
            self.line.content = html.complaint(html.error_message(error))
        self.line.visible = busy or error is not None
        self.button.label, self.button.visible = "Cancel" if busy else "Close", self.line.visible and not first


# Shortcuts for commands of buttons. Each is also in the page's list of commands, Ctrl+K. viser moves the camera with
# W, A, S, D, Q, E and the arrows, so none of them is used here. A key does nothing while a text is typed.
KEYS = {  # for the name of each key: what the key does, and the command of a control or of the page
    "R": ("Play or pause", "play"),
    "N": ("One step", "step=Step"),
    "G": ("One sweep", "step=Sweep"),
    "T": ("One stage", "step=Stage"),
    "X": ("Restart", "step=Restart"),
    "B": ("Previous state", "state=-1"),
    "F": ("Next state", "state=+1"),
    "M": ("Map of the next microphone", "microphone=+1"),
    "Shift+M": ("Map of the previous microphone", "microphone=-1"),
    "O": ("One more frequency in the map", "modes=+1"),
    "I": ("One frequency fewer in the map", "modes=-1"),
    "P": ("Add frequencies one by one, or stop", "sweep"),
    "U": ("Map of the frequencies in use", "map_modes=solver"),
    "V": ("Next kind of map: flat, relief, mode shape, isosurfaces, none", "kind=+1"),
    "L": ("Logarithmic or linear scale", "scale=+1"),
    "Y": ("Trails", "trails"),
    "K": ("Dark or light page", "dark_page"),
    "H": ("Lecture mode: large type, no panels", "lecture"),
    "1": ("Plan view", "look=Top"),
    "2": ("Whole room", "look=Room"),
    "3": ("3-D view of the array", "look=3-D"),
    "J": ("Next step of the lesson", "next"),
    "Shift+J": ("Previous step of the lesson", "back"),
}


def add_keys(gui: viser.GuiApi, overlay: Overlay) -> None:
    """Add the shortcuts to every browser that opens the page."""
    for name, (label, command) in KEYS.items():
        shift, _, key = name.rpartition("+")
        hotkey: Any = key
        added = gui.add_command(label, hotkey=hotkey, modifier="shift" if shift else None)
        added.on_trigger(
            html.of_browsers(lambda event, command=command: overlay.receive(event.client, f"key {command}"))
        )


def help_html() -> str:
    """Return the contents of the tab Help: keys, mouse, marks, and what the numbers mean."""
    keys = "".join(f"<tr><th>{name}</th><td>{escape(label)}</td></tr>" for name, (label, _) in KEYS.items())
    marks = html.drawings_html({escape(mark.text): symbol_svg(mark) for mark in MARKS.values() if mark.text})
    parts = {"KEYS": keys, "MARKS": marks, "ROOMS": MEASURED_AND_MODELLED}
    return filled(Path(__file__).with_name("help.html").read_text(encoding="utf-8"), parts)


MAX_RATE = 60  # steps per second at the end of the slider, where it means no limit
# Steps per second at the beginning of a run, slow enough to follow it: for a method that moves all microphones, in a
# lesson and otherwise, and for a method that moves one microphone at a time.
LESSON_RATE, WATCHED_RATE, WATCHED_MOVES = 1, 5, 3
DOUBLING_TIME = 1.2  # s in which a run that is watched becomes twice as fast
MAX_DOUBLINGS = 12.0
QUICK_STEP = 0.004  # s; if a step takes n times this, the speed limit at the beginning is n times as high
UNITS: dict[str, Unit] = {"Step": "step", "Sweep": "sweep", "Stage": "stage"}
STEPS = (*UNITS, "Restart")


class RunBar(Tab):
    """Owns the controls above the tabs: status, verdict, Play or Pause, single steps, the history and the speed."""

    part, where, order = "run_bar", RUN_BAR, 0

    def __init__(self, binding: Binding):
        self._binding, gui = binding, binding.gui
        self._lesson = False  # whether a lesson is shown: each of its runs begins slowly
        self._since, self._paced = -1.0, float(self._rate)  # start of the run, s, or -1; its steps per second
        self.status, self.verdict = gui.add_html(""), gui.add_html("", visible=False)
        hint = "Run until paused; a run that has ended restarts"
        run = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY, hint=hint)
        self.run = binding.on(run, lambda _: self.toggle(), command="play")
        hint = (
            "Step: move one microphone (joint, robust: all). Sweep: move each microphone once. Stage: continue"
            " until a frequency is added or the objective changes. Restart: return to the start"
        )
        self.steps = binding.on(gui.add_button_group("Solve", STEPS, hint=hint), self.press, command="step")
        self.time = binding.slider(
            "State", 0, 1, 1, 0, binding.session.seek, disabled=True,
            hint="Rewind to an earlier state; the run continues from there", command="state",
        )  # fmt: skip
        self.speed = binding.slider(
            "Steps per second", 1, MAX_RATE, 1, self._rate, self.limit_rate,
            hint=f"Speed of Play; {MAX_RATE}: as fast as possible",
        )  # fmt: skip

    @property
    def _rate(self) -> int:
        """Steps per second at the beginning of a run, MAX_RATE for no limit."""
        watched = LESSON_RATE if self._lesson else WATCHED_RATE
        usual = watched if self._binding.run.solver.TRAITS.moves_all else WATCHED_MOVES
        return self._binding.choices.rate or usual

    def limit_rate(self, rate: int | None) -> None:
        """Limit the solver to `rate` steps per second; MAX_RATE removes the limit.

        With None, which lessons use, every run of a lesson begins slowly and becomes faster.
        """
        self._lesson = rate is None
        if rate is not None:
            self._binding.sent[id(self.speed)] = rate  # the user may still be dragging the slider
        self._binding.choose(rate=rate)
        self.refresh()

    def refresh(self) -> None:
        """Set the speed of the solver to that at the beginning of a run."""
        self._since = -1.0
        self._paced = 0 if self._rate == MAX_RATE else self._rate
        self._binding.session.pace(self._paced)

    def toggle(self) -> None:
        """Run the solver, from its start if it has finished, or pause it; the map shows the cost that it minimises."""
        session = self._binding.session
        if session.view.running:
            session.pause()
            return
        if session.view.state.finished:
            session.reset(self._binding.choices.seed)
        self._binding.tabs.follow_solver()
        session.play()

    def hurry(self) -> None:
        """Continue the run as fast as possible, whatever speed the user has chosen."""
        self.limit_rate(None)
        self._since = 0.0
        self._binding.session.play()

    def press(self, label: str) -> None:
        """Carry out a button of STEPS; the map then follows the microphone that is moved."""
        if label not in UNITS:
            self._binding.tabs.solver.restart()
            return
        self._binding.tabs.follow_solver()
        self._binding.choose(follow=not self._binding.run.solver.TRAITS.moves_all)
        self._binding.session.step(1, UNITS[label])

    def show(self, tick: PageState) -> None:
        """Bring the bar up to date; called by the main loop. A finished solver takes no single step."""
        view, send = tick.view, self._binding.send
        done = view.state.finished and not view.running
        self.show_status(tick)
        self.verdict.content = html.verdict_html(tick.found, tick.assessing)
        self.verdict.visible = tick.found is not None or tick.assessing
        self.time.max, self.time.disabled = max(view.count - 1, 1), view.count < 2
        send(self.time, view.index)
        if view.running and self._binding.choices.rate is None:
            # Unless a user has chosen the speed, a run becomes faster, so that a long one ends soon.
            self._since = tick.now if self._since < 0 else self._since
            slow = 1.0 if self._lesson else max(self._binding.session.step_time / QUICK_STEP, 1.0)
            rate = slow * self._rate * 2 ** min((tick.now - self._since) / DOUBLING_TIME, MAX_DOUBLINGS)
            if rate > 1.2 * self._paced:
                self._paced = rate
                self._binding.session.pace(rate)
        elif self._since >= 0:
            self.refresh()
        send(self.speed, self._rate if self._since < 0 else min(round(self._paced), MAX_RATE))
        playing = "Pause", viser.Icon.PLAYER_PAUSE
        self.run.label, self.run.icon = playing if view.running else ("Play", viser.Icon.PLAYER_PLAY)
        self.steps.options = STEPS[-1:] if done else STEPS

    def show_status(self, tick: PageState) -> None:
        """Bring the status lines up to date."""
        run = self._binding.run
        sought = run.sought if tick.sought is None else tick.sought
        left_out = [run.measurement.names[n] for n in np.setdiff1d(run.sought, sought)]
        self.status.content = html.status(tick.view, run.measurement, tick.fault, sought, tick.found, left_out)


MAX_SEED = 2**31 - 1
STARTS = ("affine", "random")
KEPT_BY_METHOD = ("microphone", "follow", "kind", "descending")  # choices that a change of the method keeps


class SolverTab(Tab):
    """Owns the controls, and restarts the solver with them."""

    part, where, order = "solver", RUN_BAR, 1

    def __init__(self, binding: Binding):
        self._binding, state, settings = binding, binding.session.view.state, binding.run.scene.solver
        modes, problem = binding.modes, binding.run.problem
        same_dimension = problem.array_dimension == problem.dimension
        searchable = same_dimension and problem.search is not None and fixes_gauge(problem.known_positions)
        traits = {name: solvers.load(name).TRAITS for name in solvers.names()}
        # the methods that can solve the problem
        names = tuple(name for name, one in traits.items() if searchable or not one.needs_search)
        # the start of each method, unless another one is given
        self._starts = {name: one.starts[0] if one.starts else STARTS[0] for name, one in traits.items()}
        with binding.gui.add_folder("Settings", expand_by_default=False):
            self.first = binding.slider(
                "First freq.", 1, modes, 1, state.first,
                lambda value: self.use_modes(value, max(value, self.last.value)),
                hint="Number of the lowest frequency that the solver uses",
            )  # fmt: skip
            self.last = binding.slider(
                "Last freq.", 1, modes, 1, state.last,
                lambda value: self.use_modes(min(self.first.value, value), value),
                hint="Number of the highest frequency that the solver uses",
            )  # fmt: skip
            self.automatic = binding.checkbox(
                "Add freq.", state.automatic,
                lambda value: self.use_modes(self.first.value, self.last.value, value),
                visible=binding.run.solver.TRAITS.adds_modes,
                hint="Add the next frequency when the present stage has converged",
            )  # fmt: skip
            self.refusal, self._refused = binding.gui.add_html(""), None
            self.name = binding.dropdown(
                "Method", names, settings.name, self._choose_method, disabled=len(names) == 1, command="method",
                hint="robust: all microphones at once, with their gains; joint: for matched channels; descent: one at a"
                " time",
            )  # fmt: skip
            self.start = binding.dropdown(
                "Start", STARTS, settings.start or self._starts[settings.name], lambda _: self.refresh(),
                hint="affine: closed-form estimate from the lowest frequencies; random: anywhere in the search domain",
            )  # fmt: skip
            hint = "Seed of the random start, and of the order in which descent moves the microphones"
            seed = binding.gui.add_number("Seed", binding.choices.seed, min=0, max=MAX_SEED, step=1, hint=hint)
            self.seed = binding.on(seed, lambda value: binding.choose(seed=value))
            binding.gui.add_html(html.remark("Start and seed take effect with Restart, the others at once."))
        self.refresh()

    def _choose_method(self, name: str) -> None:
        self.start.value = self._starts[name]
        self.refresh()
        if name != self._binding.run.scene.solver.name:
            self.restart()

    def refresh(self) -> None:
        """Hide the controls that have no effect on the chosen solver."""
        traits = solvers.load(self.name.value).TRAITS
        self.start.visible = bool(traits.starts)
        self.seed.visible = traits.draws_order or ("random" in traits.starts and self.start.value == "random")

    def restart(self) -> None:
        """Restart with the settings: the same solver at once, another one as soon as it is ready."""
        binding, own = self._binding, self._binding.run.scene.solver
        name, start = self.name.value, self.start.value
        if (name, start) == (own.name, own.start or self._starts[own.name]):
            binding.session.reset(binding.choices.seed)
            return
        scene = replace(binding.run.scene, solver=replace(own, name=name, start=start))
        more = {"choices": {key: getattr(binding.choices, key) for key in KEPT_BY_METHOD}, "fewer_modes": True}
        binding.open(OpenRequest(scene, binding.choices.seed, binding.measurement, **more))

    def use_modes(self, first: int, last: int, automatic: bool | None = None) -> None:
        """Set the modes in use and whether the solver adds more; `automatic` None: as the check box says."""
        automatic = bool(self.automatic.value) if automatic is None else automatic
        self._binding.session.use_modes(min(first, last), last, automatic)

    def show(self, tick: PageState) -> None:
        """Let the controls follow the solver."""
        state, send, refused = tick.view.state, self._binding.send, tick.view.refused
        if refused is not self._refused:
            self._refused, self.refusal.content = refused, html.complaint(refused or "")
            for handle in (self.first, self.last, self.automatic) if refused else ():
                self._binding.sent.pop(id(handle), None)  # back to what the solver uses
        send(self.first, state.first)
        send(self.last, state.last)
        send(self.automatic, state.automatic)


class Tabs:
    """The run bar and the tabs of one session, of this module and those in `tabs`.

    Each is an attribute. The list `parts` has them in the order in which they are made, because a later one may use an
    earlier one. `place`: function that moves the camera of one browser to a view.
    """

    run_bar: RunBar
    solver: SolverTab
    # of the modules in `tabs`
    curves: Any
    export: Any
    map: Any
    microphones: Any
    scene: Any
    spectrum: Any
    sweep: Any
    view: Any

    def __init__(self, panels: Panels, binding: Binding, place: Callable[[viser.ClientHandle, str], None]):
        self.binding, self._place = binding, place
        self._raised = ""  # the kind of map that `look` has chosen
        self.parts, binding.tabs = list[Tab](), self
        modules = [import_module(f"{tabs.__name__}.{module.name}") for module in pkgutil.iter_modules(tabs.__path__)]
        kinds = {kind for module in modules for kind in vars(module).values() if isinstance(kind, type)}
        classes: list[Any] = [kind for kind in {RunBar, SolverTab, *kinds} if issubclass(kind, Tab) and kind.where]
        for kind in sorted(classes, key=lambda kind: (kind.where != RUN_BAR, kind.order, kind.__name__)):
            with panels.tabs[kind.where]:
                binding.folders.append(folder := panels.gui.add_folder(None))  # a folder without a label is not visible
                with folder:
                    self.parts.append(kind(binding))
                    setattr(self, kind.part, self.parts[-1])

    def look(self, client: viser.ClientHandle, view: str) -> None:
        """Place the camera of one browser; a flat map becomes a relief, or isosurfaces, in the view from the side."""
        kind = self.binding.choices.kind
        if view == "close" and kind == "flat":
            self._raised = "volume" if "volume" in self.map.kinds else "relief"
            self.map.show_as(self._raised)
        elif view == "top":
            if kind == self._raised:  # otherwise a user has chosen another kind since
                self.map.show_as("flat")
            self._raised = ""
        self._place(client, view)

    def follow_solver(self) -> None:
        """Show the map of the cost that the next step minimises, because a run would look wrong on another map.

        A method that moves a microphone to the lowest place of its map uses the modes of the map, if these are
        consecutive.
        """
        binding, modes = self.binding, self.binding.choices.modes
        self.sweep.playing = None
        binding.choose(objective=True)
        if modes is None:
            return
        if modes == tuple(range(modes[0], modes[-1] + 1)) and not binding.run.solver.TRAITS.moves_all:
            self.solver.use_modes(modes[0], modes[-1])
        self.map.choose_modes(None)

    def show(self, tick: PageState) -> None:
        """Bring everything up to date; called by the main loop."""
        self.binding.state = tick
        for tab in self.parts:
            tab.update(tick)
