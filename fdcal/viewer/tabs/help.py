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
    # a command of the controls, as "step=Sweep", or a function of the page and the client that pressed the key
    act: str | Callable
    modifier: KeyModifier | None = None  # "shift" or None

    @property
    def name(self) -> str:
        """The shortcut as it is written, for example "Shift+M"."""
        return f"{self.modifier.capitalize()}+{self.key}" if self.modifier else self.key


def _seek(shift: int, page, _) -> None:
    """Show another state of the history."""
    session = page.viewer.binding.session
    session.seek(session.view.index + shift)


def _next_microphone(shift: int, page, _) -> None:
    tabs = page.viewer.tabs
    tabs.map.pick((int(tabs.map.microphone.value) + shift) % tabs.binding.measurement.count)


def _more_modes(shift: int, page, _) -> None:
    """Show the map of one mode more, or one less."""
    sweep = page.viewer.tabs.sweep
    sweep.sum_modes(min(max(int(sweep.summed.value) + shift, 1), sweep.summed.max))


def _next_kind(page, _) -> None:
    tab = page.viewer.tabs.map
    tab.show_as(tab.kinds[(tab.kinds.index(page.viewer.binding.choices.kind) + 1) % len(tab.kinds)])


KEYS = (
    Key("R", "Play or pause", "play"),
    Key("N", "One step", "step=Step"),
    Key("G", "One sweep", "step=Sweep"),
    Key("T", "One stage", "step=Stage"),
    Key("X", "Restart", "step=Restart"),
    Key("B", "Previous state", partial(_seek, -1)),
    Key("F", "Next state", partial(_seek, 1)),
    Key("M", "Map of the next microphone", partial(_next_microphone, 1)),
    Key("M", "Map of the previous microphone", partial(_next_microphone, -1), "shift"),
    Key("O", "One more mode in the map", partial(_more_modes, 1)),
    Key("I", "One mode less in the map", partial(_more_modes, -1)),
    Key("P", "Add modes one by one, or stop", "sweep"),
    Key("U", "Map of the modes in use", lambda page, _: page.viewer.tabs.map.choose_modes(None)),
    Key("V", "Flat map, relief, mode shape, isosurfaces, no map", _next_kind),
    Key(
        "L",
        "Logarithmic or linear scale",
        lambda page, _: page.viewer.binding.choose(log=not page.viewer.binding.choices.log),
    ),
    Key("Y", "Trails", "trails"),
    Key("K", "Dark or light page", "dark_page"),
    Key("H", "Lecture mode: large type, panels folded away", "lecture"),
    Key("1", "Plan view", "look=Top"),
    Key("2", "Whole room", "look=Room"),
    Key("3", "3-D view of the array", "look=3-D"),
    Key("J", "Next step of the lesson", lambda page, _: page.lessons.go(NEXT)),
    Key("J", "Previous step of the lesson", lambda page, _: page.lessons.go(BACK), "shift"),
)


def add_keys(gui: viser.GuiApi, page) -> None:
    """Add the shortcuts, which act on the page, to every browser that opens it."""

    async def act(key: Key, event) -> None:
        if event.client is None or page.viewer is None:
            return
        if isinstance(key.act, str):
            page.carry_out(event.client, *key.act.partition("=")[::2])
        else:
            key.act(page, event.client)

    for key in KEYS:
        gui.add_command(key.label, hotkey=key.key, modifier=key.modifier).on_trigger(partial(act, key))


NUMBERS = {
    "Error (mm)": "distance from an estimated position to the true one, mean and largest over all microphones; of an"
    " array without known microphones after the best rotation, translation and reflection. Where the positions to"
    " compare with are nominal, those of a plan, it is called deviation",
    "Cost (dB)": "the part of the pressures that no sound field explains (Eq. 7 of the paper), over all modes of the"
    " measurement and relative to their power; it falls as the positions improve, with any method",
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
