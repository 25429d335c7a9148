"""The run bar above the tabs: status, Run or Pause, single steps, and a slider over the history."""

from __future__ import annotations

from collections.abc import Callable

import viser

from ..session.assess import Assessment
from ..session.history import SessionView
from .gui import html
from .gui.binding import Binding
from .gui.verdict_html import verdict_html
from .server.client_values import bounded

STEPS = ("Step", "Sweep", "Stage", "Reset")
MAX_INDEX = 10**9  # of a state that a browser can ask for; the session clips it to its history


class RunBar:
    """Owns the controls of the run bar.

    Parameters
    ----------
    binding : Binding
    restart : function that starts the solver again, with the settings of the tab Solver
    """

    def __init__(self, binding: Binding, restart: Callable[[], None]):
        self._binding, self._restart, gui = binding, restart, binding.gui
        self.status, self.verdict = gui.add_html(""), gui.add_html("", visible=False)
        self.run = gui.add_button("Run", icon=viser.Icon.PLAYER_PLAY, hint="Run continuously until paused")
        self.steps = gui.add_button_group(
            "Solver", STEPS,
            hint="Step: move one microphone (joint: all of them). Sweep: move each microphone once. Stage: continue"
            " until a mode is added or the objective changes. Reset: return to the start",
        )  # fmt: skip
        self.time = gui.add_slider(
            "State", 0, 1, 1, 0, disabled=True, hint="Rewind to an earlier state; the solver continues from there"
        )
        binding.on(self.time, lambda value: binding.session.seek(bounded(value, 0, MAX_INDEX, 0)))
        binding.on(self.run, lambda _: self.toggle())
        binding.on(self.steps, self.press)

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

        Parameters
        ----------
        view, fault, note, sought : as of `show_status`
        found : the verdict on the state, or None
        """
        binding, done = self._binding, view.state.finished and not view.running
        self.show_status(view, fault, note, sought)
        binding.send("verdict", verdict_html(found), self.verdict, "content")
        binding.send("has verdict", found is not None, self.verdict, "visible")
        binding.send("last index", max(view.count - 1, 1), self.time, "max")
        binding.send("no history", view.count < 2, self.time, "disabled")
        binding.send("index", view.index, self.time)
        binding.send("run label", "Pause" if view.running else "Run", self.run, "label")
        binding.send("run disabled", bool(done), self.run, "disabled")
        binding.send("steps", ("Reset",) if done else STEPS, self.steps, "options")
        icon = viser.Icon.PLAYER_PAUSE if view.running else viser.Icon.PLAYER_PLAY
        binding.send("run icon", icon, self.run, "icon")

    def show_status(self, view: SessionView, fault: str = "", note: str = "", sought=None) -> None:
        """Bring the status lines up to date.

        Parameters
        ----------
        view : SessionView
        fault : of the page
        note : on work in the background
        sought : (K,) int64, microphones whose errors count; those of the run unless given
        """
        sought = self._binding.run.sought if sought is None else sought
        text = html.status(view, self._binding.measurement, fault, note, sought)
        self._binding.send("status", text, self.status, "content")
