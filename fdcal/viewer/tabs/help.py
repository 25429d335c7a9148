"""Keyboard shortcuts, which do what buttons do, and the tab Help: keys, mouse, marks, and what the numbers mean.

Each shortcut is also in the browser's palette of commands, Ctrl+K. viser moves the camera with W, A, S, D, Q, E and the
arrows, so none of them is used here. A key does nothing while a text is typed.
"""

from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import viser

from ...graphics.marks import MARKS
from ...graphics.replay import filled
from ...model.scene import MEASURED_AND_MODELLED
from ..html import Overlay, legend

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


HELP = Path(__file__).with_name("help.html")


def text() -> str:
    """Return the contents of the tab as HTML."""
    keys = "".join(f"<tr><th>{name}</th><td>{escape(label)}</td></tr>" for name, (label, _) in KEYS.items())
    marks = legend(mark for mark in MARKS.values() if mark.text)
    parts = {"KEYS": keys, "MARKS": marks, "ROOMS": MEASURED_AND_MODELLED}
    return filled(HELP.read_text(encoding="utf-8"), parts)
