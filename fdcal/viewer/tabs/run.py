"""What drives the solver: status, Run or Pause, steps, time."""

from __future__ import annotations

from collections.abc import Callable

import viser

from ...session.history import SessionView
from ..gui import html
from ..gui.binding import Binding
from ..server.client_values import bounded

STEPS = ("Step", "Sweep", "Stage", "Reset")
FASTEST = 60  # steps a second at the end of the slider, which stands for as many as there may be


class RunBar:
    """Status and the buttons above the tabs."""

    def __init__(self, binding: Binding, reset: Callable[[], None]):
        self._binding, self._reset, gui = binding, reset, binding.gui
        self.status = gui.add_html("")
        self.run = gui.add_button("Run", icon=viser.Icon.PLAYER_PLAY, hint="Step on and on; Pause stops it")
        self.steps = gui.add_button_group(
            "Solver", STEPS,
            hint="Step moves one microphone, with joint all of them; Sweep each one once; Stage ends with a new mode",
        )  # fmt: skip
        self.time = gui.add_slider("State", 0, 1, 1, 0, disabled=True, hint="Rewind, look, and go on from there")
        binding.on(self.time, lambda value: binding.session.seek(bounded(value, 0, 10**9, 0)))
        binding.on(self.run, lambda _: self.toggle())
        binding.on(self.steps, self.press)

    def toggle(self) -> None:
        session = self._binding.session
        (session.pause if session.view.running else session.play)()

    def press(self, value) -> None:
        session = self._binding.session
        if value == "Reset":
            self._reset()
        elif value in STEPS:
            {"Step": session.step, "Sweep": session.sweep, "Stage": session.stage}[value]()

    def show(self, view: SessionView, fault: str, note: str = "") -> None:
        """Called by the main loop. A solver that has finished takes no step: Reset alone stays."""
        binding, done = self._binding, view.state.finished and not view.running
        self.report(view, fault, note)
        binding.send("count", max(view.count - 1, 1), self.time, "max")
        binding.send("no past", view.count < 2, self.time, "disabled")
        binding.send("index", view.index, self.time)
        binding.send("run", "Pause" if view.running else "Run", self.run, "label")
        binding.send("run done", bool(done), self.run, "disabled")
        binding.send("steps", ("Reset",) if done else STEPS, self.steps, "options")
        if binding.sent.get("running") != view.running:
            binding.sent["running"] = view.running
            self.run.icon = viser.Icon.PLAYER_PAUSE if view.running else viser.Icon.PLAYER_PLAY

    def report(self, view: SessionView, fault: str = "", note: str = "") -> None:
        """Bring the status lines alone up to date; called by the main loop."""
        text = html.status(view, self._binding.measurement, self._binding.weights, fault, note)
        self._binding.send("status", text, self.status, "content")
