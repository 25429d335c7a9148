"""Keyboard shortcuts, which do what buttons do. Each is also in the browser's palette of commands, Ctrl+K.

viser moves the camera with W, A, S, D, Q, E and the arrows, so none of them is used here. A key does nothing while a
text is typed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import viser
from viser._messages import HotkeyKey, KeyModifier

from .tabs.lessons import BACK, NEXT
from .tabs.map import LINEAR, LOG


@dataclass(frozen=True)
class Key:
    """A keyboard shortcut."""

    key: HotkeyKey  # as viser names it
    label: str  # what it does
    act: Callable  # function of the page and the client that pressed the key
    modifier: KeyModifier | None = None  # "shift" or None

    @property
    def name(self) -> str:
        """The shortcut as it is written, for example "Shift+M"."""
        return f"{self.modifier.capitalize()}+{self.key}" if self.modifier else self.key


def _with_panel(act: Callable) -> Callable:
    """Return a function that calls `act(main_panel)` if there is a session."""

    def do(page, client) -> None:
        if page.viewer is not None:
            act(page.viewer.main_panel)

    return do


def _press(name: str) -> Callable:
    return _with_panel(lambda panel: panel.run_bar.press(name))


def _seek(shift: int) -> Callable:
    """Show another state of the history."""
    return _with_panel(lambda panel: panel.binding.session.seek(panel.binding.session.view.index + shift))


def _next_microphone(shift: int) -> Callable:
    def do(panel) -> None:
        count = panel.binding.measurement.count
        panel.map.pick((int(panel.map.microphone.value) + shift) % count)

    return _with_panel(do)


def _more_modes(shift: int) -> Callable:
    """Show the map of the modes from the lowest to one more, or one less."""

    def do(panel) -> None:
        binding = panel.binding
        highest = (binding.choices.modes or (binding.session.view.state.last,))[-1]
        panel.map.choose_modes(range(1, min(max(highest + shift, 1), binding.modes) + 1))

    return _with_panel(do)


def _next_kind(panel) -> None:
    kinds = panel.map.kinds
    panel.map.show_as(kinds[(kinds.index(panel.map.kind.value) + 1) % len(kinds)])


def _with_sweep(act: Callable) -> Callable:
    """Return a function that calls `act(sweep_tab)` if there is a session."""

    def do(page, client) -> None:
        if page.viewer is not None:
            act(page.viewer.side_panel.sweep)

    return do


def _toggle_scale(panel) -> None:
    panel.map.scale_as(LINEAR if panel.binding.choices.style.log else LOG)


def _toggle_trails(panel) -> None:
    panel.view.draw(trails=not panel.binding.choices.trails)


def _toggle_dark(panel) -> None:
    panel.view.darken(not panel.binding.choices.style.dark)


def _toggle_lecture(panel) -> None:
    panel.view.lecture_mode(not panel.binding.choices.lecture)


def _place_camera(view: str) -> Callable:
    return lambda page, client: page.nodes.cameras.request(client, view)


KEYS = (
    Key("R", "Run or pause", _with_panel(lambda panel: panel.run_bar.toggle())),
    Key("N", "One step", _press("Step")),
    Key("G", "One sweep", _press("Sweep")),
    Key("T", "One stage", _press("Stage")),
    Key("X", "Reset", _press("Reset")),
    Key("B", "Previous state", _seek(-1)),
    Key("F", "Next state", _seek(1)),
    Key("M", "Map of the next microphone", _next_microphone(1)),
    Key("M", "Map of the previous microphone", _next_microphone(-1), "shift"),
    Key("O", "One more mode in the map", _more_modes(1)),
    Key("I", "One mode less in the map", _more_modes(-1)),
    Key("P", "Play or pause the sweep of modes", _with_sweep(lambda sweep: sweep.toggle())),
    Key("U", "Map of the modes in use", _with_panel(lambda panel: panel.map.choose_modes(None))),
    Key("V", "Flat map, relief, mode shape, basins, isosurfaces, no map", _with_panel(_next_kind)),
    Key("L", "Logarithmic or linear scale", _with_panel(_toggle_scale)),
    Key("Y", "Trails", _with_panel(_toggle_trails)),
    Key("K", "Dark or light page", _with_panel(_toggle_dark)),
    Key("H", "Lecture mode: large type, panels folded away", _with_panel(_toggle_lecture)),
    Key("1", "Plan view", _place_camera("top")),
    Key("2", "Whole room", _place_camera("3d")),
    Key("3", "Close view of the array", _place_camera("close")),
    Key("J", "Next step of the lesson", lambda page, client: page.lessons.go(NEXT)),
    Key("J", "Previous step of the lesson", lambda page, client: page.lessons.go(BACK), "shift"),
)


def add_keys(gui: viser.GuiApi, page, keys: tuple[Key, ...] = KEYS) -> None:
    """Add the shortcuts to every browser that opens the page.

    `page`: on which they act; `keys`: the shortcuts.
    """
    for key in keys:
        _add(gui, page, key)


def _add(gui: viser.GuiApi, page, key: Key) -> None:
    command = gui.add_command(key.label, hotkey=key.key, modifier=key.modifier)

    @command.on_trigger
    async def _(event) -> None:
        if event.client is not None:
            if page.viewer is not None:
                page.viewer.binding.touch()
            key.act(page, event.client)
