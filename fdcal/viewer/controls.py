"""Buttons and sliders. A callback bounds its value, then gives the session a command or changes a choice.

Callbacks are `async`: viser runs those in order, on its own loop. None of them waits for anything.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import viser

from ..history import SessionView
from ..measurement import Measurement
from ..session import Session
from . import words
from .safety import bounded, one_of

SUM, SINGLE = "Sum of the modes in use", "One mode"
LINEAR, LOG = "Linear", "Logarithmic"
TOP, BIRD = "Top", "3-D"
SIZES = {"1280 x 800": (1280, 800), "1920 x 1080": (1920, 1080), "3840 x 2160": (3840, 2160)}
LARGEST_SEED = 2**31 - 1


@dataclass(frozen=True)
class Choices:
    """What the page's controls say, apart from what is the session's."""

    microphone: int  # whose map is shown
    follow: bool = True  # after a step, show the microphone that it moved
    shown: bool = True
    single: bool = False  # the map of one mode instead of the sum
    mode: int = 1  # that one mode
    log: bool = True
    dark: bool = False
    export_view: str = "top"
    export_size: tuple[int, int] = (1280, 800)
    seed: int = 0


class Controls:
    """Owns the handles of the main panel.

    `choices` is replaced whole by the callbacks, which run one after another, and read by the main loop.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        session: Session,
        measurement: Measurement,
        modes: int,
        weights: str,
        place: Callable[[viser.ClientHandle, str], None],
        export: Callable[[viser.ClientHandle, Choices], None],
    ):
        self._gui, self._session, self._measurement, self._modes = gui, session, measurement, modes
        self._weights = weights
        free = [n for n in range(measurement.count) if n not in measurement.known]
        self.choices = Choices(microphone=free[0] if free else 0, seed=session.view.state.seed)
        self._shown: dict[str, object] = {}  # what the handles were last told by `show`, whose own it is
        self._status = gui.add_html("")
        self._add_run()
        self._add_modes()
        self._add_map()
        self._add_view(place)
        self._add_export(export)

    def _add_run(self) -> None:
        self._run = self._gui.add_button("Run", icon=viser.Icon.PLAYER_PLAY, hint="Step on and on; Pause stops it")
        self._on(self._run, self._toggle)
        group = self._gui.add_button_group(
            "Solver",
            ("Step", "Sweep", "Reset"),
            hint="Step moves one microphone, Sweep each one once, Reset starts anew",
        )
        self._on(group, self._press)
        seed = self._gui.add_number(
            "Seed", self.choices.seed, min=0, max=LARGEST_SEED, step=1, hint="Of the next Reset"
        )
        self._on(seed, lambda value: self._choose(seed=bounded(value, 0, LARGEST_SEED, 0)))

    def _add_modes(self) -> None:
        with self._gui.add_folder("Modes in use"):
            state = self._session.view.state
            self._first = self._gui.add_slider("First mode", 1, self._modes, 1, state.first)
            self._last = self._gui.add_slider("Last mode", 1, self._modes, 1, state.last)
            self._automatic = self._gui.add_checkbox(
                "Add modes automatically",
                state.automatic,
                hint="The next mode comes in when no microphone moves any more",
            )
        self._on(self._first, lambda value: self._use_modes(first=value))
        self._on(self._last, lambda value: self._use_modes(last=value))
        self._on(self._automatic, lambda value: self._use_modes(automatic=bool(value)))

    def _add_map(self) -> None:
        with self._gui.add_folder("Cost map"):
            highest = self._measurement.count - 1
            self._microphone = self._gui.add_slider("Microphone", 0, highest, 1, self.choices.microphone)
            self._follow = self._gui.add_checkbox(
                "Follow solver", True, hint="Show the microphone that a step has moved"
            )
            kind = self._gui.add_dropdown("Map", (SUM, SINGLE, "None"), initial_value=SUM)
            self._mode = self._gui.add_slider("Mode shown", 1, self._modes, 1, 1, visible=False)
            scale = self._gui.add_dropdown("Scale", (LINEAR, LOG), initial_value=LOG)
            self._bar = self._gui.add_html(words.colour_bar(None))
        self._on(self._microphone, self._choose_microphone)
        self._on(self._follow, lambda value: self._choose(follow=bool(value), microphone=self._looked_at))
        self._on(kind, self._choose_map)
        self._on(self._mode, lambda value: self._choose(mode=bounded(value, 1, self._modes, 1)))
        self._on(scale, lambda value: self._choose(log=value == LOG))

    def _add_view(self, place) -> None:
        with self._gui.add_folder("View"):
            group = self._gui.add_button_group("Camera", (TOP, BIRD), hint="Of this page alone")
            dark = self._gui.add_checkbox("Dark page", False)

        @group.on_click
        async def _(event) -> None:
            if event.client is not None:
                place(event.client, "3d" if event.target.value == BIRD else "top")

        self._on(dark, self._darken)

    def _add_export(self, export) -> None:
        with self._gui.add_folder("Export", expand_by_default=False):
            view = self._gui.add_dropdown("Seen from", (TOP, BIRD), initial_value=TOP)
            size = self._gui.add_dropdown("Size (pixels)", tuple(SIZES), initial_value="1280 x 800")
            button = self._gui.add_button("Save PNG", icon=viser.Icon.PHOTO, hint="Drawn anew off-screen, in about 5 s")
        self._on(view, lambda value: self._choose(export_view="3d" if value == BIRD else "top"))
        self._on(size, lambda value: self._choose(export_size=SIZES[one_of(value, SIZES, "1280 x 800")]))

        @button.on_click
        async def _(event) -> None:
            if event.client is not None:
                export(event.client, self.choices)

    def _on(self, handle, act: Callable) -> None:
        """Call `act(value)` when a client, and not this program, has changed a handle."""

        async def hear(event) -> None:
            if event.client is not None:
                act(event.target.value)

        (handle.on_click if hasattr(handle, "on_click") else handle.on_update)(hear)

    def _choose(self, **changes) -> None:
        self.choices = replace(self.choices, **changes)

    @property
    def _looked_at(self) -> int:
        """The microphone that the page shows."""
        return bounded(self._microphone.value, 0, self._measurement.count - 1, self.choices.microphone)

    def _choose_microphone(self, value) -> None:
        """A microphone chosen by hand is stayed with."""
        number = bounded(value, 0, self._measurement.count - 1, self.choices.microphone)
        self._choose(microphone=number, follow=False)
        self._follow.value = False

    def _choose_map(self, value) -> None:
        self._choose(single=value == SINGLE, shown=value in (SUM, SINGLE))
        self._mode.visible = value == SINGLE

    def _darken(self, value) -> None:
        self._choose(dark=bool(value))
        self._gui.configure_theme(dark_mode=bool(value), show_share_button=False, show_logo=False)

    def _toggle(self, _) -> None:
        (self._session.pause if self._session.view.running else self._session.play)()

    def _press(self, value) -> None:
        if value == "Reset":
            self._session.reset(self.choices.seed)
        elif value in ("Step", "Sweep"):
            {"Step": self._session.step, "Sweep": self._session.sweep}[value]()

    def _use_modes(self, first=None, last=None, automatic=None) -> None:
        """What is not given stays; the end that was not moved gives way to the one that was."""
        state = self._session.view.state
        automatic = self._automatic.value if automatic is None else automatic
        low = bounded(self._first.value if first is None else first, 1, self._modes, state.first)
        high = bounded(self._last.value if last is None else last, 1, self._modes, state.last)
        if first is not None:
            high = max(low, high)
        low = min(low, high)
        self._session.use_modes(low, high, bool(automatic))

    def show(self, view: SessionView, microphone: int, bar: str, fault: str = "") -> None:
        """Bring the panel up to date; called by the main loop."""
        state = view.state
        self.report(view, fault)
        self._tell("run", "Pause" if view.running else "Run", self._run, "label")
        self._tell("first", state.first, self._first, "value")
        self._tell("last", state.last, self._last, "value")
        self._tell("automatic", state.automatic, self._automatic, "value")
        if not self.choices.follow and self.choices.microphone == microphone:
            self._shown["microphone"] = microphone  # set by a hand, which may hold it still
        self._tell("microphone", microphone, self._microphone, "value")
        self._tell("bar", bar, self._bar, "content")
        if self._shown.get("running") != view.running:
            self._shown["running"] = view.running
            self._run.icon = viser.Icon.PLAYER_PAUSE if view.running else viser.Icon.PLAYER_PLAY

    def report(self, view: SessionView, fault: str = "") -> None:
        """Bring the status lines alone up to date; called by the main loop."""
        text = words.status(view, self._measurement, self._weights, fault)
        self._tell("status", text, self._status, "content")

    def _tell(self, key: str, value, handle, name: str) -> None:
        """Send a value when it differs from the last one sent: a slider that a hand holds is not pulled back."""
        if key not in self._shown or self._shown[key] != value:
            self._shown[key] = value
            setattr(handle, name, value)
