"""Keys that do what buttons do. Each is also found in the browser's palette of commands, Ctrl+K.

W, A, S, D, Q, E and the arrows move the camera; none of them is used here. A key does nothing while a text is typed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import viser

from .tabs.lessons import BACK, NEXT
from .tabs.map import KINDS, LINEAR, LOG

CAMERA = (*"WASDQE", "arrowup", "arrowdown", "arrowleft", "arrowright")  # viser's own


@dataclass(frozen=True)
class Key:
    """A key, what it is for, and what it does with the page and the client who pressed it."""

    key: str
    label: str
    act: Callable
    modifier: str | None = None

    @property
    def face(self) -> str:
        """As it is written: "Shift+M"."""
        return f"{self.modifier.capitalize()}+{self.key}" if self.modifier else self.key


def _with_controls(act: Callable) -> Callable:
    """Do `act(controls)` where there is a session."""

    def do(page, client) -> None:
        if page.viewer is not None:
            act(page.viewer.main_panel)

    return do


def _press(name: str) -> Callable:
    return _with_controls(lambda controls: controls.bar.press(name))


def _look_at(shift: int) -> Callable:
    """Another state of the history."""
    return _with_controls(lambda controls: controls.binding.session.seek(controls.binding.session.view.index + shift))


def _next_microphone(shift: int) -> Callable:
    def do(controls) -> None:
        count = controls.binding.measurement.count
        controls.map.pick((int(controls.map.microphone.value) + shift) % count)

    return _with_controls(do)


def _more_modes(shift: int) -> Callable:
    """The map of the modes from the lowest up to one more, or one less."""

    def do(controls) -> None:
        binding = controls.binding
        highest = (binding.choices.modes or (binding.session.view.state.last,))[-1]
        controls.map.choose_modes(range(1, min(max(highest + shift, 1), binding.modes) + 1))

    return _with_controls(do)


def _next_kind(controls) -> None:
    controls.map.show_as(KINDS[(KINDS.index(controls.map.kind.value) + 1) % len(KINDS)])


def _other_scale(controls) -> None:
    controls.map.scale_as(LINEAR if controls.binding.choices.look.log else LOG)


def _trail(controls) -> None:
    controls.draw(trails=not controls.binding.choices.trails)


def _toggle_dark(controls) -> None:
    controls.darken(not controls.binding.choices.look.dark)


def _seen(view: str) -> Callable:
    return lambda page, client: page.nodes.cameras.ask(client, view)


KEYS = (
    Key("R", "Run or pause", _with_controls(lambda controls: controls.bar.toggle())),
    Key("N", "One step", _press("Step")),
    Key("G", "One sweep", _press("Sweep")),
    Key("T", "One stage", _press("Stage")),
    Key("X", "Reset", _press("Reset")),
    Key("B", "One state back", _look_at(-1)),
    Key("F", "One state forward", _look_at(1)),
    Key("M", "Map of the next microphone", _next_microphone(1)),
    Key("M", "Map of the microphone before", _next_microphone(-1), "shift"),
    Key("O", "One mode more in the map", _more_modes(1)),
    Key("I", "One mode less in the map", _more_modes(-1)),
    Key("U", "Map of the modes in use", _with_controls(lambda controls: controls.map.choose_modes(None))),
    Key("V", "Flat map, relief, shape of a mode, no map", _with_controls(_next_kind)),
    Key("L", "Logarithmic or linear scale", _with_controls(_other_scale)),
    Key("Y", "Trails", _with_controls(_trail)),
    Key("K", "Dark or light page", _with_controls(_toggle_dark)),
    Key("1", "Seen from the top", _seen("top")),
    Key("2", "The whole room", _seen("3d")),
    Key("3", "The array, close", _seen("close")),
    Key("J", "Next step of the lesson", lambda page, client: page.lessons.go(NEXT)),
    Key("J", "Last step of the lesson", lambda page, client: page.lessons.go(BACK), "shift"),
)


def add_keys(gui: viser.GuiApi, page, keys=KEYS) -> None:
    """Have every page listen to the keys; each acts on the page as its button would."""
    for key in keys:
        _add(gui, page, key)


def _add(gui: viser.GuiApi, page, key: Key) -> None:
    command = gui.add_command(key.label, hotkey=key.key, modifier=key.modifier)

    @command.on_trigger
    async def _(event) -> None:
        if event.client is not None:
            key.act(page, event.client)
