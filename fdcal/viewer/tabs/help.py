"""Keyboard shortcuts, which do what buttons do, and the tab Help: keys, mouse, marks, and what the numbers mean.

Each shortcut is also in the browser's palette of commands, Ctrl+K. viser moves the camera with W, A, S, D, Q, E and the
arrows, so none of them is used here. A key does nothing while a text is typed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from html import escape

import viser
from viser._messages import HotkeyKey, KeyModifier

from ...graphics.marks import MARKS as DRAWN
from ...model.room import MEASURED_AND_MODELLED
from ..html import CARD, legend
from .lessons import BACK, NEXT


@dataclass(frozen=True)
class Key:
    """A keyboard shortcut."""

    key: HotkeyKey  # as viser names it
    label: str  # what it does
    act: Callable  # function of the tabs of the session, or with `of_page` of the page and the client that pressed it
    modifier: KeyModifier | None = None  # "shift" or None
    command: str = ""  # of the button in Explore that does the same, or ""
    of_page: bool = False

    @property
    def name(self) -> str:
        """The shortcut as it is written, for example "Shift+M"."""
        return f"{self.modifier.capitalize()}+{self.key}" if self.modifier else self.key


def _seek(tabs, shift: int) -> None:
    """Show another state of the history."""
    tabs.binding.session.seek(tabs.binding.session.view.index + shift)


def _next_microphone(tabs, shift: int) -> None:
    tabs.map.pick((int(tabs.map.microphone.value) + shift) % tabs.binding.measurement.count)


def _more_modes(tabs, shift: int) -> None:
    """Show the map of the modes from the lowest to one more, or one less."""
    binding = tabs.binding
    highest = (binding.choices.modes or (binding.session.view.state.last,))[-1]
    tabs.map.choose_modes(range(1, min(max(highest + shift, 1), binding.modes) + 1))


def _next_kind(tabs) -> None:
    kinds = tabs.map.kinds
    tabs.map.show_as(kinds[(kinds.index(tabs.map.kind.value) + 1) % len(kinds)])


def _look(page, client: viser.ClientHandle, view: str) -> None:
    """Place the camera, and let the map rise or lie down."""
    if page.viewer is not None:
        page.viewer.tabs.look(client, view)


KEYS = (
    Key("R", "Run or pause", lambda tabs: tabs.run_bar.toggle()),
    Key("N", "One step", lambda tabs: tabs.run_bar.press("Step"), command="onestep"),
    Key("G", "One sweep", lambda tabs: tabs.run_bar.press("Sweep")),
    Key("T", "One stage", lambda tabs: tabs.run_bar.press("Stage")),
    Key("X", "Reset", lambda tabs: tabs.run_bar.press("Reset"), command="restart"),
    Key("B", "Previous state", lambda tabs: _seek(tabs, -1)),
    Key("F", "Next state", lambda tabs: _seek(tabs, 1)),
    Key("M", "Map of the next microphone", lambda tabs: _next_microphone(tabs, 1)),
    Key("M", "Map of the previous microphone", lambda tabs: _next_microphone(tabs, -1), "shift"),
    Key("O", "One more mode in the map", lambda tabs: _more_modes(tabs, 1)),
    Key("I", "One mode less in the map", lambda tabs: _more_modes(tabs, -1)),
    Key("P", "Play or pause the sweep of modes", lambda tabs: tabs.sweep.toggle(), command="sweep"),
    Key("U", "Map of the modes in use", lambda tabs: tabs.map.choose_modes(None)),
    Key("V", "Flat map, relief, mode shape, basins, isosurfaces, no map", _next_kind),
    Key(
        "L",
        "Logarithmic or linear scale",
        lambda tabs: tabs.binding.choose(log=not tabs.binding.choices.log),
    ),
    Key("Y", "Trails", lambda tabs: tabs.binding.choose(trails=not tabs.binding.choices.trails)),
    Key("K", "Dark or light page", lambda tabs: tabs.view.darken(not tabs.binding.choices.dark)),
    Key(
        "H",
        "Lecture mode: large type, panels folded away",
        lambda tabs: tabs.binding.choose(lecture=not tabs.binding.choices.lecture),
        command="lecture",
    ),
    Key("1", "Plan view", lambda page, client: _look(page, client, "top"), of_page=True),
    Key("2", "Whole room", lambda page, client: page.nodes.cameras.request(client, "3d"), of_page=True),
    Key("3", "3-D view of the array", lambda page, client: _look(page, client, "close"), of_page=True),
    Key("J", "Next step of the lesson", lambda page, client: page.lessons.go(NEXT), of_page=True),
    Key("J", "Previous step of the lesson", lambda page, client: page.lessons.go(BACK), "shift", of_page=True),
)


def add_keys(gui: viser.GuiApi, page) -> None:
    """Add the shortcuts, which act on the page, to every browser that opens it."""

    async def act(key: Key, event) -> None:
        if event.client is not None and key.of_page:
            key.act(page, event.client)
        elif event.client is not None and page.viewer is not None:
            key.act(page.viewer.tabs)

    for key in KEYS:
        gui.add_command(key.label, hotkey=key.key, modifier=key.modifier).on_trigger(partial(act, key))


NUMBERS = {
    "Error (mm)": "distance from an estimated position to the true one, mean and largest over all microphones; of an"
    " array without known microphones after the best rotation, translation and reflection. Where the positions to"
    " compare with are nominal, those of a plan, it is called deviation",
    "Cost (dB)": "the part of the pressures that no sound field explains (Eq. 7 of the paper), over all modes of the"
    " measurement and relative to their power; it falls as the positions improve, with any solver",
    "Step, sweep": "one move of the solver; each microphone moved once",
    "Mode (Hz)": "a peak of the room's power spectrum, numbered from 1 at the lowest frequency. Microphones are"
    " numbered from 0",
    "f_max (Hz)": "highest frequency at which the array can resolve a sound field (Eq. 9)",
    "Order L": "2 L + 1 functions describe the field of a mode (Eq. 3)",
    "&plusmn; &sigma; (mm)": "standard deviation of a position, once the solver has finished",
}
MOUSE = {
    "drag": "rotates the scene; with the right button it moves the scene; the wheel zooms",
    "click a microphone": "shows its map",
    "drag a microphone": "shows the cost there; let go, it rolls into the minimum below it",
    "Shift and drag": "moves its estimate to the pointer; the maps of all other microphones follow",
    "Ctrl+K": "lists all commands by name",
    "W A S D Q E, arrows": "move the camera",
}
MARKS = (
    "<b>Trails</b> are pink. <b>Errors</b> are grey lines from the estimate to the true position. <b>Ellipses</b>"
    " contain the true position with a probability of 95 %. The map is dark where the cost is low: in dark areas the"
    " prediction matches what was recorded. Marks differ in shape as well as colour."
)
MORE = "The documentation, docs/ of the project, and the command <code>fdcal</code>, which lists all commands."


def text() -> str:
    """Return the contents of the tab as HTML."""
    marks = f"{legend(mark for mark in DRAWN.values() if mark.text)}<div style='{CARD}'>{MARKS}</div>"
    sections: dict[str, str | dict[str, str]] = {
        "Keys": {key.name: escape(key.label) for key in KEYS},
        "Mouse": MOUSE,
        "Marks": marks,
        "Numbers": NUMBERS,
        "Measured rooms": f"<div style='{CARD}'>{MEASURED_AND_MODELLED}</div>",
        "More": f"<div style='{CARD}'>{MORE}</div>",
    }
    html = ""
    for title, content in sections.items():
        html += f"<div style='{CARD} font-weight: 600; margin-top: 0.4em'>{title}</div>"
        if isinstance(content, str):
            html += content
            continue
        cells = "".join(
            f"<tr><td style='white-space: nowrap; vertical-align: top; padding-right: 0.8em'><b>{name}</b></td>"
            f"<td>{description}</td></tr>"
            for name, description in content.items()
        )
        html += f"<div style='{CARD}'><table style='border-spacing: 0'>{cells}</table></div>"
    return html
