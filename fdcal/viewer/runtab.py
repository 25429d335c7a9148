"""What drives the solver: status, Run or Pause, steps, time, modes in use."""

from __future__ import annotations

import viser

from ..history import SessionView
from . import words
from .desk import Desk
from .safety import bounded

LARGEST_SEED = 2**31 - 1
STEPS = ("Step", "Sweep", "Stage", "Reset")
FASTEST = 60  # steps a second at the end of the slider, which stands for as many as there may be


class RunBar:
    """Status and the buttons above the tabs."""

    def __init__(self, desk: Desk):
        self._desk, gui = desk, desk.gui
        self.status = gui.add_html("")
        self.run = gui.add_button("Run", icon=viser.Icon.PLAYER_PLAY, hint="Step on and on; Pause stops it")
        self.steps = gui.add_button_group(
            "Solver", STEPS, hint="Step moves one microphone, Sweep each one once, Stage ends with a new mode"
        )
        self.time = gui.add_slider("State", 0, 1, 1, 0, disabled=True, hint="Rewind, look, and go on from there")
        desk.on(self.time, lambda value: desk.session.seek(bounded(value, 0, 10**9, 0)))
        desk.on(self.run, lambda _: self.toggle())
        desk.on(self.steps, self.press)

    def toggle(self) -> None:
        session = self._desk.session
        (session.pause if session.view.running else session.play)()

    def press(self, value) -> None:
        session = self._desk.session
        if value == "Reset":
            session.reset(self._desk.choices.seed)
        elif value in STEPS:
            {"Step": session.step, "Sweep": session.sweep, "Stage": session.stage}[value]()

    def show(self, view: SessionView, fault: str) -> None:
        """Called by the main loop. A solver that has finished takes no step: Reset alone stays."""
        desk, done = self._desk, view.state.finished and not view.running
        self.report(view, fault)
        desk.tell("count", max(view.count - 1, 1), self.time, "max")
        desk.tell("no past", view.count < 2, self.time, "disabled")
        desk.tell("index", view.index, self.time)
        desk.tell("run", "Pause" if view.running else "Run", self.run, "label")
        desk.tell("run done", bool(done), self.run, "disabled")
        desk.tell("steps", ("Reset",) if done else STEPS, self.steps, "options")
        if desk.shown.get("running") != view.running:
            desk.shown["running"] = view.running
            self.run.icon = viser.Icon.PLAYER_PAUSE if view.running else viser.Icon.PLAYER_PLAY

    def report(self, view: SessionView, fault: str = "") -> None:
        """Bring the status lines alone up to date; called by the main loop."""
        text = words.status(view, self._desk.measurement, self._desk.weights, fault)
        self._desk.tell("status", text, self.status, "content")


class SolveTab:
    """Modes in use, seed and speed."""

    def __init__(self, desk: Desk):
        self._desk, gui = desk, desk.gui
        state = desk.session.view.state
        with gui.add_folder("Modes in use"):
            self.first = gui.add_slider("First mode", 1, desk.modes, 1, state.first)
            self.last = gui.add_slider("Last mode", 1, desk.modes, 1, state.last)
            self.automatic = gui.add_checkbox(
                "Add modes automatically",
                state.automatic,
                hint="The next mode comes in when no microphone moves any more",
            )
        with gui.add_folder("Run"):
            self.speed = gui.add_slider(
                "Steps a second", 1, FASTEST, 1, FASTEST, hint=f"{FASTEST} is as fast as the machine can"
            )
            self.seed = gui.add_number(
                "Seed", desk.choices.seed, min=0, max=LARGEST_SEED, step=1, hint="Of the next Reset"
            )
        desk.on(self.first, lambda value: self.use_modes(first=value))
        desk.on(self.last, lambda value: self.use_modes(last=value))
        desk.on(self.automatic, lambda value: self.use_modes(automatic=bool(value)))
        desk.on(self.seed, lambda value: desk.choose(seed=bounded(value, 0, LARGEST_SEED, 0)))
        desk.on(self.speed, self.pace)

    def pace(self, value) -> None:
        rate = bounded(value, 1, FASTEST, FASTEST)
        self._desk.session.pace(0 if rate == FASTEST else rate)

    def use_modes(self, first=None, last=None, automatic=None) -> None:
        """What is not given stays; the end that was not moved gives way to the one that was."""
        desk = self._desk
        state = desk.session.view.state
        automatic = self.automatic.value if automatic is None else automatic
        low = bounded(self.first.value if first is None else first, 1, desk.modes, state.first)
        high = bounded(self.last.value if last is None else last, 1, desk.modes, state.last)
        if first is not None:
            high = max(low, high)
        low = min(low, high)
        desk.session.use_modes(low, high, bool(automatic))

    def show(self, view: SessionView) -> None:
        """Called by the main loop."""
        state, desk = view.state, self._desk
        desk.tell("first", state.first, self.first)
        desk.tell("last", state.last, self.last)
        desk.tell("automatic", state.automatic, self.automatic)
