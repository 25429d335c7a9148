"""The run bar above the tabs: status, Run or Pause, single steps, sliders over the history and of the speed."""

from __future__ import annotations

from collections.abc import Callable

import viser

from ..session.calibrate import Assessment
from ..session.history import SessionView
from .gui import html
from .gui.binding import Binding
from .gui.choices import MAX_RATE
from .gui.verdict_html import verdict_html
from .server.client_values import bounded

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
