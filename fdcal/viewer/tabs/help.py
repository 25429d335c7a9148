"""Keyboard shortcuts, which do what buttons do, and the tab Help: keys, mouse, marks, and what the numbers mean.

Each shortcut is also in the browser's palette of commands, Ctrl+K. viser moves the camera with W, A, S, D, Q, E and the
arrows, so none of them is used here. A key does nothing while a text is typed.
"""

from functools import partial
from html import escape
from typing import Any

import viser

from ...graphics.marks import MARKS as DRAWN
from ...model.scene import MEASURED_AND_MODELLED
from ..html import CARD, Overlay, legend

KEYS = {  # by the name of the key: what it does, and the command of a control or of the page
    "R": ("Play or pause", "play"),
    "N": ("One step", "step=Step"),
    "G": ("One sweep", "step=Sweep"),
    "T": ("One stage", "step=Stage"),
    "X": ("Restart", "step=Restart"),
    "B": ("Previous state", "state=-1"),
    "F": ("Next state", "state=+1"),
    "M": ("Map of the next microphone", "microphone=+1"),
    "Shift+M": ("Map of the previous microphone", "microphone=-1"),
    "O": ("One more mode in the map", "modes=+1"),
    "I": ("One mode less in the map", "modes=-1"),
    "P": ("Add modes one by one, or stop", "sweep"),
    "U": ("Map of the modes in use", "map_modes=solver"),
    "V": ("Flat map, relief, mode shape, isosurfaces, no map", "kind=+1"),
    "L": ("Logarithmic or linear scale", "scale=+1"),
    "Y": ("Trails", "trails"),
    "K": ("Dark or light page", "dark_page"),
    "H": ("Lecture mode: large type, panels folded away", "lecture"),
    "1": ("Plan view", "look=Top"),
    "2": ("Whole room", "look=Room"),
    "3": ("3-D view of the array", "look=3-D"),
    "J": ("Next step of the lesson", "next"),
    "Shift+J": ("Previous step of the lesson", "back"),
}


def add_keys(gui: viser.GuiApi, overlay: Overlay) -> None:
    """Add the shortcuts to every browser that opens the page."""

    async def act(command: str, event) -> None:
        if event.client is not None:
            overlay.receive(event.client, f"key {command}")

    for name, (label, command) in KEYS.items():
        shift, _, key = name.rpartition("+")
        hotkey: Any = key
        added = gui.add_command(label, hotkey=hotkey, modifier="shift" if shift else None)
        added.on_trigger(partial(act, command))


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
        "Keys": {name: escape(label) for name, (label, _) in KEYS.items()},
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
